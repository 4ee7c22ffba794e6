//! Who gets which tile: higher priorities first, then the user whose turn it is, then the oldest job, then
//! the plan's order.
//!
//! A worker holds a second tile only while there are more ready tiles than idle workers. When no tile is
//! ready, an idle worker takes over a tile that waits in the hands of a busy one. At the end of a job it gets
//! a second lease on a tile that takes much longer than the others.

use std::sync::Arc;

use sightline_records::JobPhase;
use sightline_records::ids::{JobId, Lease, LeaseId, TileIndex, WorkerId};

use super::event::{Effect, Note, StoreCommand};
use super::messages::{Grant, Now, WorkerCommand};
use super::pools::{List, Profile};
use super::spot_check::Name;
use super::state::Scheduler;

/// A tile gets a second lease after this many times the mean of its job, and not before this many
/// milliseconds.
const STRAGGLES: u64 = 2;
const LEAST_STRAGGLE: u64 = 5000;
/// Second leases of a profile in one tick.
const MOST_DOUBLED: usize = 16;

impl Scheduler {
    /// Puts a job into the list in which it belongs now.
    pub(super) fn list_job(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let ready = job.ready.len();
        let fit = ready > 0 && self.allowed(job) && !job.grace && job.parked.is_none();
        let list = match &job.record.profile {
            Some(profile) => List::Bound(Profile::from(profile.as_str())),
            None => List::Unbound(Self::choice_of(job)),
        };
        let fit = fit && (job.record.profile.is_some() || !job.pending);
        let belongs = fit.then_some((list, ready));
        if job.listed == belongs {
            if let Some((List::Bound(profile), _)) = belongs {
                self.pools.dirty.insert(profile);
            }
            return;
        }
        self.unlist_job(id);
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let (place, whom) = (job.place(), job.whom.clone());
        job.listed = belongs.clone();
        let share = self.share(&whom.user);
        match &belongs {
            Some((List::Bound(profile), ready)) => {
                let pool = self.pools.at(profile);
                pool.jobs.insert(&whom, share, id);
                pool.ready += ready;
            }
            Some((List::Unbound(choice), _)) => {
                self.pools.unbound[*choice].insert(place);
            }
            None => {}
        }
    }

    /// Takes a job out of its list.
    pub(super) fn unlist_job(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let (place, whom) = (job.place(), job.whom.clone());
        let listed = job.listed.take();
        let share = self.share(&whom.user);
        match listed {
            Some((List::Bound(profile), ready)) => {
                let pool = self.pools.at(&profile);
                pool.jobs.remove(&whom, share, &id);
                pool.ready -= ready;
                self.pools.tidy(&profile);
            }
            Some((List::Unbound(choice), _)) => {
                self.pools.unbound[choice].remove(&place);
            }
            None => {}
        }
    }

    /// Grants what can be granted.
    pub(super) fn settle(&mut self, now: Now) {
        if self.paused_until.is_some() {
            return;
        }
        // First, so that a job without a profile does not wait until those with one leave a worker over.
        while self.bind_one(now) {}
        while let Some(profile) = self.pools.dirty.pop_first() {
            while self.settle_one(&profile, now) {}
            while self.send_helper(&profile) {}
        }
    }

    /// Takes the next decision about a profile; returns whether there may be another one.
    fn settle_one(&mut self, profile: &Profile, now: Now) -> bool {
        let Some(pool) = self.pools.of.get(profile) else {
            return false;
        };
        let idle = pool.hungry[0].first().copied();
        let busy = pool.hungry[1]
            .first()
            .copied()
            .filter(|_| pool.ready > pool.idle.len());
        if let Some(worker) = idle
            && !self.spotted.is_empty()
            && self.check_first(worker, profile, now)
        {
            return true;
        }
        let Some(pool) = self.pools.of.get(profile) else {
            return false;
        };
        let Some((_, &id)) = pool.jobs.first() else {
            // Only tiles that are leased to busy workers remain.
            let Some(&(_, tile, lease)) = pool.waiting.iter().find(|w| self.may_move_tile(w.2))
            else {
                return false;
            };
            return idle.is_some_and(|worker| self.take_over(worker, tile, lease, now));
        };
        let Some(worker) = idle.or(busy) else {
            return false;
        };
        if self.serve(worker, now) {
            return true;
        }
        // Nothing for this worker: the first job waits for the store, or has to be told that it runs.
        self.start(id);
        false
    }

    /// Whether a waiting tile may go to another worker: not while its job is paused, and no check.
    fn may_move_tile(&self, lease: LeaseId) -> bool {
        let Some(l) = self.leases.get(&lease).filter(|l| !l.checks) else {
            return false;
        };
        self.jobs.get(&l.job).is_some_and(|job| self.allowed(job))
    }

    /// Asks the store to note that a job runs, before its first tile is leased.
    pub(super) fn start(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        if job.record.state.phase() == JobPhase::Queued && !job.pending {
            job.pending = true;
            self.effects.push(Effect::Run(StoreCommand::Start(id)));
        }
    }

