//! What surrounds the state machine in a coordinator: streams, outputs, commands of the store, results.

use super::parts::{Answer, Down, Happening, Up};
use super::world::{TTL, World};
use crate::ids::{Epoch, JobId, Lease, LeaseId};
use crate::scheduler::{Command, Effect, Event, Failure, Machine, Now, Settings};
use crate::store::{
    CommitOutcome, JobPhase, JobState, Store as _, StoreError, TileResult, TileState, TileStats,
};

impl World {
    /// Ends the coordinator, with everything that it has not finished.
    pub(super) fn stop_coordinator(&mut self) {
        self.machine = None;
        self.life += 1;
        for stream in 0..self.streams.len() {
            if !self.streams[stream].closed {
                self.streams[stream].closed = true;
                self.after(1, Happening::DownBroken(stream));
            }
        }
    }

    /// Starts the coordinator on the store.
    pub(super) fn start_coordinator(&mut self) -> Result<(), String> {
        self.epoch = self.store.begin_epoch().map_err(|e| e.to_string())?;
        let settings = Settings {
            epoch: Epoch(self.epoch),
            ttl: TTL,
            stuck: 60_000,
            seed: self.below(1 << 40),
            spot_check: 0.0,
            spot_seed: 0,
        };
        self.machine = Some(Machine::new(settings));
        self.started = self.now;
        self.ran_before.clear();
        self.claimed.clear();
        self.nothing_is_lost()?;
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
        self.after(1000, Happening::Tick(self.life));
        Ok(())
    }

    /// Handles a message of a worker.
    pub(super) fn hears(&mut self, s: usize, up: Up) -> Result<(), String> {
        let number = self.streams[s].number;
        match (up, number) {
            (Up::Hello(intro), _) => self.welcomes(s, intro),
            (Up::Want(n), Some(w)) => self.tell(Event::Wanted(w, n)),
            (Up::Drains, Some(w)) => self.tell(Event::Drains(w)),
            (Up::Progress(p), Some(_)) => self.tell(Event::Progressed(p)),
            (Up::Failed(lease, infrastructure), Some(w)) => {
                let failure = Failure { lease, reason: "it failed".to_owned(), infrastructure };
                self.tell(Event::Failed(w, failure))
            }
            (_, None) => Ok(()),
        }
    }

    fn welcomes(&mut self, s: usize, intro: crate::scheduler::Introduction) -> Result<(), String> {
        let now = Now { ms: self.now, unix_ms: self.unix_ms };
        let Some(machine) = &mut self.machine else { return Ok(()) };
        let effects = machine.step(Event::Joined(intro), now);
        machine.check()?;
        for effect in effects {
            match effect {
                Effect::Joined(Ok(joined)) => {
                    self.claimed.extend(joined.kept.iter().map(|l| (l.job, l.tile)));
                    self.streams[s].number = Some(joined.worker);
                    self.send_down(s, Down::Welcome(joined.kept));
                }
                Effect::Joined(Err(_)) => self.send_down(s, Down::Refused),
                effect => self.carry(effect)?,
            }
        }
        Ok(())
    }

    pub(super) fn answer(&mut self, w: usize, life: u64, id: LeaseId, answer: Answer) {
        // An answer may be lost; the worker then sends the output again.
        let delay = self.delay();
        if self.faults_on() && self.one_in(10) {
            self.after(delay + 1000, Happening::Deliver(w, life, id));
        } else {
            self.after(delay, Happening::Answered(w, life, id, answer));
        }
    }

