//! The inputs of every sampler for a tile: the job, the scene, the backend and the watcher.

use std::time::Instant;

use glam::Vec3;
use sightline_model::{Crediting, CubeParams, Granularity, LineAim, Sampler, Stop};
use sightline_numbers::Aabb;
use sightline_viewcells::{Division, Lattice, PartMask};

use crate::crew::Crew;
pub use crate::error::TileError;
use sightline_trace::PreparedScene;
use sightline_trace::Tracer;
use sightline_trace::rows::Rows;

/// The sampler of a tile: the sampler of the job without its cells. A tile of a box has other cells than its
/// job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TileSampler {
    /// Sight lines.
    Lines(LineSampler),
    /// Visibility cubes.
    Cubes(CubeParams),
}

/// The sampler of a tile that casts lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineSampler {
    /// Lines that all cells share.
    Shared {
        /// The expected fraction of missed sight lines at which a cell is finished.
        error: f64,
        /// The condition that a finished cell meets in addition to `error`.
        stop: Stop,
    },
    /// Guided rays.
    Guided {
        /// The number of rays of each cell.
        rays: u64,
        /// The cells that a ray credits.
        credit: Crediting,
    },
}

impl From<&Sampler> for TileSampler {
    fn from(sampler: &Sampler) -> Self {
        match sampler {
            Sampler::Lines { aim, .. } => match aim {
                LineAim::Known { error, stop, .. } => Self::Lines(LineSampler::Shared {
                    error: error.get(),
                    stop: *stop,
                }),
                LineAim::Adaptive { error, .. } => Self::Lines(LineSampler::Shared {
                    error: error.get(),
                    stop: Stop::Expected,
                }),
            },
            Sampler::Guided { rays, credit, .. } => Self::Lines(LineSampler::Guided {
                rays: rays.get(),
                credit: *credit,
            }),
            Sampler::Cubes { params, .. } => Self::Cubes(*params),
        }
    }
}

/// The inputs that all tiles of a job share.
pub struct JobContext<'a> {
    /// The scene.
    pub scene: &'a PreparedScene,
    /// The division of the view box.
    pub division: Division,
    /// The division's lattice.
    pub lattice: Lattice,
    /// The sampler.
    pub sampler: TileSampler,
    /// The items that the sets list.
    pub items: Granularity,
    /// True if likely items that no sight line met complete the sets. Only the sampler lines, without a
    /// minimum share, completes sets.
    pub completes: bool,
    /// The distance from the viewpoint at which sight lines end, in the scene's units; `None` for unlimited
    /// sight.
    pub far: Option<f64>,
    /// The parts of a grid's cells that contain viewpoints; `None` if viewpoints are everywhere.
    pub viewpoints: Option<&'a PartMask>,
    /// The region that contains all viewpoints; `None` if viewpoints are not restricted to a region.
    pub region: Option<&'a dyn ViewRegion>,
    /// The grid over which pairs of cells are searched; `None` if the job does not request pairs.
    pub pairs: Option<[u32; 3]>,
    /// The backend that traces and renders.
    pub backend: &'a dyn Tracer,
    /// The seed of all random numbers.
    pub seed: u64,
    /// The time at which sampling stops with the sets found so far. The sampler cubes ignores it.
    pub deadline: Option<Instant>,
    /// The crew that shares the phases of a block. The sampler cubes does not use it.
    pub crew: &'a dyn Crew,
}

impl JobContext<'_> {
    /// Returns true if the deadline has passed, so that sampling has to stop.
    pub fn is_late(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Returns the rows of the table: items in a job with a minimum share, otherwise triangles.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool (see [`PreparedScene`]).
    pub fn rows(&self) -> &Rows {
        match self.sampler {
            TileSampler::Lines(LineSampler::Shared {
                stop: Stop::Share(_),
                ..
            }) => self.scene.item_rows(self.items),
            _ => self.scene.fine_rows(self.items),
        }
    }
}

/// A region that contains all viewpoints. Free segments that begin in the region do not leave it, so samplers
/// query only the origins of lines.
pub trait ViewRegion: Sync {
    /// Returns true if a viewpoint can be at `point`.
    fn hold(&self, point: Vec3) -> bool;
    /// Returns a point of the region in the box `bounds`, or `None` if the common part contains no point with
    /// single-precision coordinates.
    fn any_in(&self, bounds: Aabb) -> Option<Vec3>;
    /// Returns true if a part of `triangle` with a positive area is in the closed region and in the closed
    /// box `within`.
    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool;
}

/// A receiver of the progress of a tile, which can cancel the tile.
pub trait Watcher: Sync {
    /// Reports that `samples` more cubes were rendered, or rays traced.
    fn rendered(&self, samples: u64);
    /// Reports that one more cell is finished.
    fn cell_done(&self);
    /// Returns true if the tile should stop.
    fn cancelled(&self) -> bool;
}

/// A `Watcher` that ignores progress, for benchmarks and tests.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwatched;

impl Watcher for Unwatched {
    fn rendered(&self, _: u64) {}

    fn cell_done(&self) {}

    fn cancelled(&self) -> bool {
        false
    }
}
