//! Late outcomes: outcomes of phases that are stored after their tile is done, set aside or deleted.

use sightline_records::TileState;
use sightline_records::ids::{JobId, TileIndex};
use sightline_store::StoreError;

use crate::coordinator::Coordinator;

/// Removes the outcomes of a tile if the tile is not open, its job has ended, or its job does not exist.
/// Returns true if it removed them. Blocks on the disk.
///
/// Call this function after each stored outcome. The code that closes a tile first records the new state and
/// then removes the outcomes. If an outcome is stored after this removal, this function reads the new state.
///
/// # Errors
/// [`StoreError`] if the store cannot be read.
pub(crate) fn remove_if_closed(
    c: &Coordinator,
    job: JobId,
    tile: TileIndex,
) -> Result<bool, StoreError> {
    let record = c.records.job(job)?;
    if record.is_some_and(|record| !record.state.phase().ended())
        && c.records.tile(job, tile)?.state == TileState::Open
    {
        return Ok(false);
    }
    c.workers.crews.outcomes.remove((job, tile));
    Ok(true)
}
