//! Results that are not believed any more: those of a worker whose bytes were wrong, or those that a person
//! names. Their tiles are computed again, with all tiles that were computed from them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, QuarantineRecord};
use sightline_scheduler::{Event, Job};
use sightline_store::{StoreError, TileFilter, untrusted_tiles};

use crate::jobs::stored_spec;
use crate::records::{JobChanges, OutputRemoval};
use crate::telemetry::events::{Kind, LogEvent};

/// Quarantines workers, and reopens the tiles that they computed since they were last right.
pub(crate) fn condemn(
    changes: &mut JobChanges<'_>,
    workers: &[String],
    condemned: Option<(JobId, TileIndex)>,
    reason: &str,
) -> Result<(), StoreError> {
    let c = changes.coordinator();
    // The quarantine is recorded last: after a crash before that the worker is only found once more.
    for (job, tiles) in untrusted_tiles(c.store.queries(), workers, condemned)? {
        if let Some(record) = c.store.job(job)? {
            open_again(changes, record, tiles, true)?;
        }
    }
    // Phases of open tiles that they may have computed are computed again, too.
    c.crews.outcomes.sweep(|_| false);
    changes.tell(Event::Swept);
    for worker in workers {
        let at_ms = c.now().unix_ms;
        let record = QuarantineRecord {
            worker: worker.clone(),
            at_ms,
            reason: reason.to_owned(),
        };
        changes.quarantine(record)?;
        let text = format!(
            "WORKER {worker} IS QUARANTINED: {reason}. What it did since it was last right is computed \
             again. Find out what is wrong with its machine, driver or program; `sightline workers --release \
             {worker}` lets it work again"
        );
        tracing::error!("{text}");
        c.happened(LogEvent::of(Kind::Worker, text).on(worker));
    }
    Ok(())
}

/// Opens tiles again; returns how many of each job.
pub(crate) fn invalidate(
    changes: &mut JobChanges<'_>,
    filter: &TileFilter,
) -> Result<BTreeMap<JobId, u32>, StoreError> {
    let c = changes.coordinator();
    let jobs = match filter.job {
        Some(id) => {
            let job = c.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
            if let Some(&tile) = filter.tiles.iter().find(|tile| tile.0 >= job.tiles) {
                return Err(StoreError::UnknownTile {
                    job: id,
                    tile,
                    tiles: job.tiles,
                });
            }
            vec![job]
        }
        None => c.store.jobs()?,
    };
    let mut opened = BTreeMap::new();
    for job in jobs {
        let tiles: BTreeSet<TileIndex> = c
            .store
            .tiles(job.id)?
            .iter()
            .filter(|tile| filter.selects(tile))
            .map(|tile| tile.tile)
            .collect();
        if !tiles.is_empty() {
            let id = job.id;
            opened.insert(id, open_again(changes, job, tiles, true)?);
        }
    }
    Ok(opened)
}

/// Opens tiles of a job whose outputs are lost.
pub(crate) fn open(
    changes: &mut JobChanges<'_>,
    job: JobId,
    tiles: BTreeSet<TileIndex>,
) -> Result<u32, StoreError> {
    let c = changes.coordinator();
    let record = c.store.job(job)?.ok_or(StoreError::UnknownJob { job })?;
    open_again(changes, record, tiles, false)
}

/// Opens tiles of a job, `with` those that were computed from them, and lets the scheduler begin anew with
/// it.
fn open_again(
    changes: &mut JobChanges<'_>,
    job: JobRecord,
    tiles: BTreeSet<TileIndex>,
    with: bool,
) -> Result<u32, StoreError> {
    let c = changes.coordinator();
    let (id, was) = (job.id, job.state.phase());
    let work = stored_spec::whole(&*c.blobs, &job.spec).map(Arc::new);
    if work.is_err()
        && let Some(part) = stored_spec::part(&job.spec).ok().and_then(|(_, part)| part)
        && let Err(e) = c.blobs.open_checked(&part)
        && e.passes()
    {
        return Err(StoreError::BlobWaits {
            what: e.to_string(),
        });
    }
    let again = |record: JobRecord| {
        let work = Arc::clone(work.as_ref().map_err(String::clone)?);
        Job::new(record, work, c.store.tiles(id).map_err(|e| e.to_string())?)
    };
    // A job that another version began cannot be computed again; a result that is wrong must not stay as it
    // is.
    let tiles = match again(job) {
        Ok(job) if with => job.with_dependents(tiles),
        Ok(_) => tiles,
        Err(reason) => {
            tracing::error!(
                "job {id} has results that are not believed any more, and cannot be continued: {reason}"
            );
            tiles
        }
    };
    let tiles: Vec<TileIndex> = tiles.into_iter().collect();
    // An output that was computed from these tiles and is being committed is there before, and opened with
    // them, or finds its lease taken back.
    let no_commits = OutputRemoval::begin(c);
    let opened = changes.invalidate_tiles(&no_commits, id, &tiles)?;
    let text = match was {
        JobPhase::Done => {
            format!("the result is not believed any more; all {opened} tiles are computed again")
        }
        _ if with => format!("{opened} tiles are not believed any more and are computed again"),
        _ => format!("the outputs of {opened} tiles are lost and are computed again"),
    };
    tracing::warn!("job {id}: {text}");
    c.happened(LogEvent::of_job(Kind::Job, id, text));
    let Some(record) = c
        .store
        .job(id)?
        .filter(|record| !record.state.phase().ended())
    else {
        return Ok(opened);
    };
    match again(record) {
        Ok(job) => changes.tell(Event::TakenUp(Box::new(job))),
        Err(reason) => {
            let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
            let failed = sightline_records::JobState::Failed { reason };
            let record = changes.set_state(id, &from, failed)?;
            changes.tell(Event::JobChanged(Box::new(record)));
        }
    }
    Ok(opened)
}
