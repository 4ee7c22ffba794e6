//! The scheduler: jobs that have not ended, their tiles, the connected workers and the leases.
//!
//! Its state is in memory and can be derived again from the store and from the workers' introductions. The
//! scheduler decides which worker gets which tile; the store keeps the results.

mod binding;
mod job;
mod messages;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use self::binding::{Binding, CLEARLY, fastest, profile_for};
pub(crate) use self::job::{Job, Leased, Slot, cells_total};
pub(crate) use self::messages::{
    Grant, Introduction, Joined, NameTaken, Order, Outbox, ProfileTime, Progress,
};
use sightline_proto::v1;

use crate::clock::Moment;
use crate::ids::{Epoch, JobId, Lease, LeaseId, TileIndex, WorkerId};
use crate::store::{JobPhase, JobRecord, JobState, Store, StoreError, TileRecord, TileState};

/// How long a worker may take to time its backends before another worker times its own.
const TIMING_LIMIT: Duration = Duration::from_secs(300);
/// How long no tiles are granted after the store could not be written.
const PAUSE: Duration = Duration::from_secs(10);
/// Tiles that a worker may hold: one that it works on and one that it fetches.
const MOST_HELD: u32 = 2;
/// Failures of one tile after which it is set aside, when fewer than three workers are there to try it.
pub(crate) const MAX_ATTEMPTS: u32 = 5;
/// Faults of machines or networks after which the failures of a tile count against the tile.
pub(crate) const MAX_FAULTS: u32 = 12;

/// A connected worker.
pub(crate) struct Worker {
    pub(crate) name: String,
    instance: u64,
    profiles: Vec<String>,
    wants: u32,
    draining: bool,
    out: Box<dyn Outbox>,
}

/// The scheduler.
pub(crate) struct Scheduler {
    epoch: Epoch,
    next_lease: u64,
    next_worker: u64,
    pub(crate) jobs: BTreeMap<JobId, Job>,
    pub(crate) workers: BTreeMap<WorkerId, Worker>,
    paused_until: Option<Instant>,
    only: Option<JobId>,
}

/// How a worker's stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Departure {
    /// The worker had said that it takes no more tiles.
    Drained,
    /// The worker had said nothing; it may return for its leases.
    Lost,
}

impl Scheduler {
    /// A scheduler without jobs and workers.
    pub(crate) fn new(epoch: Epoch) -> Self {
        Self {
            epoch,
            next_lease: 1,
            next_worker: 1,
            jobs: BTreeMap::new(),
            workers: BTreeMap::new(),
            paused_until: None,
            only: None,
        }
    }

    /// From now on grants tiles of `job` alone. A bake in one process does not continue other bakes of its
    /// store.
    pub(crate) fn restrict_to(&mut self, job: JobId) {
        self.only = Some(job);
    }

    /// Adds a job with the recorded states of its tiles.
    ///
    /// # Errors
    /// The reason, when the stored specification or plan was made by another version of the program.
    pub(crate) fn take_up(
        &mut self,
        record: JobRecord,
        spec: &v1::JobSpec,
        tiles: Vec<TileRecord>,
    ) -> Result<(), String> {
        let job = Job::of(record, spec, tiles)?;
        self.jobs.insert(job.record.id, job);
        Ok(())
    }

