//! The sampling of cells: the sampler with its cells and its parameters.

use super::cells::{Adaptive, AnyCells, CubeCells, KnownCells, MOST_LINE_DEPTH};
use super::names::{ErrorMeasure, SamplerName, SupersetChoice, TracerChoice};
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
    /// Whether the share of the view that each visible item takes is measured.
    pub contributions: bool,
}

/// The sampler of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Sampler {
    /// Sight lines that all cells on their way share and that earlier hits guide.
    Lines {
        /// The cells, and when they are finished.
        aim: LineAim,
        /// The time after which sampling stops.
        time: Option<TimeBudget>,
    },
    /// A fixed number of guided rays of each cell, which no other cell shares: the baseline of the
    /// benchmarks.
    Guided {
        /// The cells.
        cells: KnownCells,
        /// The number of rays of each cell.
        rays: RayCount,
        /// The time after which sampling stops.
        time: Option<TimeBudget>,
    },
    /// Visibility cubes on adaptively split rectangles (Nirenstein and Blake 2004).
    Cubes {
        /// The cells.
        cells: CubeCells,
        /// The parameters.
        params: CubeParams,
    },
}

/// The cells that lines sample, and when they are finished.
#[derive(Clone, Debug, PartialEq)]
pub enum LineAim {
    /// Cells that are known before the bake.
    Known {
        /// The cells.
        cells: KnownCells,
        /// The expected error at which a cell is finished; it steers the search in all three cases of `stop`.
        error: TargetError,
        /// The second condition of a finished cell.
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

/// The condition under which a cell is finished, in addition to its expected error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// At the expected error.
    Expected,
    /// When its 95 % bound on missed sight lines is at most this.
    Bound(MaxError),
    /// When items of this share are found with a probability of 95 %.
    Share(MinShare),
}

/// The parameters of visibility cubes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubeParams {
    /// The side of a face in pixels.
    pub resolution: Resolution,
    /// The error measure.
    pub measure: ErrorMeasure,
    /// A rectangle is split while the measure over its exterior cubes exceeds this.
    pub error_threshold: ErrorThreshold,
    /// The threshold for cubes inside closed solids.
    pub interior_threshold: InteriorThreshold,
    /// The size from which on a rectangle within a cell is not split.
    pub min_distance: MinDistance,
    /// Whether cubes inside closed solids are judged apart (Nirenstein and Blake 2004, section 3.6).
    pub solids: bool,
    /// Whether superset simplification is used.
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
    /// Makes the sampling of a sampler, with the default tracer and without contributions.
    pub fn new(sampler: Sampler) -> Self {
        Self {
            sampler,
            tracer: TracerChoice::default(),
            contributions: false,
        }
    }
}

impl Sampler {
    /// Makes the sampler lines over known cells, with the default error.
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

    /// Makes the sampler guided over known cells, with the default number of rays.
    pub fn guided(cells: KnownCells) -> Self {
        Self::Guided {
            cells,
            rays: RayCount::default(),
            time: None,
        }
    }

    /// Makes the sampler cubes, with the default parameters.
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

    /// Returns the parameters of visibility cubes, if these are the sampler.
    pub fn cube_params(&self) -> Option<&CubeParams> {
        match self {
            Self::Cubes { params, .. } => Some(params),
            Self::Lines { .. } | Self::Guided { .. } => None,
        }
    }

    /// Returns the share from which on lines look for items, if they do.
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

    /// Returns the time budget.
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
