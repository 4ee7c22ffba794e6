//! The points of each curve. Each sampler has one parameter that trades time for error, for undecided
//! triangles or for the time of a cell. The values are ordered from coarse to fine.

use clap::ValueEnum;
use serde::Serialize;

/// A sampler or method of `sightline bake`, with the parameter that the curve varies.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// Sight lines shared by the cells they cross, --target-error 0.1 to 0.00003.
    Lines,
    /// The baseline: guided rays that credit every cell they cross, --rays 500 to 300000 per cell.
    Guided,
    /// Guided rays of each cell separately, --rays 3000 to 4000000 per cell.
    GuidedOwn,
    /// Visibility cubes that split every rectangle, --min-distance 2 to 0.25.
    CubesUniform,
    /// Visibility cubes that split rectangles whose corners have different sets (Err), --min-distance 2 to
    /// 0.25.
    #[serde(rename = "cubes-err")]
    CubesErr,
    /// Visibility cubes that compare the corners pixel by pixel (Err′), --min-distance 2 to 0.25.
    #[serde(rename = "cubes-err1")]
    CubesErr1,
    /// Visibility cubes that compare the corners in 24 groups of directions (Err″), --min-distance 2 to 0.25.
    #[serde(rename = "cubes-err2")]
    CubesErr2,
    /// Sight lines until a bound on the error of each cell holds, --max-error 0.03 to 0.0003.
    MaxError,
    /// Method verified: the number of undecided triangles after --time-budget 1s to 64s.
    Verified,
    /// Method exact: the time per cell, for 1, 8 and 64 cells in the middle of the grid.
    Exact,
}

/// The quantities that a curve shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shows {
    /// The curve shows time against error.
    Error,
    /// The curve shows time against the share of undecided triangles.
    Undecided,
    /// The curve shows the number of cells against the time per cell.
    CellTime,
}

/// The range of parameters of a sampler.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ladder {
    /// All parameters except the finest of each sampler and the two finest of guided rays of each cell.
    Quick,
    /// All parameters.
    Full,
}

/// The target errors of the sampler lines, from coarse to fine. All parameters are text, so that tables show
/// them as on the command line.
const TARGET_ERRORS: [&str; 8] = [
    "0.1", "0.03", "0.01", "0.003", "0.001", "0.0003", "0.0001", "0.00003",
];
/// The bounds of `--max-error`. A bound needs many more lines than an expected error of the same value.
const MAX_ERRORS: [&str; 5] = ["0.03", "0.01", "0.003", "0.001", "0.0003"];
/// The rays per cell of the sampler guided.
const SHARED_RAYS: [&str; 6] = ["500", "2000", "8000", "30000", "100000", "300000"];
/// The rays per cell of the sampler guided if each cell has separate rays. The last value costs minutes,
/// which the lowest errors of outdoor scenes need.
const RAYS: [&str; 6] = ["3000", "12500", "50000", "200000", "1000000", "4000000"];
/// The minimum distances of cubes, in cell sizes.
const DISTANCES: [&str; 4] = ["2", "1", "0.5", "0.25"];
/// The time budgets of the verified method.
const BUDGETS: [&str; 7] = ["1s", "2s", "4s", "8s", "16s", "32s", "64s"];
/// The sides, in cells, of the blocks that the exact method decides.
const BLOCKS: [(&str, u32); 3] = [("1", 1), ("2", 2), ("4", 4)];

/// One point: its name in tables and its flags for `bake`.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// The name in tables, for example `--rays 3000`.
    pub parameter: String,
    /// All flags that select the sampler and its parameter.
    pub flags: Vec<String>,
    /// The maximum number of cells per axis of the block in the middle of the grid; `None` for the whole
    /// grid.
    pub block: Option<u32>,
}

impl Sampler {
    /// The samplers that are measured if the options name none. The other samplers compute a bound, or need
    /// minutes per point.
    pub const DEFAULT: [Self; 7] = [
        Self::Lines,
        Self::Guided,
        Self::GuidedOwn,
        Self::CubesUniform,
        Self::CubesErr,
        Self::CubesErr1,
        Self::CubesErr2,
    ];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lines => "lines",
            Self::Guided => "guided",
            Self::GuidedOwn => "guided-own",
            Self::CubesUniform => "cubes-uniform",
            Self::CubesErr => "cubes-err",
            Self::CubesErr1 => "cubes-err1",
            Self::CubesErr2 => "cubes-err2",
            Self::MaxError => "max-error",
            Self::Verified => "verified",
            Self::Exact => "exact",
        }
    }

    /// Returns the quantities that the sampler's curve shows.
    pub fn shows(self) -> Shows {
        match self {
            Self::Verified => Shows::Undecided,
            Self::Exact => Shows::CellTime,
            _ => Shows::Error,
        }
    }

    /// Returns the points of the sampler, from coarse to fine.
    pub fn rungs(self, ladder: Ladder) -> Vec<Rung> {
        let cubes = ["--sampler", "cubes", "--resolution", "128"];
        let (fixed, more, flag, values): (&[&str], &[&str], &str, &[&str]) = match self {
            Self::Lines => (
                &["--sampler", "lines"],
                &[],
                "--target-error",
                &TARGET_ERRORS,
            ),
            Self::Guided => (&["--sampler", "guided"], &[], "--rays", &SHARED_RAYS),
            Self::GuidedOwn => (
                &["--sampler", "guided"],
                &["--credit", "own"],
                "--rays",
                &RAYS,
            ),
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

    /// Returns the number of a sampler's points that a ladder contains.
    fn taken(self, ladder: Ladder, all: usize) -> usize {
        match ladder {
            Ladder::Quick => all - if self == Self::GuidedOwn { 2 } else { 1 },
            Ladder::Full => all,
        }
    }
}

/// Returns the points of the exact method.
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
            let left_out = if sampler == Sampler::GuidedOwn { 2 } else { 1 };
            assert_eq!(full.len() - quick.len(), left_out, "{}", sampler.name());
            assert_eq!(quick, full[..quick.len()], "{}", sampler.name());
        }
    }

    #[test]
    fn names_match_command_line_and_json() {
        for &sampler in Sampler::value_variants() {
            assert_eq!(
                sampler.to_possible_value().unwrap().get_name(),
                sampler.name()
            );
            assert_eq!(serde_json::to_value(sampler).unwrap(), sampler.name());
        }
    }

    #[test]
    fn default_has_all_samplers_without_bound() {
        let without = Sampler::value_variants().iter().copied();
        let without: Vec<_> = without
            .filter(|s| s.shows() == Shows::Error && *s != Sampler::MaxError)
            .collect();
        assert_eq!(without, Sampler::DEFAULT);
    }
}
