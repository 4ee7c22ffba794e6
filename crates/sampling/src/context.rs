//! What every sampler is given for a tile: the job, the scene, the backend, and who watches.

use std::time::Instant;

use sightline_model::SamplingParams;
use sightline_viewcells::{Division, Lattice};

use crate::backend::Backend;
use crate::error::BackendError;
use crate::prepared::PreparedScene;

/// What all tiles of a job share.
pub struct JobContext<'a> {
    /// The scene.
    pub scene: &'a PreparedScene,
    /// How the view box is divided.
    pub division: Division,
    /// The division's lattice.
    pub lattice: Lattice,
    /// The sampling parameters.
    pub params: &'a SamplingParams,
    /// The backend that traces and renders.
    pub backend: &'a dyn Backend,
    /// Seed of all random numbers.
    pub seed: u64,
    /// When sampling stops with the result by then; the sampler cubes ignores it.
    pub deadline: Option<Instant>,
}

/// Why a tile did not finish.
#[derive(Debug, thiserror::Error)]
pub enum TileError {
    /// Its lease was taken back.
    #[error("the tile was cancelled")]
    Cancelled,
    /// The backend failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
}

/// Receives the progress of a tile and decides whether it goes on.
pub trait Watcher: Sync {
    /// `samples` more cubes were rendered, or rays traced.
    fn rendered(&self, samples: u64);
    /// One more cell is finished.
    fn cell_done(&self);
    /// Whether the tile should stop.
    fn cancelled(&self) -> bool;
}
