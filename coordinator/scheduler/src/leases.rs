//! Leases: granted, claimed by returning workers, renewed, ended.

use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_records::JobState;
use sightline_records::ids::{JobId, Lease, LeaseId, WorkerId};

use super::event::{Effect, Note};
use super::messages::{Now, Progress, WorkerCommand};
use super::pools::Profile;
use super::state::{Leased, Scheduler, Timer};

/// Grace period for the leases of a disconnected worker, in milliseconds. A worker that lost its connection
/// reconnects after 0.2, 0.6 and 1.4 s. After the grace period, other workers may get the worker's tiles.
const AWAY: u64 = 1800;
/// The factor on the limit without progress for a tile whose scene is being fetched and prepared.
const PREPARING: u64 = 3;
/// The reason for the end of a lease that its worker has not renewed.
const RAN_OUT: &str = "the lease ran out, because the worker sent no message about the tile";
/// Maximum number of cells or samples accepted for a running tile. The limit prevents an overflow of sums
/// over all tiles.
const MOST_REPORTED: u64 = 1 << 42;

impl Scheduler {
    /// Leases a tile to a worker.
    pub(super) fn lease(&mut self, lease: Lease, worker: WorkerId, profile: Profile, now: Now) {
        let Lease { job, tile, id } = lease;
        let Some(entry) = self.jobs.get_mut(&job) else {
            return;
        };
        let slot = &mut entry.tiles[tile.at()].leases;
        let Some(free) = slot.iter_mut().find(|l| l.is_none()) else {
            return;
        };
        *free = Some(id);
        entry.running += 1;
        entry.update_ready(tile);
        let timer = now.ms + self.settings.ttl.min(self.settings.stuck) + 1;
        let leased = Leased {
            job,
            tile,
            worker,
            profile,
            given: now.ms,
            renewed: now.ms,
            moved: now.ms,
            gone: None,
            cells: 0,
            samples: 0,
            begun: None,
            waits: false,
            timer,
            checks: false,
        };
        debug_assert!(
            !self.leases.table.contains_key(&id),
            "a lease is given once"
        );
        self.leases.table.insert(id, leased);
        self.charge(job);
        self.set_timer(timer, Timer::Lease(id));
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            w.leases.insert(id);
        }
        self.list_job(job);
        self.line_up(worker);
        self.list_worker(worker);
    }

    /// Ends a lease. With `revoke`, sends its worker a command to stop.
    pub(super) fn end_lease(&mut self, id: LeaseId, revoke: bool) {
        let Some(l) = self.leases.table.remove(&id) else {
            return;
        };
        self.remove_missing(l.worker, id);
        self.time.timers.remove(&(l.timer, Timer::Lease(id)));
        self.crew_closed(id);
        self.unline(&l, id);
        // A waiting tile costs its worker no time.
        let idle = if l.waits { self.time.clock } else { l.given };
        self.discharge(l.job, l.begun.unwrap_or(idle));
        if let Some(job) = self.jobs.get_mut(&l.job) {
            job.running -= 1;
            job.running_cells -= l.cells;
            job.running_samples -= l.samples;
            let tile = &mut job.tiles[l.tile.at()];
            tile.leases
                .iter_mut()
                .filter(|lease| **lease == Some(id))
                .for_each(|lease| *lease = None);
            job.update_ready(l.tile);
            self.list_job(l.job);
        }
        if l.gone.is_none() {
            if revoke {
                let lease = Lease {
                    job: l.job,
                    tile: l.tile,
                    id,
                };
                self.effects
                    .push(Effect::Tell(l.worker, WorkerCommand::Revoke(lease)));
            }
            if let Some(w) = self.roster.workers.get_mut(&l.worker) {
                w.leases.remove(&id);
            }
            self.line_up(l.worker);
            self.list_worker(l.worker);
        }
        self.queues.pools.tidy(&l.profile);
    }

    fn unline(&mut self, l: &Leased, id: LeaseId) {
        let place = self.jobs.get(&l.job).map(super::job::OpenJob::place);
        let pool = self.queues.pools.at(&l.profile);
        if let Some(place) = place.filter(|_| l.waits) {
            pool.waiting.remove(&(place, l.tile, id));
        }
        if let Some(begun) = l.begun {
            pool.begun.remove(&(begun, id));
        }
    }

    /// Removes a lease from the list of waiting tiles.
    pub(super) fn stop_waiting(&mut self, id: LeaseId) {
        let Some(l) = self.leases.table.get_mut(&id).filter(|l| l.waits) else {
            return;
        };
        l.waits = false;
        let (job, tile, profile) = (l.job, l.tile, Arc::clone(&l.profile));
        if let Some(place) = self.jobs.get(&job).map(super::job::OpenJob::place) {
            self.queues
                .pools
                .at(&profile)
                .waiting
                .remove(&(place, tile, id));
        }
    }

    /// Revokes all leases of a job.
    pub(super) fn revoke_job(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let leases: Vec<LeaseId> = job.tiles.iter().flat_map(|t| t.leases).flatten().collect();
        leases.into_iter().for_each(|l| self.end_lease(l, true));
    }

    /// Updates the list of waiting tiles: it contains each lease of the worker whose tile has not begun
    /// because the worker computes another tile.
    pub(super) fn line_up(&mut self, worker: WorkerId) {
        let Some(w) = self.roster.workers.get(&worker) else {
            return;
        };
        let leases: Vec<LeaseId> = w.leases.iter().copied().collect();
        let begun = |id: &LeaseId| self.leases.table.get(id).is_some_and(|l| l.begun.is_some());
        let any = leases.iter().any(begun);
        let waits: Vec<bool> = (0..)
            .zip(&leases)
            .map(|(i, l)| !begun(l) && (any || i > 0))
            .collect();
        for (id, waits) in leases.into_iter().zip(waits) {
            let Some(l) = self.leases.table.get_mut(&id).filter(|l| l.waits != waits) else {
                continue;
            };
            l.waits = waits;
            let (job, tile, profile) = (l.job, l.tile, Arc::clone(&l.profile));
            let Some(place) = self.jobs.get(&job).map(super::job::OpenJob::place) else {
                continue;
            };
            let pool = self.queues.pools.at(&profile);
            if waits {
                pool.waiting.insert((place, tile, id));
            } else {
                pool.waiting.remove(&(place, tile, id));
            }
        }
    }

    /// Renews a lease that has not ended, and records the reported progress of its tile.
    pub(super) fn progress(&mut self, progress: &Progress, now: Now) {
        let lease = progress.lease;
        let (cells, samples) = (
            progress.cells.min(MOST_REPORTED),
            progress.samples.min(MOST_REPORTED),
        );
        let Some(l) = self.leases.table.get_mut(&lease.id) else {
            return;
        };
        if (l.job, l.tile) != (lease.job, lease.tile) {
            return;
        }
        l.renewed = now.ms;
        let moved = (l.cells, l.samples) != (cells, samples);
        // A tile that waits for another tile of its worker is not stuck.
        if moved || l.waits {
            l.moved = now.ms;
        }
        if moved && let Some(job) = self.jobs.get_mut(&lease.job) {
            job.running_cells = job.running_cells - l.cells + cells;
            job.running_samples = job.running_samples - l.samples + samples;
        }
        (l.cells, l.samples) = (cells, samples);
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.mark_pace(now);
        }
        if l.begun.is_none() && (cells, samples) != (0, 0) {
            l.begun = Some(now.ms);
            let (worker, profile) = (l.worker, Arc::clone(&l.profile));
            if l.gone.is_none() {
                self.line_up(worker);
            }
            self.queues
                .pools
                .at(&profile)
                .begun
                .insert((now.ms, lease.id));
        }
        if moved {
            self.tell_watchers(lease.job);
        }
    }

    /// Returns the time in milliseconds after which a lease ends, and the reason.
    pub(super) fn deadline(&self, l: &Leased) -> (u64, &'static str) {
        let stuck = self.settings.stuck * if l.begun.is_some() { 1 } else { PREPARING };
        let away = l
            .gone
            .map(|since| (since + AWAY, "the worker disconnected and did not return"));
        let ran_out = (l.renewed + self.settings.ttl, RAN_OUT);
        let stuck = (l.moved + stuck, "the tile makes no progress");
        [away, Some(ran_out), Some(stuck)]
            .into_iter()
            .flatten()
            .min_by_key(|(at, _)| *at)
            .unwrap_or(ran_out)
    }

    /// Sets a lease's timer to the first moment after the lease's deadline.
    pub(super) fn arm(&mut self, id: LeaseId) {
        let Some(l) = self.leases.table.get(&id) else {
            return;
        };
        let (old, new) = (
            l.timer,
            (self.deadline(l).0 + 1).max(self.time.patient_until),
        );
        self.time.timers.remove(&(old, Timer::Lease(id)));
        self.set_timer(new, Timer::Lease(id));
        if let Some(l) = self.leases.table.get_mut(&id) {
            l.timer = new;
        }
    }

    /// Revokes a lease whose deadline has passed. Otherwise sets the lease's timer again.
    pub(super) fn lease_timer(&mut self, id: LeaseId, now: Now) {
        let Some(l) = self.leases.table.get(&id) else {
            return;
        };
        let (deadline, why) = self.deadline(l);
        if now.ms <= deadline || now.ms < self.time.patient_until {
            self.arm(id);
            return;
        }
        let lease = Lease {
            job: l.job,
            tile: l.tile,
            id,
        };
        let worker = l.worker;
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            // Otherwise the worker would be the first to get the tile again, because it holds no tile.
            w.unresponsive = why == RAN_OUT;
            if w.unresponsive && !l.checks {
                w.unheard.get_or_insert(lease);
            }
        }
        let name = self.roster.workers.get(&worker).map(|w| w.name.clone());
        self.note(Note::TakenBack(lease, name, why));
        let checks = self.leases.table.get(&id).is_some_and(|l| l.checks);
        let missing = self.remove_missing(worker, id);
        self.end_lease(id, true);
        if checks {
            self.check_failed(lease.job, lease.tile, now);
        }
        if let Some(missing) = missing {
            self.count_death(missing);
        }
        self.tell_watchers(lease.job);
    }

    /// Returns the leases claimed by a worker that belong to the worker from now on.
    ///
    /// A lease of this epoch counts if it was given to this worker and its tile is free or still leased under
    /// it. The holders of earlier epochs' leases are unknown: the first claim of a tile during the grace
    /// counts, unless tiles of the job were reopened since.
    pub(super) fn claim(&mut self, worker: WorkerId, held: Vec<Lease>, now: Now) -> Vec<Lease> {
        let mut kept = BTreeSet::new();
        // The leases of a quarantined worker do not count.
        if self
            .roster
            .workers
            .get(&worker)
            .is_some_and(|w| self.trust.quarantined.contains(&w.signature))
        {
            return Vec::new();
        }
        for lease in held {
            let same = self.leases.table.get(&lease.id).map(|l| (l.job, l.tile));
            // A paused job's tiles that were being computed are finished.
            let goes_on = |job: &&super::job::OpenJob| match job.record.state {
                JobState::Running => true,
                JobState::Paused | JobState::Queued => same.is_some() || job.grace,
                _ => false,
            };
            let Some(job) = self.jobs.get(&lease.job).filter(goes_on) else {
                continue;
            };
            if lease.tile.at() >= job.tiles.len() || kept.contains(&lease) {
                continue;
            }
            let given_to = job.given_to(lease.id.number, lease.tile);
            let is_own = given_to.is_some()
                && given_to.as_ref() == self.roster.workers.get(&worker).map(|w| &w.signature);
            let given = match lease.id.epoch.cmp(&self.settings.epoch) {
                std::cmp::Ordering::Less => job.grace && same.is_none(),
                std::cmp::Ordering::Equal => is_own,
                std::cmp::Ordering::Greater => false,
            };
            let theirs = same == Some((lease.job, lease.tile))
                && (is_own || lease.id.epoch < self.settings.epoch);
            let counts = lease.id >= job.counts_from;
            let free = same.is_none() && given && counts && job.is_ready(lease.tile);
            let Some(profile) = job.record.profile.as_deref().map(Profile::from) else {
                continue;
            };
            if !free && !theirs {
                continue;
            }
            // The leader's stream to its crew may be intact although this stream broke.
            let leads = self.queues.crews.contains_key(&lease.id);
            let checks = self.leases.table.get(&lease.id).is_some_and(|l| l.checks);
            if theirs {
                self.end_lease(lease.id, false);
            }
            self.lease(lease, worker, profile, now);
            if let Some(l) = self.leases.table.get_mut(&lease.id) {
                l.checks = checks;
            }
            if leads {
                self.crew_opened(lease);
            }
            kept.insert(lease);
            self.tell_watchers(lease.job);
        }
        kept.into_iter().collect()
    }

    /// Handles a command that could not be sent, because the worker does not read its stream.
    pub(super) fn undelivered(&mut self, worker: WorkerId, lease: &Lease, now: Now) {
        self.end_lease(lease.id, false);
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            w.wants = (w.wants + 1).min(super::workers::MOST_HELD);
        }
        self.backpressure(worker, now);
    }
}
