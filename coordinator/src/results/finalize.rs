//! The end of a job: assembles its result, ends the job in the store, and removes unreferenced tile outputs.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, JobState, TileState};
use sightline_scheduler::{Event, Output};
use sightline_store::StoreError;
use sightline_traces::SpanTime;

use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::dispatch::dispatcher::Dispatcher;
use crate::jobs::invalidate;
use crate::jobs::suspend;
use crate::jobs::suspensions::MissingBlob;
use crate::records::{JobChanges, OutputRemoval};
use crate::results::assembly::{AssembleError, AssemblyInput, assemble};
use crate::telemetry::events::{EventKind, LogEvent};

/// Copies the inputs of a complete job's assembly from the scheduler.
fn assembly_input(dispatcher: &Dispatcher, id: JobId) -> Option<AssemblyInput> {
    dispatcher.read(|scheduler| {
        let job = scheduler.job(id)?;
        Some(AssemblyInput {
            planned: Arc::clone(&job.planned),
            profile: job.record.profile.clone().unwrap_or_default(),
            outputs: job.tiles.iter().map(|t| t.output).collect(),
            samples: job.samples,
        })
    })
}

/// Assembles a job's result and ends the job. Returns the follow-ups.
pub(crate) fn finish(c: &Coordinator, id: JobId) -> FollowUps {
    // The scheduler no longer has a job that was cancelled in the meantime.
    let Some(input) = assembly_input(&c.dispatcher, id) else {
        return FollowUps::default();
    };
    let begun = SpanTime::now();
    let aside = |n: u32| matches!(input.outputs[n as usize], Output::SetAside(_));
    let assembled = if input.planned.plan().leaves().all(aside) {
        Err(
            "every tile failed; `sightline show` and the workers' logs contain the reasons"
                .to_owned(),
        )
    } else {
        // A panic must not leave the job partially ended.
        let assembled = catch_unwind(AssertUnwindSafe(|| assemble(c, &input)));
        let bytes = assembled
            .as_ref()
            .ok()
            .and_then(|made| made.as_ref().ok())
            .map(|(_, bytes)| *bytes);
        c.telemetry.spans.assembled(id, begun, bytes);
        match assembled {
            Ok(Err(e)) if e.passes() => {
                tracing::error!("the result of job {id} is delayed and will be retried: {e}");
                return c.tell(Event::AssemblyWaits(id));
            }
            Ok(Err(e)) if e.is_lost() => return handle_lost_input(c, id, &input, &e),
            Ok(r) => r.map_err(|e| e.to_string()),
            Err(_) => Err(
                "assembling the result panicked; the log of the coordinator contains the location"
                    .to_owned(),
            ),
        }
    };
    let mut changes = JobChanges::begin(c);
    let told = |mut changes: JobChanges<'_>, event| {
        changes.tell(event);
        changes.finish()
    };
    // Tiles may have been reopened or computed again during the assembly.
    let now_there = c.dispatcher.read(|scheduler| {
        let job = scheduler.job(id)?;
        Some(job.tiles.iter().map(|t| t.output).collect::<Vec<_>>())
    });
    if now_there.as_ref() != Some(&input.outputs) {
        return told(changes, Event::AssemblyDropped(id));
    }
    let ended = match assembled {
        // Another job with the same result may have been deleted, with the blob, before this job's record
        // could reference the blob.
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
        // The job was paused or cancelled in the meantime. The result stays as a blob, and a later assembly
        // stores the same blob.
        Err(
            StoreError::IllegalTransition { .. }
            | StoreError::UnknownJob { .. }
            | StoreError::TilesOpen { .. }
            | StoreError::ResultDiffers { .. },
        ) => {
            return told(changes, Event::AssemblyDropped(id));
        }
        Err(e) => {
            tracing::error!("job {id} cannot be ended yet and will be retried: {e}");
            return told(changes, Event::AssemblyWaits(id));
        }
    };
    if let JobState::Failed { reason } = &record.state {
        c.record_event(LogEvent::of_job(
            EventKind::Job,
            id,
            format!("the job has failed: {reason}"),
        ));
    }
    if let JobState::Done { bytes, .. } = record.state {
        tracing::info!("job {id} is done, {bytes} bytes");
        c.record_event(LogEvent::of_job(
            EventKind::Job,
            id,
            format!("the job is done, {bytes} bytes"),
        ));
    }
    let done = matches!(record.state, JobState::Done { .. });
    changes.tell(Event::JobChanged(Box::new(record)));
    let follow_ups = changes.finish();
    if done && input.outputs.iter().all(|o| matches!(o, Output::Done(_))) {
        tidy(c, id, &input.outputs);
    }
    follow_ups
}

