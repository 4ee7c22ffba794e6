//! What a bake can be told about sampling, with its defaults and limits.

use serde::{Deserialize, Serialize};
use sightline_viewcells::{Division, Lattice};

use crate::cube::{CubeSpec, Strata};

/// Which measure decides whether a rectangle is split (2004, §3.3–3.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorMeasure {
    /// Err: the sets of the four cubes, eq. 1.
    Sets,
    /// Err′: the cubes pixel by pixel, eq. 2.
    Pixels,
    /// Err″: the sets in each of 24 angular strata, the worst of them, eq. 3.
    Strata,
}

/// Where cubes are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BackendChoice {
    /// Whatever measures faster on the scene at hand.
    Auto,
    /// wgpu.
    Gpu,
    /// Embree.
    Cpu,
}

/// Whether cubes are rendered with what the cell above saw only (superset simplification, §4.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SupersetChoice {
    /// On for the gpu backend, whose cost grows with the triangles drawn; off for the cpu backend, whose rays cost
    /// little more in a larger hierarchy, so that nothing missed above can stay missed below.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// How visibility is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampler {
    /// Sight lines shared by all cells they cross, guided by what was found ([`crate::lines`]).
    Lines,
    /// The papers' visibility cubes on adaptively split rectangles ([`crate::refine`]).
    Cubes,
    /// A fixed number of guided rays for each cell on its own: what the others are measured against.
    Guided,
}

impl std::fmt::Display for Sampler {
    /// As the command line names it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Lines => "lines",
            Self::Cubes => "cubes",
            Self::Guided => "guided",
        })
    }
}

/// Parameters of aggressive sampling. All of them are part of a job's key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SamplingParams {
    /// Default lines. Those below up to `rays` are for lines, the others for cubes.
    pub sampler: Sampler,
    /// Lines: a cell is done when it is expected to miss at most this fraction of its sight lines; the hardest cells may
    /// miss more ([`crate::lines::block::Hard`]). Default 0.0001.
    pub target_error: f64,
    /// Lines: refine each cell until its 95 % bound on missed sight lines is at most this. Default none.
    pub max_error: Option<f64>,
    /// Guided: rays a cell. Default 200 000.
    pub rays: u64,
    /// Side of one item buffer in pixels. Default 256.
    pub resolution: u32,
    /// Default Err″.
    pub measure: ErrorMeasure,
    /// A rectangle is split while the measure over its exterior samples exceeds this. Default 0.1.
    pub error_threshold: f64,
    /// The same for its samples inside closed solids (§3.6). Default 0.5.
    pub interior_threshold: f64,
    /// A rectangle whose longer side is at most this fraction of a view cell's size, the geometric mean of its three
    /// sides, is never split. Default 0.5.
    pub min_distance: f64,
    /// Whether samples inside closed solids are judged apart (§3.6). Default true.
    pub solids: bool,
    /// Default auto.
    pub superset: SupersetChoice,
}

impl Default for SamplingParams {
    fn default() -> Self {
        Self {
            sampler: Sampler::Lines,
            target_error: 1e-4,
            max_error: None,
            rays: 200_000,
            resolution: 256,
            measure: ErrorMeasure::Strata,
            error_threshold: 0.1,
            interior_threshold: 0.5,
            min_distance: 0.5,
            solids: true,
            superset: SupersetChoice::Auto,
        }
    }
}

/// A parameter out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name} is {value}, which is not between {least} and {most}; choose a value in that range")]
pub struct ParamsError {
    /// As on the command line, without dashes.
    pub name: &'static str,
    /// The value given.
    pub value: f64,
    /// Least allowed.
    pub least: f64,
    /// Greatest allowed.
    pub most: f64,
}

impl SamplingParams {
    /// Checks every parameter's range.
    ///
    /// # Errors
    /// [`ParamsError`] for the first that is out of its range or not a number.
    pub fn check(&self) -> Result<(), ParamsError> {
        let within = |name, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(ParamsError { name, value, least, most })
            }
        };
        within("target-error", self.target_error, 1e-6, 1.0)?;
        within("max-error", self.max_error.unwrap_or(1.0), 1e-5, 1.0)?;
        within("rays", self.rays as f64, 1.0, 1e12)?;
        within("resolution", f64::from(self.resolution), 8.0, 4096.0)?;
        within("error-threshold", self.error_threshold, 0.0, 1.0)?;
        within("interior-threshold", self.interior_threshold, 0.0, 1.0)?;
        // Finer than any use; flat cells are halved further along their long sides, and the lattice still has points.
        within("min-distance", self.min_distance, 1.0 / 1024.0, 4.0)
    }

    /// How the measure wants its cubes rendered.
    pub fn cube_spec(&self) -> CubeSpec {
        CubeSpec {
            resolution: self.resolution,
            strata: match self.measure {
                ErrorMeasure::Sets => Strata::One,
                ErrorMeasure::Pixels | ErrorMeasure::Strata => Strata::Quadrants,
            },
            keep_pixels: self.measure == ErrorMeasure::Pixels,
        }
    }

    /// [`SamplingParams::min_distance`] in world units. For an adaptive tree a cell of its deepest level counts.
    pub fn min_distance_world(&self, division: &Division, lattice: &Lattice) -> f64 {
        let sides = [0, 1, 2].map(|a| lattice.length(a, lattice.units()[a]));
        let cells = match *division {
            Division::Grid(cells) => cells.map(f64::from).iter().product(),
            // As many as the deepest level would have.
            Division::Adaptive { max_depth, .. } => f64::from(1u32 << max_depth.min(31)),
        };
        // The mean, and not the longest side: cells of a street or a storey are long and flat, and what is seen
        // changes along their long sides as fast as in a cube of the same volume.
        let side = (sides.iter().product::<f64>() / cells).cbrt();
        // A little more, so that a side that is meant to equal the distance does so whatever the last bit of the
        // cube root is on this machine.
        side * self.min_distance * (1.0 + 1.0 / f64::from(1 << 20))
    }
}
