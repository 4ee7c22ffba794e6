//! The points of each curve: the one parameter that trades time for error, for undecided triangles or for
//! the time of a cell, from coarse to fine.

use clap::ValueEnum;
use serde::Serialize;

/// A way to bake, as `bake` offers it.
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
    /// Sight lines until a bound on each cell's error holds, --max-error 0.03 to 0.0003.
    MaxError,
    /// --method verified: the triangles that are undecided after --time-budget 1s to 64s.
    Verified,
    /// --method exact: the time of a cell, for one, 8 and 64 cells in the middle of the grid.
    Exact,
}

/// What the points of a curve show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shows {
    /// Time against error.
    Error,
    /// Time against the share of undecided triangles.
    Undecided,
    /// Cells against the time of each.
    CellTime,
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
const TARGET_ERRORS: [&str; 8] = [
    "0.1", "0.03", "0.01", "0.003", "0.001", "0.0003", "0.0001", "0.00003",
];
/// Bounds; each takes many more lines than the error that it bounds.
const MAX_ERRORS: [&str; 5] = ["0.03", "0.01", "0.003", "0.001", "0.0003"];
/// Rays a cell of guided. The last takes minutes, and is what the least errors of outdoor scenes take.
const RAYS: [&str; 6] = ["3000", "12500", "50000", "200000", "1000000", "4000000"];
/// Least distances of cubes, in cell sizes.
const DISTANCES: [&str; 4] = ["2", "1", "0.5", "0.25"];
/// Budgets of the verified method.
const BUDGETS: [&str; 7] = ["1s", "2s", "4s", "8s", "16s", "32s", "64s"];
/// Sides, in cells, of the blocks that the exact method decides.
const BLOCKS: [(&str, u32); 3] = [("1", 1), ("2", 2), ("4", 4)];

/// One point: what tables call it and what `bake` is given.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// As tables show it, `--rays 3000`.
    pub parameter: String,
    /// All flags that choose the sampler and its parameter.
    pub flags: Vec<String>,
    /// Only a block of at most so many cells on each axis, in the middle of the grid.
    pub block: Option<u32>,
}

impl Sampler {
    /// Those that are measured when none are named. The others take a bound, or minutes a point.
    pub const DEFAULT: [Self; 6] = [
        Self::Lines,
        Self::Guided,
        Self::CubesUniform,
        Self::CubesErr,
        Self::CubesErr1,
        Self::CubesErr2,
    ];

    /// As the command line names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lines => "lines",
            Self::Guided => "guided",
            Self::CubesUniform => "cubes-uniform",
            Self::CubesErr => "cubes-err",
            Self::CubesErr1 => "cubes-err1",
            Self::CubesErr2 => "cubes-err2",
            Self::MaxError => "max-error",
            Self::Verified => "verified",
            Self::Exact => "exact",
        }
    }

    /// What its curve shows.
    pub fn shows(self) -> Shows {
        match self {
            Self::Verified => Shows::Undecided,
            Self::Exact => Shows::CellTime,
            _ => Shows::Error,
        }
    }

    /// Its points, from coarse to fine.
    pub fn rungs(self, ladder: Ladder) -> Vec<Rung> {
        let cubes = ["--sampler", "cubes", "--resolution", "128"];
        let (fixed, more, flag, values): (&[&str], &[&str], &str, &[&str]) = match self {
            Self::Lines => (
                &["--sampler", "lines"],
                &[],
                "--target-error",
                &TARGET_ERRORS,
            ),
            Self::Guided => (&["--sampler", "guided"], &[], "--rays", &RAYS),
            Self::CubesUniform => (
                &cubes,
                &["--error-measure", "uniform"],
                "--min-distance",
                &DISTANCES,
            ),
            Self::CubesErr => (
                &cubes,
                &["--error-measure", "sets"],
                "--min-distance",
                &DISTANCES,
            ),
            Self::CubesErr1 => (
                &cubes,
                &["--error-measure", "pixels"],
                "--min-distance",
                &DISTANCES,
            ),
            Self::CubesErr2 => (
                &cubes,
                &["--error-measure", "strata"],
                "--min-distance",
                &DISTANCES,
            ),
            Self::MaxError => (&["--sampler", "lines"], &[], "--max-error", &MAX_ERRORS),
            Self::Verified => (&["--method", "verified"], &[], "--time-budget", &BUDGETS),
            Self::Exact => return blocks(ladder),
        };
        let rung = |value: &&str| Rung {
            parameter: format!("{flag} {value}"),
            flags: fixed
                .iter()
                .chain(more)
                .chain(&[flag, *value])
                .map(|&f| f.to_owned())
                .collect(),
            block: None,
        };
        values[..self.taken(ladder, values.len())]
            .iter()
            .map(rung)
            .collect()
    }

    /// How many of its points a ladder has.
    fn taken(self, ladder: Ladder, all: usize) -> usize {
        match ladder {
            Ladder::Quick => all - if self == Self::Guided { 2 } else { 1 },
            Ladder::Full => all,
        }
    }
}

/// The points of the exact method.
fn blocks(ladder: Ladder) -> Vec<Rung> {
    let rung = |&(side, cells): &(&str, u32)| Rung {
        parameter: format!("--method exact --cells {side}x{side}x{side}"),
        flags: ["--method", "exact"].map(str::to_owned).to_vec(),
        block: Some(cells),
    };
    BLOCKS[..Sampler::Exact.taken(ladder, BLOCKS.len())]
        .iter()
        .map(rung)
        .collect()
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
            assert_eq!(
                sampler.to_possible_value().unwrap().get_name(),
                sampler.name()
            );
            assert_eq!(serde_json::to_value(sampler).unwrap(), sampler.name());
        }
    }

    #[test]
    fn the_default_is_all_samplers_without_a_bound() {
        let without = Sampler::value_variants().iter().copied();
        let without: Vec<_> = without
            .filter(|s| s.shows() == Shows::Error && *s != Sampler::MaxError)
            .collect();
        assert_eq!(without, Sampler::DEFAULT);
    }
}