    /// Adds a worker whose stream has begun. Of the leases that it names it keeps those that nobody else has.
    ///
    /// # Errors
    /// [`NameTaken`] when another worker of this name is connected. The same worker, told by its instance,
    /// replaces its earlier stream; workers that send no instance are all accepted.
    pub(crate) fn join(
        &mut self,
        intro: Introduction,
        out: Box<dyn Outbox>,
        now: Instant,
    ) -> Result<Joined, NameTaken> {
        let Introduction { name, instance, profiles, held } = intro;
        if instance != 0 {
            if self.workers.values().any(|w| w.name == name && w.instance != 0 && w.instance != instance) {
                return Err(NameTaken { name });
            }
            // The coordinator may not have noticed yet that the worker's earlier stream is broken.
            self.workers.retain(|_, w| w.instance != instance);
        }
        let worker = WorkerId(self.next_worker);
        self.next_worker += 1;
        let mut kept = Vec::new();
        for lease in held {
            let Some(job) = self.jobs.get_mut(&lease.job) else { continue };
            let Some(slot) = job.slots.get_mut(lease.tile.at()) else { continue };
            let free = match &slot.lease {
                None => matches!(slot.state, TileState::Open),
                // The same lease, from the worker's earlier stream.
                Some(l) => l.id == lease.id,
            };
            if free {
                slot.lease = Some(Leased::new(lease.id, worker, now));
                kept.push(lease);
            }
        }
        self.workers.insert(worker, Worker { name, instance, profiles, wants: 0, draining: false, out });
        Ok(Joined { worker, epoch: self.epoch, kept })
    }

    /// Removes a worker whose stream has ended. Its leases live a little longer, so that it can return for
    /// them, unless it had said that it was draining.
    pub(crate) fn leave(&mut self, worker: WorkerId, now: Instant) -> Departure {
        let draining = self.workers.remove(&worker).is_some_and(|w| w.draining);
        for job in self.jobs.values_mut() {
            for slot in &mut job.slots {
                // It will not return for a tile that was granted while it announced that it drains.
                slot.lease.take_if(|l| draining && l.worker == worker);
                if let Some(l) = slot.lease.as_mut().filter(|l| l.worker == worker) {
                    l.gone = Some(now);
                }
            }
            if job.timing.is_some_and(|(w, _)| w == worker) {
                job.timing = None;
            }
        }
        if draining { Departure::Drained } else { Departure::Lost }
    }

    /// Notes that a worker wants this many more tiles.
    pub(crate) fn want(&mut self, worker: WorkerId, tiles: u32) {
        if let Some(w) = self.workers.get_mut(&worker) {
            // A worker that wants more than it may hold is at fault.
            w.wants = w.wants.saturating_add(tiles).min(MOST_HELD);
        }
    }

    /// Notes that a worker takes no more tiles; returns whether that is news.
    pub(crate) fn drain(&mut self, worker: WorkerId) -> bool {
        let Some(w) = self.workers.get_mut(&worker) else { return false };
        w.wants = 0;
        !std::mem::replace(&mut w.draining, true)
    }

    /// Renews a lease; returns whether it is still the worker's.
    pub(crate) fn renew(&mut self, progress: &Progress, now: Instant) -> bool {
        let Progress { lease, cells, samples } = *progress;
        let Some(leased) = self.leased(&lease) else { return false };
        leased.renewed = now;
        // A tile that has not begun waits for the one before it; it is not stuck.
        let waiting = cells == 0 && samples == 0;
        if waiting || (leased.cells, leased.samples) != (cells, samples) {
            leased.moved = now;
        }
        (leased.cells, leased.samples) = (cells, samples);
        true
    }

    fn leased(&mut self, lease: &Lease) -> Option<&mut Leased> {
        self.jobs.get_mut(&lease.job)?.leased(lease)
    }