/// Handles an assembly that failed because an input is lost. Lost outputs are computed again. If the scene or
/// the receivers are lost, the job waits until a client uploads them.
fn handle_lost_input(
    c: &Coordinator,
    id: JobId,
    input: &AssemblyInput,
    e: &AssembleError,
) -> FollowUps {
    if let Some(follow_ups) = compute_again(c, id, &input.outputs, e) {
        return follow_ups;
    }
    let spec = input.planned.spec();
    let mut follow_ups = FollowUps::default();
    let receivers = spec
        .ambient()
        .map(|ambient| MissingBlob::Receivers(ambient.receivers));
    for missing in [Some(MissingBlob::Scene(spec.scene)), receivers]
        .into_iter()
        .flatten()
    {
        if !c
            .blobs
            .open_checked(&missing.digest())
            .is_err_and(|e| e.is_lost())
        {
            continue;
        }
        // Workers that have the blob do not request it, so the assembly may be the first to detect the loss.
        match suspend::suspend_jobs(c, missing, &e.to_string()) {
            Ok((waiting, more)) => {
                follow_ups.extend(more);
                if waiting.contains(&id) {
                    // The assembly runs again after the job continues, which may already be the case.
                    follow_ups.extend(c.tell(Event::AssemblyDropped(id)));
                    return follow_ups;
                }
            }
            Err(e) => tracing::error!("job {id} cannot be paused yet: {e}"),
        }
    }
    // Either the blob exists again, or the job could not be paused, or the disk fails intermittently.
    tracing::error!("the result of job {id} is delayed and will be retried: {e}");
    follow_ups.extend(c.tell(Event::AssemblyWaits(id)));
    follow_ups
}

/// Reopens the tiles whose stored outputs are lost. Returns `None` if no output is lost.
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
        // Remove the damaged blobs before another upload replaces one of them.
        let removal = OutputRemoval::begin(c);
        let broken = lost.iter().map(|(_, digest)| *digest);
        let broken = broken.filter(|d| c.blobs.open_checked(d).is_err_and(|e| e.is_broken()));
        if let Err(e) = removal.remove(broken) {
            tracing::warn!("{e}");
        }
    }
    let tiles = lost.iter().map(|(tile, _)| *tile).collect();
    // The dependent tiles stay done, because they were computed from these outputs before the loss.
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

/// Removes the tile outputs of a finished job, whose result contains them. An output stays if another job
/// needs it: an open job, or a job that can be retried.
fn tidy(c: &Coordinator, finished: JobId, outputs: &[Output]) {
    // No thread commits outputs during this removal, so a newly committed output is not removed.
    let removal = OutputRemoval::begin(c);
    let mut free: BTreeSet<Digest> = outputs.iter().filter_map(Output::digest).collect();
    let ids = c.dispatcher.read(|scheduler| scheduler.job_ids());
    for id in ids {
        // Lock the scheduler once per job, so that messages of workers can acquire the lock in between.
        c.dispatcher.read(|scheduler| {
            let tiles = scheduler.job(id).map_or(&[][..], |job| &job.tiles);
            for digest in tiles.iter().filter_map(|tile| tile.output.digest()) {
                free.remove(&digest);
            }
        });
    }
    let ended = c.records.jobs().and_then(|jobs| {
        let retriable = |j: &JobRecord| {
            // Among done jobs, only jobs with tiles set aside still need their outputs.
            j.id != finished && j.state.phase().ended()
        };
        for job in jobs.iter().filter(|j| retriable(j)) {
            let tiles = c.records.tiles(job.id)?;
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
        tracing::warn!("the tile outputs of job {finished} cannot be removed: {e}");
    }
}
