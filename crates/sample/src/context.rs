//! The inputs of every sampler for a tile: the job, the scene, the backend and the watcher.

use std::time::Instant;

use glam::Vec3;
use sightline_model::{CubeParams, Granularity, LineAim, Sampler, Stop};
use sightline_numbers::Aabb;
use sightline_viewcells::{Division, Lattice, PartMask};

use crate::crew::Crew;
pub use crate::error::TileError;
use sightline_trace::Backend;
use sightline_trace::PreparedScene;
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
        /// The second condition of a finished cell.
        stop: Stop,
    },
    /// Guided rays of each cell, which no other cell shares.
    Guided {
        /// The number of rays of each cell.
        rays: u64,
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
            Sampler::Guided { rays, .. } => Self::Lines(LineSampler::Guided { rays: rays.get() }),
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
    /// The distance from the viewpoint where sight lines end; `None` for no end.
    pub far: Option<f64>,
    /// Where in the cells of a grid viewpoints can be; `None` for everywhere.
    pub viewpoints: Option<&'a PartMask>,
    /// The region that holds all viewpoints; `None` when they are not restricted to one.
    pub places: Option<&'a dyn ViewRegion>,
    /// The grid over which pairs of cells are looked for; `None` when the job does not ask.
    pub pairs: Option<[u32; 3]>,
    /// The backend that traces and renders.
    pub backend: &'a dyn Backend,
    /// Seed of all random numbers.
    pub seed: u64,
    /// When sampling stops with the sets found by then; the sampler cubes ignores it.
    pub deadline: Option<Instant>,
    /// Those who share the phases of a block; the sampler cubes works alone.
    pub crew: &'a dyn Crew,
}

impl JobContext<'_> {
    /// Whether sampling has to stop.
    pub fn is_late(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Returns the rows of the table: items in a job with a least share, otherwise triangles.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see [`PreparedScene`]).
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

/// The region that holds all viewpoints. Free segments that begin in it do not leave it, so only the origins
/// of lines are asked about.
pub trait ViewRegion: Sync {
    /// Whether a viewpoint can be at a point.
    fn hold(&self, point: Vec3) -> bool;
    /// A point of the region in a box; `None` when there is none, or single precision has none.
    fn any_in(&self, of: Aabb) -> Option<Vec3>;
    /// Whether a triangle has an area in common with the closed region within a closed box.
    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool;
}

/// Receives the progress of a tile and can cancel it.
pub trait Watcher: Sync {
    /// `samples` more cubes were rendered, or rays traced.
    fn rendered(&self, samples: u64);
    /// One more cell is finished.
    fn cell_done(&self);
    /// Whether the tile should stop.
    fn cancelled(&self) -> bool;
}

/// Work that nobody watches: measurements and tests.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwatched;

impl Watcher for Unwatched {
    fn rendered(&self, _: u64) {}

    fn cell_done(&self) {}

    fn cancelled(&self) -> bool {
        false
    }
}
