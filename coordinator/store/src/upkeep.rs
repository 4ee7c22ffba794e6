//! The rules of the commands that keep a store correct.
//!
//! The commands concern confirmed or untrusted results, quarantined workers, removed scenes, and imported
//! entries.

use sightline_records::MAX_SIGNATURE_BYTES;
use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    JobPhase, JobState, QuarantineRecord, SceneRecord, TileCheck, TileRecord, TileState,
};

use super::entries::Entry;
use super::entry_checks;
use super::error::StoreError;
use super::identity::StoreIdentity;
use super::limits::{check_identifier, clean_reason};
use super::rules::{Decided, StateChange, happened, unchanged};
use super::table::View;

/// Records that a worker computed a done tile again with the same bytes.
pub(super) fn confirm_tile(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    digest: Digest,
    check: TileCheck,
) -> Decided<()> {
    check_identifier("the worker's name", &check.worker, MAX_SIGNATURE_BYTES)?;
    let (_, mut found) = view.job_and_tile(job, tile)?;
    match &found.state {
        TileState::Done { digest: kept, .. }
            if *kept == digest && found.check.as_ref() != Some(&check) =>
        {
            found.check = Some(check);
            happened(StateChange::TileChanged { job, tile: found }, ())
        }
        // The tile has another result by now, or the confirmation is already recorded.
        _ => unchanged(()),
    }
}

/// Reopens tiles whose results are no longer trusted, and returns the number of reopened tiles.
///
/// A done job starts again with all tiles, because its other outputs were removed. The same event records the
/// epoch in the job: a restart loses the list of revoked leases, and a worker that returns with such a lease
/// may have computed from the untrusted results.
pub(super) fn invalidate_tiles(view: View<'_>, job: JobId, tiles: &[TileIndex]) -> Decided<u32> {
    let mut record = view.known_job(job)?;
    let is_done = record.state.phase() == JobPhase::Done;
    if let Some(tile) = tiles.iter().find(|tile| tile.0 >= record.tiles) {
        return Err(StoreError::UnknownTile {
            job,
            tile: *tile,
            tiles: record.tiles,
        });
    }
    let meant = |tile: &TileRecord| {
        !matches!(tile.state, TileState::Open) && (is_done || tiles.contains(&tile.tile))
    };
    let recorded = view.recorded_tiles(job)?;
    let opened: Vec<TileIndex> = recorded
        .iter()
        .filter(|tile| meant(tile))
        .map(|tile| tile.tile)
        .collect();
    if opened.is_empty() || tiles.is_empty() {
        return unchanged(0);
    }
    if is_done {
        record.state = JobState::Queued;
        record.finished_at_ms = None;
    }
    record.reopened_epoch = Some(view.epoch()?);
    // The number is at most the job's number of tiles, which is a u32.
    let count = opened.len() as u32;
    happened(
        StateChange::TilesReopened {
            job: record,
            tiles: opened,
        },
        count,
    )
}

/// Removes a scene that no job references.
pub(super) fn delete_scene(view: View<'_>, scene: Digest) -> Decided<SceneRecord> {
    let record = view
        .scene(&scene)?
        .ok_or(StoreError::UnknownScene { scene })?;
    if let Some(job) = view.jobs()?.iter().find(|job| job.scene == scene) {
        return Err(StoreError::SceneInUse { scene, job: job.id });
    }
    happened(StateChange::SceneDeleted { scene }, record)
}

/// Imports entries of another store. With `first`, the store must contain no scenes and no jobs.
pub(super) fn import(view: View<'_>, entries: Vec<Entry>, first: bool) -> Decided<()> {
    if first && !view.is_empty()? {
        return Err(StoreError::NotEmpty);
    }
    entries.iter().try_for_each(entry_checks::entry)?;
    let entries = entries.iter().map(Entry::written).collect();
    happened(StateChange::Imported { entries }, ())
}

/// Assigns the store an identity unless it has one. Returns the store's identity.
pub(super) fn identify(view: View<'_>, fresh: StoreIdentity) -> Decided<StoreIdentity> {
    match view.identity()? {
        Some(known) => unchanged(known),
        None => happened(StateChange::Identified(fresh.clone()), fresh),
    }
}

/// Quarantines a worker. If it is already quarantined, the first reason stays.
pub(super) fn quarantine(view: View<'_>, record: QuarantineRecord) -> Decided<()> {
    check_identifier("the worker's name", &record.worker, MAX_SIGNATURE_BYTES)?;
    if view.is_quarantined(&record.worker)? {
        return unchanged(());
    }
    happened(
        StateChange::Quarantined(QuarantineRecord {
            reason: clean_reason(&record.reason),
            ..record
        }),
        (),
    )
}

/// Ends the quarantine of a worker. Returns true if the worker was quarantined.
pub(super) fn release(view: View<'_>, worker: String) -> Decided<bool> {
    if !view.is_quarantined(&worker)? {
        return unchanged(false);
    }
    happened(StateChange::Released { worker }, true)
}
