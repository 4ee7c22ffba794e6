//! The blocking follow-ups of an event: commands to the store, and the assembly of results.
//!
//! No thread holds the scheduler's lock during a call of the store. Commands that change records of jobs hold
//! the lock of `JobChanges`, so the scheduler receives the changes in the order of the store. Commits of tile
//! outputs do not hold it, so that many of them share one sync of the disk.

use std::collections::VecDeque;
use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_records::ids::{Digest, TileIndex};
use sightline_records::{JobPhase, JobState, TileCheck};
use sightline_scheduler::{Event, StoreCommand};
use sightline_store::{BlobError, Blobs, StoreError};

use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::dispatch::follow_ups::FollowUp;
use crate::jobs::invalidate;
use crate::records::JobChanges;
use crate::results::finalize;
use crate::telemetry::events::{EventKind, LogEvent};

/// Passes an event to the scheduler and runs its follow-ups. Blocks on the disk.
pub(crate) fn tell_and_run(c: &Arc<Coordinator>, event: Event) {
    c.tell(event).run(c);
}

impl FollowUps {
    /// Runs the follow-ups, and the follow-ups of their outcomes. Blocks on the disk.
    pub(crate) fn run(self, c: &Arc<Coordinator>) {
        let mut open = VecDeque::from(self.into_list());
        while let Some(follow_up) = open.pop_front() {
            match follow_up {
                FollowUp::Run(command) => open.extend(run(c, command).into_list()),
                FollowUp::Assemble(job) => {
                    let c = Arc::clone(c);
                    std::thread::spawn(move || finalize::finish(&c, job).run(&c));
                }
            }
        }
    }
}

/// Runs a command to the store and passes its outcome to the scheduler.
fn run(c: &Arc<Coordinator>, command: StoreCommand) -> FollowUps {
    let mut changes = JobChanges::begin(c);
    match outcome(&mut changes, &command) {
        Ok(Some(event)) => changes.tell(event),
        Ok(None) => {}
        // Another thread has changed the job in the meantime, and notifies the scheduler of the change.
        Err(StoreError::IllegalTransition { .. } | StoreError::UnknownJob { .. }) => {}
        Err(e) => {
            let text = format!("no tiles are granted for 10 s: {e}");
            tracing::error!("{text}");
            c.record_event(LogEvent::new(EventKind::Coordinator, text));
            changes.tell(Event::Refused(command));
        }
    }
    changes.finish()
}

/// Carries out a command to the store. Returns the event of its outcome.
fn outcome(
    changes: &mut JobChanges<'_>,
    command: &StoreCommand,
) -> Result<Option<Event>, StoreError> {
    let c = changes.coordinator();
    let changed = |record| Ok(Some(Event::JobChanged(Box::new(record))));
    match command {
        StoreCommand::Bind(id, profile) => {
            Ok(Some(Event::Bound(*id, changes.bind_profile(*id, profile)?)))
        }
        StoreCommand::Start(id) => {
            let record = changes.set_state(*id, &[JobPhase::Queued], JobState::Running)?;
            c.record_event(LogEvent::of_job(EventKind::Job, *id, "the job is running"));
            changed(record)
        }
        StoreCommand::Fail {
            job,
            tile,
            worker,
            reason,
        } => {
            let on = changes.fail_tile(*job, *tile, worker, reason)?;
            // The stored outcomes may have caused the failure of the tile.
            c.workers.crews.outcomes.remove((*job, *tile));
            let reason = reason.clone();
            Ok(Some(Event::FailureRecorded {
                job: *job,
                tile: *tile,
                on,
                reason,
                dead: None,
            }))
        }
        // The crew's next leader continues with the outcomes of the dead leader.
        StoreCommand::CountDeath {
            job,
            tile,
            worker,
            reason,
        } => {
            let on = changes.count_death(*job, *tile, worker, reason)?;
            let (reason, dead) = (reason.clone(), Some(worker.clone()));
            Ok(Some(Event::FailureRecorded {
                job: *job,
                tile: *tile,
                on,
                reason,
                dead,
            }))
        }
        StoreCommand::CancelDeath {
            job,
            tile,
            worker,
            reason,
        } => {
            changes.forget_failure(*job, *tile, worker, reason)?;
            Ok(None)
        }
        StoreCommand::SetAside {
            job,
            planned,
            tiles,
            reason,
        } => {
            for &tile in tiles {
                let made = set_aside(&*c.blobs, planned, tile);
                let made = match made {
                    Ok(made) => made,
                    Err(e) => {
                        tracing::error!("tile {tile} of job {job} cannot be set aside: {e}");
                        return Ok(Some(Event::Refused(command.clone())));
                    }
                };
                match changes.set_aside_tile(*job, tile, made.0, made.1, reason) {
                    Ok(()) => {
                        c.workers.crews.outcomes.remove((*job, tile));
                        let text = "is set aside: its cells will show every triangle";
                        tracing::error!("tile {tile} of job {job} {text}");
                        c.telemetry.metrics.tile_set_aside();
                        let text = format!("tile {tile} {text} ({reason})");
                        let what = LogEvent::of_job(EventKind::SetAside, *job, text);
                        c.record_event(LogEvent {
                            tile: Some(tile),
                            ..what
                        });
                    }
                    // A late output was committed in between, and the scheduler receives that commit.
                    Err(StoreError::TileNotOpen { .. }) => {}
                    Err(e) => return Err(e),
                }
                changes.tell(Event::SetAside {
                    job: *job,
                    tile,
                    digest: made.0,
                });
            }
            Ok(None)
        }
        StoreCommand::Confirm {
            job,
            tile,
            digest,
            worker,
        } => {
            let check = TileCheck {
                worker: worker.clone(),
                at_ms: c.now().unix_ms,
            };
            changes.confirm_tile(*job, *tile, *digest, check)?;
            Ok(None)
        }
        StoreCommand::Quarantine {
            workers,
            condemned,
            reason,
        } => {
            invalidate::condemn(changes, workers, *condemned, reason)?;
            Ok(None)
        }
        StoreCommand::FailJob(id, reason) => {
            let failed = JobState::Failed {
                reason: reason.clone(),
            };
            let from = [JobPhase::Queued, JobPhase::Running];
            let record = changes.set_state(*id, &from, failed)?;
            // If a client submits the job again, the new job must not continue from these outcomes.
            c.workers.crews.outcomes.sweep(|job, _| job != *id);
            c.record_event(LogEvent::of_job(
                EventKind::Job,
                *id,
                format!("the job has failed: {reason}"),
            ));
            changed(record)
        }
    }
}
/// Stores the placeholder of a tile. Returns the blob's digest and length in bytes.
fn set_aside(
    blobs: &dyn Blobs,
    planned: &PlannedJob,
    tile: TileIndex,
) -> Result<(Digest, u64), BlobError> {
    let made = sightline_assemble::placeholder(planned, &planned.plan().tiles[tile.at()]);
    let bytes = made.map_err(|e| blobs.io_error(e))?;
    Ok((blobs.put(&bytes)?, bytes.len() as u64))
}