    /// Gives a lease up; returns whether it was valid.
    pub(crate) fn release(&mut self, lease: &Lease) -> bool {
        if self.leased(lease).is_none() {
            return false;
        }
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.slots[lease.tile.at()].lease = None;
        }
        true
    }

    /// Takes leases back whose worker has gone, that were not renewed for `ttl`, or whose tile made no
    /// progress for `stuck`; returns how many.
    pub(crate) fn reap(&mut self, now: Instant, ttl: Duration, stuck: Duration) -> usize {
        let mut revoked = Vec::new();
        for (id, job) in &mut self.jobs {
            if job.timing.is_some_and(|(_, since)| now - since > TIMING_LIMIT) {
                job.timing = None;
            }
            for (tile, slot) in (0..).map(TileIndex).zip(&mut job.slots) {
                let Some(why) = slot.lease.as_ref().and_then(|l| l.over(now, ttl, stuck)) else { continue };
                let Some(l) = slot.lease.take() else { continue };
                let from = self.workers.get(&l.worker).map(|w| format!(" from worker {}", w.name));
                tracing::warn!("tile {tile} of job {id} is taken back{}: {why}", from.unwrap_or_default());
                revoked.push((l.worker, Lease { job: *id, tile, id: l.id }));
            }
        }
        for (worker, lease) in &revoked {
            if let Some(w) = self.workers.get(worker) {
                w.out.offer(Order::Revoke(*lease));
            }
        }
        revoked.len()
    }

    /// Takes back all leases of a job.
    pub(crate) fn revoke_job(&mut self, job: JobId) {
        let Some(entry) = self.jobs.get_mut(&job) else { return };
        for (tile, slot) in (0..).map(TileIndex).zip(&mut entry.slots) {
            if let Some(l) = slot.lease.take()
                && let Some(w) = self.workers.get(&l.worker)
            {
                w.out.offer(Order::Revoke(Lease { job, tile, id: l.id }));
            }
        }
    }

    /// Grants no tiles for a while.
    pub(crate) fn pause_leasing(&mut self, now: Instant) {
        self.paused_until = Some(now + PAUSE);
    }

    /// Grants tiles to the workers that want some: those of the oldest job first, in the plan's order.
    ///
    /// # Errors
    /// The store's, when a job's state could not be written.
    pub(crate) fn grant_tiles(&mut self, store: &dyn Store, now: Moment) -> Result<(), StoreError> {
        if self.paused_until.is_some_and(|until| now.at < until) {
            return Ok(());
        }
        self.paused_until = None;
        let workers: Vec<WorkerId> = self.workers.keys().copied().collect();
        // One tile each in turn, so that the first worker does not get two while another has none.
        loop {
            let mut granted = false;
            for worker in &workers {
                granted |= self.grant_one(*worker, store, now)?;
            }
            if !granted {
                return Ok(());
            }
        }
    }

    /// Grants one tile to a worker, or lets it time its backends; returns whether it got a tile.
    fn grant_one(&mut self, number: WorkerId, store: &dyn Store, now: Moment) -> Result<bool, StoreError> {
        if self.workers.get(&number).is_none_or(|w| w.wants == 0 || w.draining) {
            return Ok(false);
        }
        // Workers that can run each profile.
        let mut able: BTreeMap<String, u64> = BTreeMap::new();
        for profile in self.workers.values().flat_map(|w| &w.profiles) {
            *able.entry(profile.clone()).or_default() += 1;
        }
        let leased = self.jobs.values().flat_map(|j| &j.slots).filter_map(|s| s.lease.as_ref());
        let busy: BTreeSet<WorkerId> = leased.map(|l| l.worker).collect();
        // The profiles of other idle workers: these get the remaining tiles before any worker gets a second
        // one.
        let idle: Vec<Vec<String>> = self
            .workers
            .iter()
            .filter(|(n, w)| **n != number && !w.draining && !busy.contains(n))
            .map(|(_, w)| w.profiles.clone())
            .collect();
        let Some(worker) = self.workers.get_mut(&number) else { return Ok(false) };
        for (id, job) in &mut self.jobs {
            let runs = matches!(job.record.state, JobState::Queued | JobState::Running);
            if !runs || self.only.is_some_and(|only| only != *id) {
                continue;
            }
            let Some(profile) = job.record.profile.clone() else {
                match profile_for(job.spec.backend, &worker.profiles) {
                    Binding::Bind(profile) => {
                        job.record.profile = Some(store.bind_profile(*id, &profile)?);
                    }
                    Binding::Time if job.timing.is_none() => {
                        if worker.out.offer(Order::Time { job: *id, spec: Box::new(job.spec.clone()) }) {
                            job.timing = Some((number, now.at));
                        }
                        continue;
                    }
                    Binding::Time | Binding::Cannot => continue,
                }
                // The store may have bound the job to another profile than this worker's.
                return self.grant_one(number, store, now);
            };
            if !worker.profiles.contains(&profile) {
                continue;
            }
            let idle = idle.iter().filter(|profiles| profiles.contains(&profile)).count();
            let mut ready =
                (0..job.slots.len()).map(|t| TileIndex(t as u32)).filter(|t| job.ready(*t, now.at));
            let (first, more) = (ready.next(), ready.take(idle).count());
            let (tile, from) = match (first, busy.contains(&number)) {
                (Some(_), true) if more < idle => continue,
                (Some(tile), _) => (tile, None),
                // Only tiles that are leased to busy workers remain.
                (None, false) => match job.waiting() {
                    Some((tile, l)) => (tile, Some((l.worker, Lease { job: *id, tile, id: l.id }))),
                    None => continue,
                },
                (None, true) => continue,
            };
            if job.record.state == JobState::Queued {
                job.record = store.set_job_state(*id, &[JobPhase::Queued], JobState::Running, 0)?;
            }
            let lease = LeaseId { epoch: self.epoch, number: self.next_lease };
            self.next_lease += 1;
            let grant = Grant {
                lease: Lease { job: *id, tile, id: lease },
                spec: job.spec.clone(),
                packs: job.packs(tile),
                millis: job.millis_for_a_tile(able.get(&profile).copied().unwrap_or(1), now),
                profile,
            };
            if !worker.out.offer(Order::Grant(Box::new(grant))) {
                return Ok(false);
            }
            worker.wants -= 1;
            job.slots[tile.at()].lease = Some(Leased::new(lease, number, now.at));
            if let Some((from, lease)) = from
                && let Some(other) = self.workers.get(&from)
            {
                tracing::info!(
                    "tile {tile} of job {id}, queued on the busy worker {}, goes to an idle worker",
                    other.name
                );
                other.out.offer(Order::Revoke(lease));
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// Binds a job to the fastest backend that a worker has timed for it. After [`MAX_ATTEMPTS`] timings
    /// without a usable backend the job fails.
    ///
    /// # Errors
    /// The store's, when the binding or the failure could not be written.
    pub(crate) fn timed(
        &mut self,
        number: WorkerId,
        id: JobId,
        times: &[ProfileTime],
        store: &dyn Store,
        now: Moment,
    ) -> Result<(), StoreError> {
        let (Some(job), Some(worker)) = (self.jobs.get_mut(&id), self.workers.get(&number)) else {
            return Ok(());
        };
        // Only the worker that was told to time its backends counts, and only while the job is not bound.
        if job.timing.is_none_or(|(asked, _)| asked != number) || job.record.profile.is_some() {
            return Ok(());
        }
        job.timing = None;
        let offered: Vec<ProfileTime> =
            times.iter().filter(|t| worker.profiles.contains(&t.profile)).cloned().collect();
        let Some(fastest) = fastest(&offered) else {
            job.timing_faults += 1;
            if job.timing_faults < MAX_ATTEMPTS {
                return Ok(());
            }
            let reason = "no backend of the workers that timed theirs can sample this scene; see their logs"
                .to_owned();
            let failed = JobState::Failed { reason };
            store.set_job_state(id, &[JobPhase::Queued, JobPhase::Running], failed, now.unix_ms)?;
            self.jobs.remove(&id);
            return Ok(());
        };
        let each: Vec<String> = offered
            .iter()
            .map(|t| format!("{} {:.2} ms a cube", t.profile, t.seconds_per_cube * 1e3))
            .collect();
        tracing::info!(
            "job {id}: {}; chosen: {} (a gpu must be {CLEARLY} times as fast as the cpu and no \
             software rasteriser)",
            each.join(", "),
            fastest.profile
        );
        job.record.profile = Some(store.bind_profile(id, &fastest.profile)?);
        Ok(())
    }
}
