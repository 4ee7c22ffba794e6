//! Workers that end without a word: the death of a worker is a failure of the tile that it held first.
//!
//! A worker whose stream has ended is missing. If the same process returns, nothing has happened. It is dead
//! when another process joins under its name, or when its lease ends. A dead worker that returns after all
//! had lost its network only: its death is cancelled. Of several leases of a dead worker the first one given
//! counts, so that tiles fetched in advance are not blamed.

use sightline_records::ids::{Lease, LeaseId, WorkerId};

use super::death::{Death, DeathOf, Missing};
use super::event::{Effect, Note, StoreCommand};
use super::job::Output;
use super::state::{Scheduler, Worker};

/// Maximum number of deaths that can be cancelled; the scheduler forgets the oldest ones first.
const MAX_DEATHS: usize = 4096;
/// The reason that is kept with a tile.
const REASON: &str = "the worker ended without a word while it held the tile";

impl Scheduler {
    /// Notes that the stream of a worker that did not drain has ended.
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
        if let Some(l) = self.leases.get(&first).filter(|l| !l.checks) {
            let lease = Lease {
                job: l.job,
                tile: l.tile,
                id: first,
            };
            self.missing.insert(
                id,
                Missing {
                    name,
                    instance,
                    lease,
                },
            );
        }
    }

    /// Notes that a process has joined: either a missing one has returned, or the missing ones of its name
    /// are dead.
    pub(super) fn note_return(&mut self, name: &str, instance: u64) {
        if instance == 0 {
            return;
        }
        self.missing
            .retain(|_, missing| missing.instance != instance);
        self.cancel_deaths(instance);
        let dead: Vec<WorkerId> = self
            .missing
            .iter()
            .filter(|(_, m)| m.name == name)
            .map(|(id, _)| *id)
            .collect();
        for id in dead {
            let Some(missing) = self.missing.remove(&id) else {
                continue;
            };
            let theirs = |(_, l): &(&LeaseId, &super::state::Leased)| l.worker == id;
            let leases: Vec<LeaseId> = self
                .leases
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

    /// Removes and returns the missing worker whose first lease this is.
    pub(super) fn remove_missing(&mut self, worker: WorkerId, lease: LeaseId) -> Option<Missing> {
        self.missing
            .get(&worker)
            .filter(|missing| missing.lease.id == lease)?;
        self.missing.remove(&worker)
    }

    /// Counts the death of a worker as a failure of its tile.
    pub(super) fn count_death(&mut self, of: Missing) {
        let Missing {
            name,
            instance,
            lease,
        } = of;
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
        if self.deaths.len() == MAX_DEATHS {
            self.deaths.pop_front();
        }
        self.deaths.push_back(Death {
            name: name.clone(),
            instance,
            job: id,
            tile,
        });
        self.note(Note::Died(lease, name.clone()));
        self.recording.insert((id, tile, name.clone()), false);
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

    /// Judges a tile after the store has recorded a death. A death that was cancelled before is taken
    /// out of the store again.
    pub(super) fn death_recorded(&mut self, of: DeathOf, on: u32, reason: &str) {
        if !self.recording.remove(&of).unwrap_or(false) {
            self.judge(of.0, of.1, (on, true), reason);
            return;
        }
        let (id, tile, worker) = of;
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
        let (back, rest): (Vec<Death>, Vec<Death>) = std::mem::take(&mut self.deaths)
            .into_iter()
            .partition(|death| death.instance == instance);
        self.deaths = rest.into();
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
            // The store keeps one failure for a name: it also stands for the death of another process.
            if self
                .deaths
                .iter()
                .any(|other| (&other.name, other.job, other.tile) == (&name, id, tile))
            {
                continue;
            }
            let key = (id, tile, name);
            // A cancellation that overtook the record would leave it there.
            if let Some(is_cancelled) = self.recording.get_mut(&key) {
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
