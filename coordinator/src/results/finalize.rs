//! The end of a job: assembles its result, ends it in the store, and removes tile outputs that no job needs
//! any more.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, JobState, TileState};
use sightline_scheduler::{Event, Output};
use sightline_store::StoreError;
use sightline_traces::Begun;

use crate::dispatch::{FollowUps, tell};
use crate::jobs::invalidate;
use crate::jobs::suspend;
use crate::records::{JobChanges, OutputRemoval};
use crate::results::assembly::{AssembleError, AssemblyInput, assemble};
use crate::state::{Coordinator, MissingBlob};
use crate::telemetry::events::{Kind, LogEvent};

/// A complete job, copied from the scheduler.
fn parts(c: &Coordinator, id: JobId) -> Option<AssemblyInput> {
    let scheduling = c.lock();
    let job = scheduling.scheduler.job(id)?;
    Some(AssemblyInput {
        work: Arc::clone(&job.work),
        profile: job.record.profile.clone().unwrap_or_default(),
        outputs: job.tiles.iter().map(|t| t.output).collect(),
        samples: job.samples,
    })
}

/// Assembles a job's result and ends the job.
pub(crate) fn finish(c: &Coordinator, id: JobId) -> FollowUps {
    // Absent when it was cancelled in the meantime.
    let Some(parts) = parts(c, id) else {
        return FollowUps::default();
    };
    let begun = Begun::now();
    let aside = |n: u32| matches!(parts.outputs[n as usize], Output::SetAside(_));
    let assembled = if parts.work.plan().leaves().all(aside) {
        Err("every tile failed; `sightline show` and the workers' logs say why".to_owned())
    } else {
        // A panic must not leave the job half ended.
        let assembled = catch_unwind(AssertUnwindSafe(|| assemble(c, &parts)));
        let bytes = assembled
            .as_ref()
            .ok()
            .and_then(|made| made.as_ref().ok())
            .map(|(_, bytes)| *bytes);
        c.spans.assembled(id, begun, bytes);
        match assembled {
            Ok(Err(e)) if e.passes() => {
                tracing::error!("the result of job {id} waits and is tried again: {e}");
                return tell(c, Event::AssemblyWaits(id));
            }
            Ok(Err(e)) if e.is_lost() => return do_without(c, id, &parts, &e),
            Ok(r) => r.map_err(|e| e.to_string()),
            Err(_) => {
                Err("assembling the result panicked; the coordinator's log says where".to_owned())
            }
        }
    };
    let mut changes = JobChanges::begin(c);
    let told = |mut changes: JobChanges<'_>, event| {
        changes.tell(event);
        changes.finish()
    };
    // Tiles may have been opened again, or computed again, while the result was assembled.
    let now_there = c
        .lock()
        .scheduler
        .job(id)
        .map(|job| job.tiles.iter().map(|t| t.output).collect::<Vec<_>>());
    if now_there.as_ref() != Some(&parts.outputs) {
        return told(changes, Event::AssemblyDropped(id));
    }
    let ended = match assembled {
        // Another job with the same bytes may have been deleted before this one's record could name them.
        Ok((digest, _)) if !c.blobs.has(&digest).unwrap_or(true) => {
            return told(changes, Event::AssemblyDropped(id));
        }
        Ok((digest, bytes)) => changes.finish_job(id, digest, bytes),
        Err(e) => {
            tracing::error!("job {id} has no result: {e}");
            let failed = JobState::Failed { reason: e };
            changes.set_state(id, &[JobPhase::Queued, JobPhase::Running], failed)
        }
    };
    let record = match ended {
        Ok(record) => record,
        // Paused or cancelled in the meantime: the result stays as a blob and is found again by its content.
        Err(
            StoreError::IllegalTransition { .. }
            | StoreError::UnknownJob { .. }
            | StoreError::TilesOpen { .. }
            | StoreError::ResultDiffers { .. },
        ) => {
            return told(changes, Event::AssemblyDropped(id));
        }
        Err(e) => {
            tracing::error!("job {id} cannot be ended and is tried again: {e}");
            return told(changes, Event::AssemblyWaits(id));
        }
    };
    if let JobState::Failed { reason } = &record.state {
        c.happened(LogEvent::of_job(
            Kind::Job,
            id,
            format!("the job has failed: {reason}"),
        ));
    }
    if let JobState::Done { bytes, .. } = record.state {
        tracing::info!("job {id} is done, {bytes} bytes");
        c.happened(LogEvent::of_job(
            Kind::Job,
            id,
            format!("the job is done, {bytes} bytes"),
        ));
    }
    let done = matches!(record.state, JobState::Done { .. });
    changes.tell(Event::JobChanged(Box::new(record)));
    let follow_ups = changes.finish();
    if done && parts.outputs.iter().all(|o| matches!(o, Output::Done(_))) {
        tidy(c, id, &parts.outputs);
    }
    follow_ups
}

