//! What a tile is run with, and how it ends.

use std::time::Instant;

use sightline_sample::crew::Crew;
use sightline_sample::{TileError, Watcher};
use sightline_trace::BackendError;

use crate::cell_phase::Undecided;

/// BLAKE3 digest of a pack.
pub type PackDigest = [u8; 32];

/// Who watches a tile, and when it has to end.
#[derive(Clone, Copy)]
pub struct Control<'a> {
    /// Receives the progress and decides whether the tile goes on.
    pub watcher: &'a dyn Watcher,
    /// The end of a time budget.
    pub deadline: Option<Instant>,
    /// Those who share the sampling of a block; [`crate::Alone`] for nobody else. With a time budget members
    /// would not stop at the same place, so there must be one.
    pub crew: &'a dyn Crew,
}

/// A finished tile.
#[derive(Debug)]
pub struct TileDone {
    /// The tile's output, encoded.
    pub bytes: Vec<u8>,
    /// Cubes rendered or rays traced.
    pub samples: u64,
    /// Packs that were computed again, with their digests.
    pub recomputed: Vec<(PackDigest, Vec<u8>)>,
}

/// Why a tile has no output.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// The watcher stopped it.
    #[error("the tile was cancelled")]
    Cancelled,
    /// The backend failed; the same tile may succeed with a backend that is opened again.
    #[error(transparent)]
    Backend(BackendError),
    /// The tile itself cannot be computed here.
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

/// A fault of a tile.
pub fn tile_error(e: impl std::fmt::Display) -> BakeError {
    BakeError::Tile(e.to_string())
}
