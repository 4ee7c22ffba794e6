//! The errors of a tile.

use sightline_trace::TracerError;

/// The reason why a tile did not finish.
#[derive(Debug, thiserror::Error)]
pub enum TileError {
    /// The watcher cancelled the tile, for example because the coordinator took the lease back.
    #[error("the tile was cancelled")]
    Cancelled,
    /// The backend failed.
    #[error(transparent)]
    Backend(#[from] TracerError),
}
