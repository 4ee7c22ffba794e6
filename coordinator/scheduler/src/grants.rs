//! The assignment of tiles to workers.
//!
//! Tiles are assigned by priority, then by user, then by the age of the job, then in the plan's order.
//!
//! A worker holds a second tile only while the number of ready tiles exceeds the number of idle workers. If
//! no tile is ready, an idle worker takes over a waiting tile of a busy worker. At the end of a job, an idle
//! worker gets a second lease on a tile that takes much longer than the others.

use std::sync::Arc;

use sightline_records::JobPhase;
use sightline_records::ids::{JobId, Lease, LeaseId, TileIndex, WorkerId};

use super::event::{Effect, Note, StoreCommand};
use super::messages::{Grant, Now, WorkerCommand};
use super::pools::{List, Profile};
use super::spot_check::Name;
use super::state::Scheduler;

/// The factor on the job's mean tile time after which a tile gets a second lease. The minimum is
/// `LEAST_STRAGGLE` milliseconds.
const STRAGGLES: u64 = 2;
const LEAST_STRAGGLE: u64 = 5000;
/// Maximum number of second leases that the scheduler grants for a profile in one tick.
const MOST_DOUBLED: usize = 16;

impl Scheduler {
    /// Lists a job under its profile, or among the jobs without a profile. Removes a job from the lists if
    /// none of its tiles can be leased now.
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
                self.queues.pools.dirty.insert(profile);
            }
            return;
        }
        self.unlist_job(id);
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let (place, key) = (job.place(), job.key.clone());
        job.listed = belongs.clone();
        let share = self.share(&key.user);
        match &belongs {
            Some((List::Bound(profile), ready)) => {
                let pool = self.queues.pools.at(profile);
                pool.jobs.insert(&key, share, id);
                pool.ready += ready;
            }
            Some((List::Unbound(choice), _)) => {
                self.queues.pools.unbound[*choice].insert(place);
            }
            None => {}
        }
    }

    /// Removes a job from its list.
    pub(super) fn unlist_job(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let (place, key) = (job.place(), job.key.clone());
        let listed = job.listed.take();
        let share = self.share(&key.user);
        match listed {
            Some((List::Bound(profile), ready)) => {
                let pool = self.queues.pools.at(&profile);
                pool.jobs.remove(&key, share, &id);
                pool.ready -= ready;
                self.queues.pools.tidy(&profile);
            }
            Some((List::Unbound(choice), _)) => {
                self.queues.pools.unbound[choice].remove(&place);
            }
            None => {}
        }
    }

    /// Grants all tiles that can be granted now.
    pub(super) fn settle(&mut self, now: Now) {
        if self.time.paused_until.is_some() {
            return;
        }
        // Bind jobs first: otherwise a job without a profile waits until bound jobs leave a worker idle.
        while self.bind_one(now) {}
        while let Some(profile) = self.queues.pools.dirty.pop_first() {
            while self.settle_one(&profile, now) {}
            while self.send_helper(&profile) {}
        }
    }

    /// Grants a check, a ready tile or a waiting tile to a worker of a profile. Returns true if another grant
    /// may follow.
    fn settle_one(&mut self, profile: &Profile, now: Now) -> bool {
        let Some(pool) = self.queues.pools.by_profile.get(profile) else {
            return false;
        };
        let idle = pool.hungry[0].first().copied();
        let busy = pool.hungry[1]
            .first()
            .copied()
            .filter(|_| pool.ready > pool.idle.len());
        if let Some(worker) = idle
            && !self.trust.spotted.is_empty()
            && self.check_first(worker, profile, now)
        {
            return true;
        }
        let Some(pool) = self.queues.pools.by_profile.get(profile) else {
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
        // The worker gets no tile: the first job waits for the store, or the store must record that this job
        // runs.
        self.start(id);
        false
    }

    /// Returns true if a waiting tile may move to another worker. Checks and tiles of paused jobs may not.
    fn may_move_tile(&self, lease: LeaseId) -> bool {
        let Some(l) = self.leases.table.get(&lease).filter(|l| !l.checks) else {
            return false;
        };
        self.jobs.get(&l.job).is_some_and(|job| self.allowed(job))
    }

    /// Tells the store to record that a job runs, before its first tile is leased.
    pub(super) fn start(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        if job.record.state.phase() == JobPhase::Queued && !job.pending {
            job.pending = true;
            self.effects.push(Effect::Run(StoreCommand::Start(id)));
        }
    }

    /// Grants a worker the first tile that it may have. Returns true if the worker got a tile.
    fn serve(&mut self, worker: WorkerId, now: Now) -> bool {
        let Some(w) = self.roster.workers.get(&worker) else {
            return false;
        };
        let busy = !w.leases.is_empty();
        let first = |profile: &Profile| {
            let pool = self.queues.pools.by_profile.get(profile)?;
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
        let able = self
            .queues
            .pools
            .by_profile
            .get(&profile)
            .map_or(1, |p| p.able);
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        self.leases.count += 1;
        let lease = Lease {
            job: id,
            tile,
            id: LeaseId {
                epoch: self.settings.epoch,
                number: self.leases.count,
            },
        };
        let name = self
            .roster
            .workers
            .get(&worker)
            .map(|w| Name::clone(&w.signature))
            .unwrap_or_default();
        job.given.push((lease.id.number, tile, name));
        let grant = Grant {
            lease,
            planned: Arc::clone(&job.planned),
            packs: job.packs(tile),
            millis: job.millis_for_a_tile(able, now),
            profile: profile.to_string(),
        };
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            w.wants -= 1;
        }
        self.call_back(worker);
        self.effects
            .push(Effect::Tell(worker, WorkerCommand::Grant(Box::new(grant))));
        self.lease(lease, worker, profile, now);
        self.tell_watchers(id);
    }

    /// Moves the waiting tile of a busy worker to an idle worker.
    fn take_over(&mut self, worker: WorkerId, tile: TileIndex, lease: LeaseId, now: Now) -> bool {
        let Some(l) = self.leases.table.get(&lease) else {
            return false;
        };
        let (job, profile) = (l.job, Arc::clone(&l.profile));
        let from = self
            .roster
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
        if self.only.is_some() || self.time.paused_until.is_some() {
            return;
        }
        let hungry = self
            .queues
            .pools
            .by_profile
            .iter()
            .filter(|(_, p)| !p.hungry[0].is_empty() && p.ready == 0);
        let profiles: Vec<Profile> = hungry.map(|(profile, _)| Arc::clone(profile)).collect();
        for profile in profiles {
            // Only a few leases per tick, because `double_one` inspects the longest leases one by one.
            for _ in 0..MOST_DOUBLED {
                if !self.double_one(&profile, now) {
                    break;
                }
            }
        }
    }

    fn double_one(&mut self, profile: &Profile, now: Now) -> bool {
        let Some(pool) = self
            .queues
            .pools
            .by_profile
            .get(profile)
            .filter(|p| p.waiting.is_empty())
        else {
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
                let l = self.leases.table.get(id)?;
                let job = self.jobs.get(&l.job)?;
                let alone = job.tiles[l.tile.at()].leases.iter().flatten().count() == 1;
                let mean = job.millis / u64::from(job.done.max(1));
                let long = job.done > 0 && ran > STRAGGLES * mean;
                // Idle workers are more useful as helpers of a crew than by computing its tile again.
                let alone = alone && !self.queues.crews.contains_key(id);
                let may = alone
                    && long
                    && !l.checks
                    && l.gone.is_none()
                    && job.planned.spec().time_budget().is_none();
                (may && self.allowed(job) && !job.pending).then_some((l.job, l.tile, *id))
            });
        let Some((job, tile, id)) = straggler else {
            return false;
        };
        self.note(Note::Doubled(Lease { job, tile, id }));
        self.grant(worker, job, tile, Arc::clone(profile), now);
        true
    }

    /// Ends the delay of a tile after a fault.
    pub(super) fn tile_timer(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job.tiles.get_mut(tile.at()) else {
            return;
        };
        if t.not_before.is_some_and(|until| until <= now.ms) {
            t.not_before = None;
            if t.missing > 0 && self.time.paused_until.is_some() {
                // The store rejects commands for now.
                self.back_off(id, tile, now);
                return;
            }
            job.update_ready(tile);
            self.list_job(id);
            // The store may have rejected the command that sets the tile aside.
            self.set_orphan_aside(id, tile);
        }
    }
}