    /// An output has arrived: it is checked, and committed without the machine, as in a coordinator.
    pub(super) fn arrives(&mut self, w: usize, life: u64, lease: Lease) -> Result<(), String> {
        let Some(machine) = &self.machine else {
            self.after(1000, Happening::Deliver(w, life, lease.id));
            return Ok(());
        };
        if !machine.admit(&lease).is_ok_and(|a| a.counts) {
            self.answer(w, life, lease.id, Answer::NotNeeded);
            return Ok(());
        }
        if self.disk_full {
            self.answer(w, life, lease.id, Answer::Later);
            return self.tell(Event::DiskFull(lease));
        }
        let broken = self.workers[w].broken && self.one_in(3);
        let mut digest = [0; 32];
        digest[..8].copy_from_slice(&lease.job.0.to_le_bytes());
        digest[8..12].copy_from_slice(&lease.tile.0.to_le_bytes());
        digest[31] = u8::from(broken);
        let stats =
            TileStats { samples: 3, cells: 1, millis: 100, worker: format!("w{w}"), ..TileStats::default() };
        let result = TileResult { digest, bytes: 1, stats: stats.clone() };
        let (digest, answer) = match self.store.commit_tile(lease.job, lease.tile, result) {
            Ok(CommitOutcome::Committed | CommitOutcome::AlreadySame) => (digest, Answer::Kept),
            Ok(CommitOutcome::Conflict { kept, .. }) => (kept, Answer::Differs),
            Err(StoreError::IllegalTransition { .. } | StoreError::UnknownJob { .. }) => {
                self.answer(w, life, lease.id, Answer::NotNeeded);
                return Ok(());
            }
            Err(e) => return Err(e.to_string()),
        };
        if let Answer::Kept = answer {
            let before = self.acknowledged.insert((lease.job, lease.tile), digest);
            if before.is_some_and(|b| b != digest) {
                return Err(format!("{lease:?} was acknowledged with two outputs"));
            }
        }
        let wait = self.below(30);
        let event = Box::new(Event::Committed { lease, digest, stats });
        self.after(wait, Happening::Durable(self.life, w, life, event, lease.id, answer));
        Ok(())
    }

    /// Carries out a command of the store.
    pub(super) fn run_command(&mut self, command: Command) -> Result<(), String> {
        if self.disk_full {
            return self.tell(Event::Refused(command));
        }
        let at = self.unix_ms;
        let turned = match command {
            Command::Bind(id, profile) => {
                let Ok(bound) = self.store.bind_profile(id, &profile) else { return Ok(()) };
                return self.tell(Event::Bound(id, bound));
            }
            Command::Start(id) => self.store.set_job_state(id, &[JobPhase::Queued], JobState::Running, at),
            Command::Fail { job, tile, worker, reason } => {
                let on = self.store.fail_tile(job, tile, &worker, &reason).map_err(|e| e.to_string())?;
                return self.tell(Event::FailureRecorded { job, tile, on, reason });
            }
            Command::SetAside { job, tiles, reason, .. } => {
                for tile in tiles {
                    match self.store.set_aside_tile(job, tile, [9; 32], 1, std::slice::from_ref(&reason)) {
                        Ok(()) | Err(StoreError::TileNotOpen { .. }) => {
                            self.tell(Event::SetAside { job, tile, digest: [9; 32] })?;
                        }
                        Err(_) => return Ok(()),
                    }
                }
                return Ok(());
            }
            // No schedule has checks.
            Command::Confirm { .. } | Command::Quarantine { .. } => return Ok(()),
            Command::FailJob(id, reason) => {
                let from = [JobPhase::Queued, JobPhase::Running];
                self.store.set_job_state(id, &from, JobState::Failed { reason }, at)
            }
        };
        match turned {
            Ok(record) => self.tell(Event::JobChanged(Box::new(record))),
            Err(_) => Ok(()),
        }
    }

    /// Ends a job whose tiles are complete.
    pub(super) fn assemble(&mut self, id: JobId) -> Result<(), String> {
        if self.disk_full {
            return self.tell(Event::AssemblyWaits(id));
        }
        match self.store.finish_job(id, [5; 32], 1, self.unix_ms) {
            Ok(record) => self.tell(Event::JobChanged(Box::new(record))),
            Err(StoreError::IllegalTransition { .. } | StoreError::UnknownJob { .. }) => {
                self.tell(Event::AssemblyDropped(id))
            }
            Err(e) => Err(e.to_string()),
        }
    }

    /// Every output that was acknowledged is in the store, unchanged.
    pub(super) fn nothing_is_lost(&self) -> Result<(), String> {
        for ((job, tile), digest) in &self.acknowledged {
            let kept = self.store.tile(*job, *tile).map_err(|e| e.to_string())?.state;
            if !matches!(&kept, TileState::Done { digest: d, .. } if d == digest) {
                return Err(format!("the output of tile {tile} of job {job} is lost: {kept:?}"));
            }
        }
        Ok(())
    }
}
