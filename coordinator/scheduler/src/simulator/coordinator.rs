//! The simulated coordinator around the state machine: streams, outputs, commands of the store, results.

use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_records::{
    CommitOutcome, JobPhase, JobState, MAX_HELPERS, QuarantineRecord, TileCheck, TileResult,
    TileState, TileStats,
};
use sightline_store::StoreError;
use sightline_store::untrusted_tiles;

use super::parts::{
    CommitAnswer, CoordinatorMessage, Refusal, SimulatedEvent, WorkerMessage, digest, output,
};
use super::world::{TTL, World};
use crate::{Admission, Effect, Event, Failure, Now, Right, Scheduler, Settings, StoreCommand};

impl World {
    /// Ends the coordinator and drops all its unfinished work.
    pub(super) fn stop_coordinator(&mut self) {
        self.scheduler = None;
        self.life += 1;
        self.close_store();
        for stream in 0..self.streams.len() {
            if !self.streams[stream].closed {
                self.streams[stream].closed = true;
                self.after(1, SimulatedEvent::DownBroken(stream));
            }
        }
    }

    /// Starts the coordinator on the store.
    pub(super) fn start_coordinator(&mut self) -> Result<(), String> {
        self.open_store()?;
        self.epoch = self.store().begin_epoch().map_err(|e| e.to_string())?;
        let settings = Settings {
            epoch: Epoch(self.epoch),
            ttl: TTL,
            stuck: 60_000,
            seed: self.below(1 << 40),
            spot_check: self.spot_check,
            spot_seed: 5,
        };
        self.scheduler = Some(Scheduler::new(settings));
        self.started = self.now;
        self.ran_before.clear();
        self.claimed.clear();
        self.nothing_is_lost()?;
        for record in self.store().quarantined().map_err(|e| e.to_string())? {
            self.tell(Event::Quarantined(record.worker))?;
        }
        for (id, _) in self.open_jobs() {
            let job = self.job(id);
            let job = if job.record.state == JobState::Running {
                self.ran_before.insert(id);
                job.after_restart()
            } else {
                job
            };
            self.tell(Event::TakenUp(Box::new(job)))?;
        }
        self.begin_faults();
        self.after(1000, SimulatedEvent::Tick(self.life));
        Ok(())
    }

    /// Handles a message of a worker.
    pub(super) fn hears(&mut self, s: usize, up: WorkerMessage) -> Result<(), String> {
        let number = self.streams[s].number;
        match (up, number) {
            (WorkerMessage::Hello(intro), _) => self.welcomes(s, intro),
            (WorkerMessage::Want(n), Some(w)) => self.tell(Event::Wanted(w, n)),
            (WorkerMessage::Drains, Some(w)) => self.tell(Event::Drains(w)),
            (WorkerMessage::Progress(p), Some(_)) => self.tell(Event::Progressed(p)),
            (WorkerMessage::Failed(lease, infrastructure), Some(w)) => {
                let failure = Failure {
                    lease,
                    reason: "it failed".to_owned(),
                    infrastructure,
                };
                self.tell(Event::Failed(w, failure))
            }
            (_, None) => Ok(()),
        }
    }

    fn welcomes(&mut self, s: usize, intro: crate::Introduction) -> Result<(), String> {
        let now = Now {
            ms: self.now,
            unix_ms: self.unix_ms,
        };
        let Some(scheduler) = &mut self.scheduler else {
            return Ok(());
        };
        let effects = scheduler.step(Event::Joined(intro), now);
        scheduler.check()?;
        for effect in effects {
            match effect {
                Effect::Joined(Ok(joined)) => {
                    self.claimed
                        .extend(joined.kept.iter().map(|l| (l.job, l.tile)));
                    self.streams[s].number = Some(joined.worker);
                    self.send_down(s, CoordinatorMessage::Welcome(joined.kept));
                }
                Effect::Joined(Err(_)) => self.send_down(s, CoordinatorMessage::Refused),
                effect => self.carry(effect)?,
            }
        }
        Ok(())
    }

    pub(super) fn answer(&mut self, w: usize, life: u64, id: LeaseId, answer: CommitAnswer) {
        // If the answer is lost, the worker sends the output again.
        let delay = self.delay();
        if self.faults_on() && self.one_in(10) {
            self.after(delay + 1000, SimulatedEvent::Deliver(w, life, id));
        } else {
            self.after(delay, SimulatedEvent::Answered(w, life, id, answer));
        }
    }

