//! The controls of a tile's computation, and its outcome.

use std::time::Instant;

use sightline_sample::crew::Crew;
use sightline_sample::{TileError, Watcher};
use sightline_trace::TracerError;

use crate::cell_phase::Undecided;

/// The BLAKE3 digest of a pack.
pub type PackDigest = [u8; 32];

/// The watcher, deadline and crew of a tile.
#[derive(Clone, Copy)]
pub struct Control<'a> {
    /// The watcher, which receives the progress and can cancel the tile.
    pub watcher: &'a dyn Watcher,
    /// The end of a time budget; `None` without a budget.
    pub deadline: Option<Instant>,
    /// The crew that shares the work of a block; [`crate::SoleMember`] for a worker without helpers. With a
    /// time budget, members would stop at different cells, so the crew must be a sole member.
    pub crew: &'a dyn Crew,
}

/// A finished tile.
#[derive(Debug)]
pub struct TileDone {
    /// The encoded output of the tile.
    pub bytes: Vec<u8>,
    /// The number of rendered cubes, traced rays, or receivers with an answer.
    pub samples: u64,
    /// The lost packs that were computed again, with their digests.
    pub recomputed: Vec<(PackDigest, Vec<u8>)>,
}

/// The reason why a tile has no output.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// The watcher cancelled the tile.
    #[error("the tile was cancelled")]
    Cancelled,
    /// The backend failed. The same tile may succeed with a backend that is opened again.
    #[error(transparent)]
    Backend(TracerError),
    /// The tile cannot be computed on this worker.
    #[error("{0}")]
    Tile(String),
}

impl From<TileError> for BakeError {
    fn from(e: TileError) -> Self {
        match e {
            TileError::Cancelled => Self::Cancelled,
            TileError::Backend(e) => Self::Backend(e),
        }
    }
}

impl From<Undecided> for BakeError {
    fn from(undecided: Undecided) -> Self {
        match undecided {
            Undecided::Cancelled => Self::Cancelled,
            Undecided::Fault(reason) => Self::Tile(reason),
        }
    }
}

/// Creates the error of a tile that cannot be computed.
pub fn tile_error(e: impl std::fmt::Display) -> BakeError {
    BakeError::Tile(e.to_string())
}
