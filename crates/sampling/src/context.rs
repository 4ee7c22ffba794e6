//! The inputs of every sampler for a tile: the job, the scene, the backend and the watcher.

use std::time::Instant;

use sightline_model::SamplingParams;
use sightline_viewcells::{Division, Lattice, Viewpoints};

use crate::backend::Backend;
use crate::crew::Crew;
pub use crate::error::TileError;
use crate::prepared::PreparedScene;

/// The inputs that all tiles of a job share.
pub struct JobContext<'a> {
    /// The scene.
    pub scene: &'a PreparedScene,
    /// The division of the view box.
    pub division: Division,
    /// The division's lattice.
    pub lattice: Lattice,
    /// The sampling parameters.
    pub params: &'a SamplingParams,
    /// Where in the cells of a grid viewpoints can be; `None` for everywhere.
    pub viewpoints: Option<&'a Viewpoints>,
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