    /// Checks an output that arrives and commits it without the scheduler, as a coordinator does.
    pub(super) fn arrives(&mut self, w: usize, life: u64, lease: Lease) -> Result<(), String> {
        let Some(scheduler) = &self.scheduler else {
            self.after(1000, SimulatedEvent::Deliver(w, life, lease.id));
            return Ok(());
        };
        let Some(admission) = scheduler.admit(&lease).ok().filter(Admission::counts) else {
            self.answer(w, life, lease.id, CommitAnswer::NotNeeded);
            return Ok(());
        };
        if self.disk_full {
            self.answer(w, life, lease.id, CommitAnswer::Later);
            return self.tell(Event::DiskFull(lease));
        }
        let broken = self.workers[w].broken && self.one_in(3);
        let bytes = output(lease.job, lease.tile, broken);
        let offered = digest(&bytes);
        let (worker, helpers) = match admission.right {
            Right::Keep { worker, helpers } => (worker, helpers),
            Right::Compare { .. } | Right::Stale => {
                let wait = self.below(30);
                let events = vec![Event::Checked {
                    lease,
                    digest: offered,
                }];
                self.after(
                    wait,
                    SimulatedEvent::Durable(
                        self.life,
                        w,
                        life,
                        events,
                        lease.id,
                        CommitAnswer::Kept,
                    ),
                );
                return Ok(());
            }
        };
        if !self.keep(&bytes) {
            self.answer(w, life, lease.id, CommitAnswer::Later);
            return self.tell(Event::DiskFull(lease));
        }
        let helpers = helpers.into_iter().take(MAX_HELPERS).collect();
        let stats = TileStats {
            samples: 3,
            cells: 1,
            millis: 100,
            worker,
            helpers,
            at_ms: self.now,
            ..TileStats::default()
        };
        let result = TileResult {
            digest: offered,
            bytes: bytes.len() as u64,
            stats: stats.clone(),
        };
        let (digest, answer) = match self.store().commit_tile(lease.job, lease.tile, result) {
            Ok(CommitOutcome::Committed | CommitOutcome::AlreadySame) => {
                (offered, CommitAnswer::Kept)
            }
            Ok(CommitOutcome::Conflict { kept, .. }) => (kept, CommitAnswer::Differs),
            Err(StoreError::IllegalTransition { .. } | StoreError::UnknownJob { .. }) => {
                self.answer(w, life, lease.id, CommitAnswer::NotNeeded);
                return Ok(());
            }
            Err(e) => {
                if self.refused(&e)? == Refusal::Later {
                    self.tell(Event::DiskFull(lease))?;
                }
                self.answer(w, life, lease.id, CommitAnswer::Later);
                return Ok(());
            }
        };
        let mut events = Vec::new();
        if let CommitAnswer::Kept = answer {
            let before = self
                .acknowledged
                .insert((lease.job, lease.tile), bytes.clone());
            if before.is_some_and(|b| b != bytes) {
                return Err(format!("{lease:?} was acknowledged with two outputs"));
            }
        } else if self.spot_check > 0.0 {
            events.push(Event::Differed {
                lease,
                digest: offered,
            });
        }
        let wait = self.below(30);
        let stats = if let CommitAnswer::Kept = answer {
            stats
        } else {
            TileStats::default()
        };
        events.push(Event::Committed {
            lease,
            digest,
            stats,
        });
        self.after(
            wait,
            SimulatedEvent::Durable(self.life, w, life, events, lease.id, answer),
        );
        Ok(())
    }

    /// Executes a command of the store.
    pub(super) fn run_command(&mut self, command: StoreCommand) -> Result<(), String> {
        if self.disk_full {
            return self.tell(Event::Refused(command));
        }
        // A lock prevents reopened tiles before the scheduler receives a commit.
        if matches!(command, StoreCommand::Quarantine { .. }) && self.commits() {
            self.after(1, SimulatedEvent::Run(self.life, Box::new(command)));
            return Ok(());
        }
        let mut events = Vec::new();
        let outcome = self.outcome(&command, &mut events);
        events.into_iter().try_for_each(|event| self.tell(event))?;
        match outcome {
            // The job has changed in the meantime; the scheduler has received that change, or will.
            Ok(()) | Err(StoreError::IllegalTransition { .. } | StoreError::UnknownJob { .. }) => {
                Ok(())
            }
            Err(e) => match self.refused(&e)? {
                Refusal::Later => self.tell(Event::Refused(command)),
                Refusal::Ended => Ok(()),
            },
        }
    }

    /// Returns true if the scheduler has not yet received a commit of the store.
    fn commits(&self) -> bool {
        self.queue.values().any(|event| match event {
            SimulatedEvent::Durable(life, _, _, events, ..) => {
                *life == self.life
                    && events
                        .iter()
                        .any(|event| matches!(event, Event::Committed { .. }))
            }
            _ => false,
        })
    }

