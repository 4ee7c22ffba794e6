//! The points of each sampler's curve: the one parameter that trades time for error, from coarse to fine.

use clap::ValueEnum;
use serde::Serialize;

/// A way to sample, as `bake` offers it.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// Sight lines shared by the cells they cross, --target-error 0.1 to 0.00003.
    Lines,
    /// The baseline: --rays 3000 to 4000000 for each cell.
    Guided,
    /// Visibility cubes, every rectangle split down to --min-distance 2 to 0.25.
    CubesUniform,
    /// Visibility cubes, split where the sets of their corners differ (Err), the same distances.
    #[serde(rename = "cubes-err")]
    CubesErr,
    /// The same, compared pixel by pixel (Err′).
    #[serde(rename = "cubes-err1")]
    CubesErr1,
    /// The same, compared in 24 directions (Err″).
    #[serde(rename = "cubes-err2")]
    CubesErr2,
}

/// How far the parameters go.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ladder {
    /// Without the finest of each sampler, and the two finest of the baseline.
    Quick,
    /// All.
    Full,
}

/// Parameters of lines, coarse to fine. Text, so that tables show what was typed.
const TARGET_ERRORS: [&str; 8] = ["0.1", "0.03", "0.01", "0.003", "0.001", "0.0003", "0.0001", "0.00003"];
/// Rays a cell of guided. The last takes minutes, and is what the least errors of outdoor scenes take.
const RAYS: [&str; 6] = ["3000", "12500", "50000", "200000", "1000000", "4000000"];
/// Least distances of cubes, in cell sizes.
const DISTANCES: [&str; 4] = ["2", "1", "0.5", "0.25"];

/// One point: what tables call it and what `bake` is given.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// As tables show it, `--rays 3000`.
    pub parameter: String,
    /// All flags that choose the sampler and its parameter.
    pub flags: Vec<String>,
}

impl Sampler {
    /// As the command line names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lines => "lines",
            Self::Guided => "guided",
            Self::CubesUniform => "cubes-uniform",
            Self::CubesErr => "cubes-err",
            Self::CubesErr1 => "cubes-err1",
            Self::CubesErr2 => "cubes-err2",
        }
    }

    /// Its points, from coarse to fine.
    pub fn rungs(self, ladder: Ladder) -> Vec<Rung> {
        let cubes = ["--sampler", "cubes", "--resolution", "128"];
        let (fixed, more, flag, values): (&[&str], &[&str], &str, &[&str]) = match self {
            Self::Lines => (&["--sampler", "lines"], &[], "--target-error", &TARGET_ERRORS),
            Self::Guided => (&["--sampler", "guided"], &[], "--rays", &RAYS),
            Self::CubesUniform => (&cubes, &["--error-threshold", "0"], "--min-distance", &DISTANCES),
            Self::CubesErr => (&cubes, &["--error-measure", "sets"], "--min-distance", &DISTANCES),
            Self::CubesErr1 => (&cubes, &["--error-measure", "pixels"], "--min-distance", &DISTANCES),
            Self::CubesErr2 => (&cubes, &["--error-measure", "strata"], "--min-distance", &DISTANCES),
        };
        let taken = match ladder {
            Ladder::Quick => values.len() - if self == Self::Guided { 2 } else { 1 },
            Ladder::Full => values.len(),
        };
        let rung = |value: &&str| Rung {
            parameter: format!("{flag} {value}"),
            flags: fixed.iter().chain(more).chain(&[flag, *value]).map(|&f| f.to_owned()).collect(),
        };
        values[..taken].iter().map(rung).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quick_is_full_without_the_finest_points() {
        for &sampler in Sampler::value_variants() {
            let (quick, full) = (sampler.rungs(Ladder::Quick), sampler.rungs(Ladder::Full));
            let left_out = if sampler == Sampler::Guided { 2 } else { 1 };
            assert_eq!(full.len() - quick.len(), left_out, "{}", sampler.name());
            assert_eq!(quick, full[..quick.len()], "{}", sampler.name());
        }
    }

    #[test]
    fn names_are_those_of_the_command_line_and_of_json() {
        for &sampler in Sampler::value_variants() {
            assert_eq!(sampler.to_possible_value().unwrap().get_name(), sampler.name());
            assert_eq!(serde_json::to_value(sampler).unwrap(), sampler.name());
        }
    }
}
