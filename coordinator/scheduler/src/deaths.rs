//! Workers that end without a message.
//!
//! The death of a worker is a failure of the tile that it held first.
//!
//! A worker whose stream has ended is missing. If the same process returns, it was not dead. A missing worker
//! is dead once another process joins under its name, or once its lease ends. If a dead worker returns after
//! all, only its network had failed, and its death is cancelled. If a dead worker had several leases, only
//! its oldest lease counts as a failure, because the worker fetched the other tiles in advance.

use sightline_records::ids::{Lease, LeaseId, WorkerId};

use super::death::{Death, DeathOf, Missing};
use super::event::{Effect, Note, StoreCommand};
use super::job::Output;
use super::state::{Scheduler, Worker};

/// Maximum number of deaths that can be cancelled. The scheduler forgets the oldest deaths first.
const MAX_DEATHS: usize = 4096;
/// The reason that the store records for a death.
const REASON: &str = "the connection of the worker ended while it computed the tile";

impl Scheduler {
    /// Records that the stream of a worker that did not drain has ended.
    pub(super) fn miss(&mut self, id: WorkerId, worker: &Worker) {
        let (name, instance) = (worker.name.clone(), worker.instance);
        if let Some(lease) = worker.unheard {
            self.count_death(Missing {
                name,
                instance,
                lease,
            });
            return;
        }
        let Some(first) = worker.leases.first().copied() else {
            return;
        };
        if let Some(l) = self.leases.table.get(&first).filter(|l| !l.checks) {
            let lease = Lease {
                job: l.job,
                tile: l.tile,
                id: first,
            };
            self.deaths.missing.insert(
                id,
                Missing {
                    name,
                    instance,
                    lease,
                },
            );
        }
    }

    /// Records that a process has joined. Either a missing worker has returned, or the missing workers of the
    /// same name are dead.
    pub(super) fn note_return(&mut self, name: &str, instance: u64) {
        if instance == 0 {
            return;
        }
        self.deaths
            .missing
            .retain(|_, missing| missing.instance != instance);
        self.cancel_deaths(instance);
        let dead: Vec<WorkerId> = self
            .deaths
            .missing
            .iter()
            .filter(|(_, m)| m.name == name)
            .map(|(id, _)| *id)
            .collect();
        for id in dead {
            let Some(missing) = self.deaths.missing.remove(&id) else {
                continue;
            };
            let theirs = |(_, l): &(&LeaseId, &super::state::Leased)| l.worker == id;
            let leases: Vec<LeaseId> = self
                .leases
                .table
                .iter()
                .filter(theirs)
                .map(|(lease, _)| *lease)
                .collect();
            leases
                .into_iter()
                .for_each(|lease| self.end_lease(lease, false));
            self.count_death(missing);
        }
    }

    /// Removes and returns the missing worker with this first lease.
    pub(super) fn remove_missing(&mut self, worker: WorkerId, lease: LeaseId) -> Option<Missing> {
        self.deaths
            .missing
            .get(&worker)
            .filter(|missing| missing.lease.id == lease)?;
        self.deaths.missing.remove(&worker)
    }

    /// Counts the death of a worker as a failure of the tile that the worker held first.
    pub(super) fn count_death(&mut self, missing: Missing) {
        let Missing {
            name,
            instance,
            lease,
        } = missing;
        let Lease { job: id, tile, .. } = lease;
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job
            .tiles
            .get_mut(tile.at())
            .filter(|t| t.output == Output::Open)
        else {
            return;
        };
        t.deaths.push(instance);
        t.judged = true;
        job.update_ready(tile);
        if self.deaths.recent.len() == MAX_DEATHS {
            self.deaths.recent.pop_front();
        }
        self.deaths.recent.push_back(Death {
            name: name.clone(),
            instance,
            job: id,
            tile,
        });
        self.note(Note::Died(lease, name.clone()));
        self.deaths
            .recording
            .insert((id, tile, name.clone()), false);
        let reason = REASON.to_owned();
        self.effects.push(Effect::Run(StoreCommand::CountDeath {
            job: id,
            tile,
            worker: name,
            reason,
        }));
        self.list_job(id);
        self.tell_watchers(id);
    }

    /// Decides on a tile after the store has recorded a death. If the death was cancelled in the meantime,
    /// removes it from the store again.
    pub(super) fn death_recorded(&mut self, subject: DeathOf, on: u32, reason: &str) {
        if !self.deaths.recording.remove(&subject).unwrap_or(false) {
            self.judge(subject.0, subject.1, on, true, reason);
            return;
        }
        let (id, tile, worker) = subject;
        let reason = REASON.to_owned();
        self.effects.push(Effect::Run(StoreCommand::CancelDeath {
            job: id,
            tile,
            worker,
            reason,
        }));
        if let Some(job) = self.jobs.get_mut(&id)
            && let Some(t) = job.tiles.get_mut(tile.at())
        {
            t.judged = false;
            job.update_ready(tile);
        }
        self.set_orphan_aside(id, tile);
        self.list_job(id);
        self.tell_watchers(id);
    }

    /// Cancels the deaths of a process that has returned.
    fn cancel_deaths(&mut self, instance: u64) {
        let (back, rest): (Vec<Death>, Vec<Death>) = std::mem::take(&mut self.deaths.recent)
            .into_iter()
            .partition(|death| death.instance == instance);
        self.deaths.recent = rest.into();
        for Death {
            name,
            job: id,
            tile,
            ..
        } in back
        {
            if let Some(t) = self
                .jobs
                .get_mut(&id)
                .and_then(|job| job.tiles.get_mut(tile.at()))
            {
                t.deaths.retain(|dead| *dead != instance);
            }
            // The store records one failure per name, which also represents the death of another process.
            if self
                .deaths
                .recent
                .iter()
                .any(|other| (&other.name, other.job, other.tile) == (&name, id, tile))
            {
                continue;
            }
            let key = (id, tile, name);
            // A cancellation that overtook the record would leave the record in the store.
            if let Some(is_cancelled) = self.deaths.recording.get_mut(&key) {
                *is_cancelled = true;
                continue;
            }
            let (worker, reason) = (key.2, REASON.to_owned());
            self.effects.push(Effect::Run(StoreCommand::CancelDeath {
                job: id,
                tile,
                worker,
                reason,
            }));
        }
    }
}