    fn outcome(
        &mut self,
        command: &StoreCommand,
        events: &mut Vec<Event>,
    ) -> Result<(), StoreError> {
        let at = self.unix_ms;
        let changed = |record| Event::JobChanged(Box::new(record));
        match command {
            StoreCommand::Bind(id, profile) => {
                events.push(Event::Bound(*id, self.store().bind_profile(*id, profile)?));
            }
            StoreCommand::Start(id) => {
                let from = [JobPhase::Queued];
                events.push(changed(self.store().set_job_state(
                    *id,
                    &from,
                    JobState::Running,
                    at,
                )?));
            }
            StoreCommand::Fail {
                job,
                tile,
                worker,
                reason,
            } => {
                let on = self.store().fail_tile(*job, *tile, worker, reason)?;
                let (job, tile, reason) = (*job, *tile, reason.clone());
                events.push(Event::FailureRecorded {
                    job,
                    tile,
                    on,
                    reason,
                    dead: None,
                });
            }
            StoreCommand::CountDeath {
                job,
                tile,
                worker,
                reason,
            } => {
                let on = self.store().count_death(*job, *tile, worker, reason)?;
                let (job, tile, reason, dead) = (*job, *tile, reason.clone(), Some(worker.clone()));
                events.push(Event::FailureRecorded {
                    job,
                    tile,
                    on,
                    reason,
                    dead,
                });
            }
            StoreCommand::CancelDeath {
                job,
                tile,
                worker,
                reason,
            } => {
                self.store().forget_failure(*job, *tile, worker, reason)?;
            }
            StoreCommand::SetAside {
                job, tiles, reason, ..
            } => {
                for tile in tiles {
                    let digest = [9; 32];
                    match self.store().set_aside_tile(
                        *job,
                        *tile,
                        digest,
                        1,
                        std::slice::from_ref(reason),
                    ) {
                        Ok(()) | Err(StoreError::TileNotOpen { .. }) => {
                            events.push(Event::SetAside {
                                job: *job,
                                tile: *tile,
                                digest,
                            });
                        }
                        Err(e) => return Err(e),
                    }
                }
            }
            StoreCommand::Confirm {
                job,
                tile,
                digest,
                worker,
            } => {
                let check = TileCheck {
                    worker: worker.clone(),
                    at_ms: self.now,
                };
                self.store().confirm_tile(*job, *tile, *digest, check)?;
            }
            StoreCommand::Quarantine {
                workers,
                condemned,
                reason,
            } => {
                for (id, tiles) in untrusted_tiles(self.store(), workers, *condemned)? {
                    let tiles: Vec<_> = self.job(id).with_dependents(tiles).into_iter().collect();
                    let was_done = self.job(id).record.state.phase() == JobPhase::Done;
                    if let Err(e) = self.store().invalidate_tiles(id, &tiles) {
                        // The change may be on the disk although its write failed. It reopens all tiles of a
                        // done job.
                        let opens = |tile: &TileIndex| was_done || tiles.contains(tile);
                        self.acknowledged
                            .retain(|(job, tile), _| *job != id || !opens(tile));
                        return Err(e);
                    }
                    let open = self.store().tiles(id)?;
                    let is_open = |tile: TileIndex| open[tile.at()].state == TileState::Open;
                    self.acknowledged
                        .retain(|(job, tile), _| *job != id || !is_open(*tile));
                    if !self
                        .store()
                        .job(id)?
                        .is_none_or(|job| job.state.phase().ended())
                    {
                        events.push(Event::TakenUp(Box::new(self.job(id))));
                    }
                }
                events.push(Event::Swept);
                for worker in workers {
                    let (worker, reason) = (worker.clone(), reason.clone());
                    self.store().quarantine(QuarantineRecord {
                        worker,
                        at_ms: self.now,
                        reason,
                    })?;
                }
            }
            StoreCommand::FailJob(id, reason) => {
                let from = [JobPhase::Queued, JobPhase::Running];
                let failed = JobState::Failed {
                    reason: reason.clone(),
                };
                events.push(changed(self.store().set_job_state(*id, &from, failed, at)?));
            }
        }
        Ok(())
    }

    /// Ends a job whose tiles are complete.
    pub(super) fn assemble(&mut self, id: JobId) -> Result<(), String> {
        if self.disk_full {
            return self.tell(Event::AssemblyWaits(id));
        }
        match self.store().finish_job(id, [5; 32], 1, self.unix_ms) {
            Ok(record) => self.tell(Event::JobChanged(Box::new(record))),
            Err(
                StoreError::IllegalTransition { .. }
                | StoreError::UnknownJob { .. }
                | StoreError::TilesOpen { .. },
            ) => self.tell(Event::AssemblyDropped(id)),
            Err(e) => match self.refused(&e)? {
                Refusal::Later => self.tell(Event::AssemblyWaits(id)),
                Refusal::Ended => Ok(()),
            },
        }
    }
}
