//! The sampling of cells: a sampler with its cells and parameters.

use super::cells::{Adaptive, AnyCells, CubeCells, KnownCells, MOST_LINE_DEPTH};
use super::names::{Crediting, ErrorMeasure, SamplerName, SupersetChoice, TracerChoice};
use super::numbers::{
    ErrorThreshold, InteriorThreshold, MaxError, MinDistance, MinShare, RayCount, Resolution,
    TargetError, TimeBudget,
};

/// The sampling of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampling {
    /// The sampler.
    pub sampler: Sampler,
    /// The choice of a tracer.
    pub tracer: TracerChoice,
    /// True if the bake measures the contribution of each visible item.
    pub contributions: bool,
}

/// The sampler of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Sampler {
    /// Sight lines that all crossed cells share and that earlier hits guide.
    Lines {
        /// The cells, and the condition under which they are finished.
        aim: LineAim,
        /// The duration from submission until sampling stops; `None` for unlimited time.
        time: Option<TimeBudget>,
    },
    /// A fixed number of guided rays of each cell: the baseline of the benchmarks.
    Guided {
        /// The cells.
        cells: KnownCells,
        /// The number of rays of each cell.
        rays: RayCount,
        /// The cells that a ray credits.
        credit: Crediting,
        /// The duration from submission until sampling stops; `None` for unlimited time.
        time: Option<TimeBudget>,
    },
    /// Visibility cubes on adaptively split rectangles (Nirenstein and Blake 2004).
    Cubes {
        /// The cells.
        cells: CubeCells,
        /// The parameters of the cubes.
        params: CubeParams,
    },
}

/// The cells that lines sample, and the condition under which they are finished.
#[derive(Clone, Debug, PartialEq)]
pub enum LineAim {
    /// Cells that are known before the bake.
    Known {
        /// The cells.
        cells: KnownCells,
        /// The expected error at which a cell is finished. This error controls the search for all values of
        /// `stop`.
        error: TargetError,
        /// The condition that a finished cell meets in addition to `error`.
        stop: Stop,
    },
    /// The cells of an adaptive tree.
    Adaptive {
        /// The cells.
        cells: Adaptive<MOST_LINE_DEPTH>,
        /// The expected error at which a cell is finished.
        error: TargetError,
    },
}

/// A condition under which a cell is finished, in addition to the cell's expected error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// No additional condition.
    Expected,
    /// The cell's 95 % bound on missed sight lines is at most this value.
    Bound(MaxError),
    /// Items of this share are found with a probability of 95 %.
    Share(MinShare),
}

/// The parameters of visibility cubes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubeParams {
    /// The side length of a face, in pixels.
    pub resolution: Resolution,
    /// The error measure.
    pub measure: ErrorMeasure,
    /// The threshold for the measure over exterior cubes. A rectangle above the threshold is split.
    pub error_threshold: ErrorThreshold,
    /// The threshold for the measure over cubes inside closed solids.
    pub interior_threshold: InteriorThreshold,
    /// The minimum size of a rectangle within a cell. A rectangle of this size is not split.
    pub min_distance: MinDistance,
    /// True if cubes inside closed solids have a separate threshold (Nirenstein and Blake 2004, section 3.6).
    pub solids: bool,
    /// The use of superset simplification.
    pub superset: SupersetChoice,
}

impl Default for CubeParams {
    fn default() -> Self {
        Self {
            resolution: Resolution::default(),
            measure: ErrorMeasure::default(),
            error_threshold: ErrorThreshold::default(),
            interior_threshold: InteriorThreshold::default(),
            min_distance: MinDistance::default(),
            solids: true,
            superset: SupersetChoice::default(),
        }
    }
}

impl Sampling {
    /// Creates a sampling with this sampler, the default tracer, and no contributions.
    pub fn new(sampler: Sampler) -> Self {
        Self {
            sampler,
            tracer: TracerChoice::default(),
            contributions: false,
        }
    }
}

impl Sampler {
    /// Creates the sampler `lines` over known cells, with the default error.
    pub fn lines(cells: KnownCells) -> Self {
        Self::Lines {
            aim: LineAim::Known {
                cells,
                error: TargetError::default(),
                stop: Stop::Expected,
            },
            time: None,
        }
    }

    /// Creates the sampler `guided` over known cells, with the default number of rays.
    pub fn guided(cells: KnownCells) -> Self {
        Self::Guided {
            cells,
            rays: RayCount::default(),
            credit: Crediting::default(),
            time: None,
        }
    }

    /// Creates the sampler `cubes`, with the default parameters.
    pub fn cubes(cells: CubeCells) -> Self {
        Self::Cubes {
            cells,
            params: CubeParams::default(),
        }
    }

    /// Returns the sampler's name.
    pub fn name(&self) -> SamplerName {
        match self {
            Self::Lines { .. } => SamplerName::Lines,
            Self::Guided { .. } => SamplerName::Guided,
            Self::Cubes { .. } => SamplerName::Cubes,
        }
    }

    /// Returns the parameters of visibility cubes, or `None` for another sampler.
    pub fn cube_params(&self) -> Option<&CubeParams> {
        match self {
            Self::Cubes { params, .. } => Some(params),
            Self::Lines { .. } | Self::Guided { .. } => None,
        }
    }

    /// Returns the minimum share of the items that sight lines search for, or `None` if the sampler has no
    /// such condition.
    pub fn min_share(&self) -> Option<MinShare> {
        match self {
            Self::Lines {
                aim:
                    LineAim::Known {
                        stop: Stop::Share(share),
                        ..
                    },
                ..
            } => Some(*share),
            _ => None,
        }
    }

    /// Returns the time budget, or `None` for unlimited time.
    pub(super) fn time(&self) -> Option<TimeBudget> {
        match self {
            Self::Lines { time, .. } | Self::Guided { time, .. } => *time,
            Self::Cubes { .. } => None,
        }
    }

    /// Returns the cells.
    pub(super) fn cells(&self) -> &dyn AnyCells {
        match self {
            Self::Lines {
                aim: LineAim::Known { cells, .. },
                ..
            }
            | Self::Guided { cells, .. } => cells,
            Self::Lines {
                aim: LineAim::Adaptive { cells, .. },
                ..
            } => cells,
            Self::Cubes { cells, .. } => cells,
        }
    }
}