    /// Grants a worker the first tile that it may have; returns whether there was one.
    fn serve(&mut self, worker: WorkerId, now: Now) -> bool {
        let Some(w) = self.workers.get(&worker) else {
            return false;
        };
        let busy = !w.leases.is_empty();
        let first = |profile: &Profile| {
            let pool = self.pools.of.get(profile)?;
            let (turn, &id) = pool.jobs.first()?;
            let job = self.jobs.get(&id)?;
            let may = job.record.state.phase() == JobPhase::Running && !job.pending;
            (may && (!busy || pool.ready > pool.idle.len()))
                .then(|| (turn.clone(), id, Arc::clone(profile)))
        };
        let Some((_, id, profile)) = w.profiles.iter().filter_map(first).min() else {
            return false;
        };
        let Some(tile) = self.jobs.get(&id).and_then(|j| j.ready.first().copied()) else {
            return false;
        };
        self.grant(worker, id, tile, profile, now);
        true
    }

    /// Grants a tile to a worker.
    pub(super) fn grant(
        &mut self,
        worker: WorkerId,
        id: JobId,
        tile: TileIndex,
        profile: Profile,
        now: Now,
    ) {
        let able = self.pools.of.get(&profile).map_or(1, |p| p.able);
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let lease = LeaseId {
            epoch: self.settings.epoch,
            number: self.next_lease,
        };
        self.next_lease += 1;
        let name = self
            .workers
            .get(&worker)
            .map(|w| Name::clone(&w.signature))
            .unwrap_or_default();
        job.given.push((lease.number, tile, name));
        let grant = Grant {
            lease: Lease {
                job: id,
                tile,
                id: lease,
            },
            work: Arc::clone(&job.work),
            packs: job.packs(tile),
            millis: job.millis_for_a_tile(able, now),
            profile: profile.to_string(),
        };
        if let Some(w) = self.workers.get_mut(&worker) {
            w.wants -= 1;
        }
        self.call_back(worker);
        self.effects
            .push(Effect::Tell(worker, WorkerCommand::Grant(Box::new(grant))));
        self.lease(lease, (id, tile), worker, profile, now);
        self.tell_watchers(id);
    }

    /// Gives an idle worker the waiting tile of a busy one.
    fn take_over(&mut self, worker: WorkerId, tile: TileIndex, lease: LeaseId, now: Now) -> bool {
        let Some(l) = self.leases.get(&lease) else {
            return false;
        };
        let (job, profile) = (l.job, Arc::clone(&l.profile));
        let from = self
            .workers
            .get(&l.worker)
            .map(|w| w.name.clone())
            .unwrap_or_default();
        self.note(Note::TakenOver(
            Lease {
                job,
                tile,
                id: lease,
            },
            from,
        ));
        self.end_lease(lease, true);
        self.grant(worker, job, tile, profile, now);
        true
    }

    /// Gives idle workers second leases on tiles that take much longer than others of their job.
    pub(super) fn find_stragglers(&mut self, now: Now) {
        if self.only.is_some() || self.paused_until.is_some() {
            return;
        }
        let hungry = self
            .pools
            .of
            .iter()
            .filter(|(_, p)| !p.hungry[0].is_empty() && p.ready == 0);
        let profiles: Vec<Profile> = hungry.map(|(profile, _)| Arc::clone(profile)).collect();
        for profile in profiles {
            // A few at a time: this looks at the longest leases one by one.
            for _ in 0..MOST_DOUBLED {
                if !self.double_one(&profile, now) {
                    break;
                }
            }
        }
    }

    fn double_one(&mut self, profile: &Profile, now: Now) -> bool {
        let Some(pool) = self.pools.of.get(profile).filter(|p| p.waiting.is_empty()) else {
            return false;
        };
        let Some(&worker) = pool.hungry[0].first() else {
            return false;
        };
        let long = pool
            .begun
            .iter()
            .take_while(|(begun, _)| begun + LEAST_STRAGGLE < now.ms);
        let straggler = long
            .map(|(begun, id)| (now.ms - begun, id))
            .find_map(|(ran, id)| {
                let l = self.leases.get(id)?;
                let job = self.jobs.get(&l.job)?;
                let alone = job.tiles[l.tile.at()].leases.iter().flatten().count() == 1;
                let mean = job.millis / u64::from(job.done.max(1));
                let long = job.done > 0 && ran > STRAGGLES * mean;
                // Idle workers help a crew better than by computing its tile once more.
                let alone = alone && !self.crews.contains_key(id);
                let may = alone
                    && long
                    && !l.checks
                    && l.gone.is_none()
                    && job.work.spec().time_budget().is_none();
                (may && self.allowed(job) && !job.pending).then_some((l.job, l.tile, *id))
            });
        let Some((job, tile, id)) = straggler else {
            return false;
        };
        self.note(Note::Doubled(Lease { job, tile, id }));
        self.grant(worker, job, tile, Arc::clone(profile), now);
        true
    }

    /// Ends the wait of a tile after a fault.
    pub(super) fn tile_timer(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job.tiles.get_mut(tile.at()) else {
            return;
        };
        if t.not_before.is_some_and(|until| until <= now.ms) {
            t.not_before = None;
            if t.missing > 0 && self.paused_until.is_some() {
                // The store rejects commands for now.
                self.back_off(id, tile, now);
                return;
            }
            job.update_ready(tile);
            self.list_job(id);
            // The store may have rejected the command that sets it aside.
            self.set_orphan_aside(id, tile);
        }
    }
}
