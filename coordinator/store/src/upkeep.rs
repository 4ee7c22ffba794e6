//! The rules of the commands that keep a store right: results that are confirmed or not believed any more,
//! quarantined workers, scenes that go, and entries that come from another store.

use sightline_records::MAX_SIGNATURE_BYTES;
use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    JobPhase, JobState, QuarantineRecord, SceneRecord, TileCheck, TileRecord, TileState,
};

use super::checked;
use super::entries::Entry;
use super::error::StoreError;
use super::identity::StoreIdentity;
use super::limits::{check_identifier, clean_reason};
use super::rules::{Decided, Event, happened, unchanged};
use super::table::View;

/// Who has computed a done tile again with the same bytes.
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
            happened(Event::TileChanged { job, tile: found }, ())
        }
        // It was computed again meanwhile, or is known.
        _ => unchanged(()),
    }
}

/// Opens tiles again whose results are not believed any more. A done job, whose other outputs are gone,
/// begins anew. Returns the number of opened tiles. The job notes the epoch, in the same event: a restart
/// forgets which leases were taken back, and a worker that comes back with one may have computed from what
/// is opened here.
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
    // No more than the job has tiles.
    let count = opened.len() as u32;
    happened(
        Event::TilesReopened {
            job: record,
            tiles: opened,
        },
        count,
    )
}

/// Removes a scene that no job names.
pub(super) fn delete_scene(view: View<'_>, scene: Digest) -> Decided<SceneRecord> {
    let record = view
        .scene(&scene)?
        .ok_or(StoreError::UnknownScene { scene })?;
    if let Some(job) = view.jobs()?.iter().find(|job| job.scene == scene) {
        return Err(StoreError::SceneInUse { scene, job: job.id });
    }
    happened(Event::SceneDeleted { scene }, record)
}

/// Takes over entries of another store. The first ones need an empty store.
pub(super) fn import(view: View<'_>, entries: Vec<Entry>, first: bool) -> Decided<()> {
    if first && !view.is_empty()? {
        return Err(StoreError::NotEmpty);
    }
    entries.iter().try_for_each(checked::entry)?;
    let entries = entries.iter().map(Entry::written).collect();
    happened(Event::Imported { entries }, ())
}

/// Gives the store an identity unless it has one; returns the store's.
pub(super) fn identify(view: View<'_>, fresh: StoreIdentity) -> Decided<StoreIdentity> {
    match view.identity()? {
        Some(known) => unchanged(known),
        None => happened(Event::Identified(fresh.clone()), fresh),
    }
}

/// Records that a worker gets no tiles any more; the first reason stays.
pub(super) fn quarantine(view: View<'_>, record: QuarantineRecord) -> Decided<()> {
    check_identifier("the worker's name", &record.worker, MAX_SIGNATURE_BYTES)?;
    if view.is_quarantined(&record.worker)? {
        return unchanged(());
    }
    happened(
        Event::Quarantined(QuarantineRecord {
            reason: clean_reason(&record.reason),
            ..record
        }),
        (),
    )
}

/// Records that a worker gets tiles again; returns whether it had none.
pub(super) fn release(view: View<'_>, worker: String) -> Decided<bool> {
    if !view.is_quarantined(&worker)? {
        return unchanged(false);
    }
    happened(Event::Released { worker }, true)
}