/// Something that the result is made from is lost. Outputs are computed again; for its scene or its receivers
/// the job waits until somebody sends them.
fn do_without(c: &Coordinator, id: JobId, parts: &AssemblyInput, e: &AssembleError) -> FollowUps {
    if let Some(follow_ups) = compute_again(c, id, &parts.outputs, e) {
        return follow_ups;
    }
    let spec = parts.work.spec();
    let mut follow_ups = FollowUps::default();
    let receivers = spec
        .ambient()
        .map(|ambient| MissingBlob::Receivers(ambient.receivers));
    for lacks in [Some(MissingBlob::Scene(spec.scene)), receivers]
        .into_iter()
        .flatten()
    {
        if !c
            .blobs
            .open_checked(&lacks.digest())
            .is_err_and(|e| e.is_lost())
        {
            continue;
        }
        // Workers that have it do not ask for it, so this may be the first to find it lost.
        match suspend::lost(c, lacks, &e.to_string()) {
            Ok((waiting, more)) => {
                follow_ups.extend(more);
                if waiting.contains(&id) {
                    // Assembled once it goes on, which it may do already.
                    follow_ups.extend(tell(c, Event::AssemblyDropped(id)));
                    return follow_ups;
                }
            }
            Err(e) => tracing::error!("job {id} cannot be paused yet: {e}"),
        }
    }
    // It is there again, or the job could not be paused, or the disk cannot read it every time.
    tracing::error!("the result of job {id} waits and is tried again: {e}");
    follow_ups.extend(tell(c, Event::AssemblyWaits(id)));
    follow_ups
}

/// Opens the tiles again whose stored outputs are lost; `None` when none are.
fn compute_again(
    c: &Coordinator,
    id: JobId,
    outputs: &[Output],
    e: &AssembleError,
) -> Option<FollowUps> {
    let lost = |output: &Output| {
        let digest = output.digest()?;
        c.blobs
            .open_checked(&digest)
            .is_err_and(|e| e.is_lost())
            .then_some(digest)
    };
    let lost: Vec<(TileIndex, Digest)> = (0u32..)
        .zip(outputs)
        .filter_map(|(at, output)| Some((TileIndex(at), lost(output)?)))
        .collect();
    if lost.is_empty() {
        return None;
    }
    tracing::error!("{e}; {} tiles of job {id} are computed again", lost.len());
    let mut changes = JobChanges::begin(c);
    {
        // Before another upload replaces one.
        let removal = OutputRemoval::begin(c);
        let broken = lost.iter().map(|(_, digest)| *digest);
        let broken = broken.filter(|d| c.blobs.open_checked(d).is_err_and(|e| e.is_broken()));
        if let Err(e) = removal.remove(broken) {
            tracing::warn!("{e}");
        }
    }
    let tiles = lost.iter().map(|(tile, _)| *tile).collect();
    // Their dependents were computed from the earlier outputs.
    match invalidate::open(&mut changes, id, tiles) {
        Ok(_) => {}
        Err(StoreError::UnknownJob { .. }) => changes.tell(Event::AssemblyDropped(id)),
        Err(e) => {
            tracing::error!("job {id} cannot be continued yet: {e}");
            changes.tell(Event::AssemblyWaits(id));
        }
    }
    Some(changes.finish())
}

/// Removes the tile outputs of a finished job, whose result contains them, unless another job needs them: one
/// that has not ended or that can be retried.
fn tidy(c: &Coordinator, finished: JobId, outputs: &[Output]) {
    // No output is committed meanwhile, so none that is committed is removed.
    let removal = OutputRemoval::begin(c);
    let mut free: BTreeSet<Digest> = outputs.iter().filter_map(Output::digest).collect();
    let ids = c.lock().scheduler.job_ids();
    for id in ids {
        // Job by job, so that heartbeats get the lock in between.
        if let Some(job) = c.lock().scheduler.job(id) {
            job.tiles
                .iter()
                .filter_map(|t| t.output.digest())
                .for_each(|d| {
                    free.remove(&d);
                });
        }
    }
    let ended = c.store.jobs().and_then(|jobs| {
        let retriable = |j: &JobRecord| {
            // Of those that are done, only ones with tiles set aside.
            j.id != finished && j.state.phase().ended()
        };
        for job in jobs.iter().filter(|j| retriable(j)) {
            let tiles = c.store.tiles(job.id)?;
            let is_whole = tiles
                .iter()
                .all(|tile| matches!(tile.state, TileState::Done { .. }));
            if job.state.phase() == JobPhase::Done && is_whole {
                continue;
            }
            for tile in tiles {
                if let TileState::Done { digest, .. } | TileState::SetAside { digest, .. } =
                    tile.state
                {
                    free.remove(&digest);
                }
            }
        }
        Ok(())
    });
    let unneeded = outputs.iter().filter_map(Output::digest);
    let unneeded = unneeded.filter(|d| free.contains(d));
    if let Err(e) = ended.and_then(|()| removal.remove(unneeded)) {
        tracing::warn!("the tile outputs of job {finished} are kept: {e}");
    }
}
