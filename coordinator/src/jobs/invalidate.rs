//! Invalidation of results: the results of a worker that returned wrong bytes, or results that a user names.
//!
//! The tiles of these results are computed again, with all tiles that were computed from them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, QuarantineRecord};
use sightline_scheduler::{Event, OpenJob};
use sightline_store::{StoreError, TileFilter, untrusted_tiles};

use crate::jobs::stored_spec;
use crate::records::{JobChanges, OutputRemoval};
use crate::telemetry::events::{EventKind, LogEvent};

/// Quarantines workers, and reopens the tiles that they committed after their last confirmed output.
pub(crate) fn condemn(
    changes: &mut JobChanges<'_>,
    workers: &[String],
    condemned: Option<(JobId, TileIndex)>,
    reason: &str,
) -> Result<(), StoreError> {
    let c = changes.coordinator();
    // The quarantine is recorded last. If the coordinator crashes earlier, the next check detects the worker
    // again.
    for (job, tiles) in untrusted_tiles(c.records.queries(), workers, condemned)? {
        if let Some(record) = c.records.job(job)? {
            open_again(changes, record, tiles, true)?;
        }
    }
    // The workers may have computed outcomes of phases of open tiles, so these are computed again, too.
    c.workers.crews.outcomes.sweep(|_, _| false);
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
            "WORKER {worker} IS QUARANTINED: {reason}. The tiles since its last correct output are \
             computed again. Check its machine, driver and program; `sightline workers --release \
             {worker}` ends the quarantine"
        );
        tracing::error!("{text}");
        c.record_event(LogEvent::new(EventKind::Worker, text).on(worker));
    }
    Ok(())
}

/// Reopens tiles. Returns the number of reopened tiles of each job.
pub(crate) fn invalidate(
    changes: &mut JobChanges<'_>,
    filter: &TileFilter,
) -> Result<BTreeMap<JobId, u32>, StoreError> {
    let c = changes.coordinator();
    let jobs = match filter.job {
        Some(id) => {
            let job = c
                .records
                .job(id)?
                .ok_or(StoreError::UnknownJob { job: id })?;
            if let Some(&tile) = filter.tiles.iter().find(|tile| tile.0 >= job.tiles) {
                return Err(StoreError::UnknownTile {
                    job: id,
                    tile,
                    tiles: job.tiles,
                });
            }
            vec![job]
        }
        None => c.records.jobs()?,
    };
    let mut opened = BTreeMap::new();
    for job in jobs {
        let tiles: BTreeSet<TileIndex> = c
            .records
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

/// Reopens tiles of a job whose outputs are lost. Returns the number of reopened tiles.
pub(crate) fn open(
    changes: &mut JobChanges<'_>,
    job: JobId,
    tiles: BTreeSet<TileIndex>,
) -> Result<u32, StoreError> {
    let c = changes.coordinator();
    let record = c.records.job(job)?.ok_or(StoreError::UnknownJob { job })?;
    open_again(changes, record, tiles, false)
}

/// Reopens tiles of a job, and passes the job to the scheduler again. If `with` is true, reopens the tiles
/// that were computed from them, too.
fn open_again(
    changes: &mut JobChanges<'_>,
    job: JobRecord,
    tiles: BTreeSet<TileIndex>,
    with: bool,
) -> Result<u32, StoreError> {
    let c = changes.coordinator();
    let (id, was) = (job.id, job.state.phase());
    let planned = stored_spec::whole(&*c.blobs, &job.spec).map(Arc::new);
    if planned.is_err()
        && let Some(part) = stored_spec::part(&job.spec).ok().and_then(|(_, part)| part)
        && let Err(e) = c.blobs.open_checked(&part)
        && e.passes()
    {
        return Err(StoreError::BlobWaits {
            what: e.to_string(),
        });
    }
    let again = |record: JobRecord| {
        let planned = Arc::clone(planned.as_ref().map_err(String::clone)?);
        OpenJob::new(
            record,
            planned,
            c.records.tiles(id).map_err(|e| e.to_string())?,
        )
    };
    // A job of another version cannot be computed again, but its wrong result must not stay.
    let tiles = match again(job) {
        Ok(job) if with => job.with_dependents(tiles),
        Ok(_) => tiles,
        Err(reason) => {
            tracing::error!("job {id} has untrusted results and cannot be continued: {reason}");
            tiles
        }
    };
    let tiles: Vec<TileIndex> = tiles.into_iter().collect();
    // Commits wait for this removal. An output computed from these tiles is either committed before it, and
    // reopened with them, or its lease is revoked.
    let no_commits = OutputRemoval::begin(c);
    let opened = changes.invalidate_tiles(&no_commits, id, &tiles)?;
    let text = match was {
        JobPhase::Done => {
            format!("the result is invalidated; all {opened} tiles are computed again")
        }
        _ if with => format!("{opened} tiles are invalidated and computed again"),
        _ => format!("the outputs of {opened} tiles are lost and are computed again"),
    };
    tracing::warn!("job {id}: {text}");
    c.record_event(LogEvent::of_job(EventKind::Job, id, text));
    let Some(record) = c
        .records
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
            // If a client submits the job again, the new job must not continue from these outcomes.
            c.workers.crews.outcomes.sweep(|other, _| other != id);
            changes.tell(Event::JobChanged(Box::new(record)));
        }
    }
    Ok(opened)
}
