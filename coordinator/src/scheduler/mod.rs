//! Who works on what: jobs that have not ended, their tiles, workers and leases.
//!
//! All of it is in memory and can be derived again from the store and from what workers announce. It decides; the
//! store remembers.

mod binding;
mod job;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use sightline_proto::v1;
use tokio::sync::mpsc;

use self::binding::{Binding, CLEARLY, fastest, profile_for};
pub(crate) use self::job::{Job, LeaseId, Leased, Slot, cells_total};
use crate::store::{JobRecord, JobState, Store, StoreError, TileRecord, TileState};

/// How long a worker may take to time its backends before another is asked.
const TIMING_LIMIT: Duration = Duration::from_secs(300);
/// How long no leases are given out after the store could not be written.
const PAUSE: Duration = Duration::from_secs(10);
/// Failures of one tile after which it is given up, when fewer than three workers are there to try.
pub(crate) const MAX_ATTEMPTS: u32 = 5;
/// Faults of machines or networks after which a tile's failures are counted against the tile all the same.
pub(crate) const MAX_FAULTS: u32 = 12;

/// A connected worker.
pub(crate) struct Worker {
    pub(crate) name: String,
    profiles: Vec<String>,
    wants: u32,
    draining: bool,
    out: mpsc::Sender<Result<v1::CoordinatorMessage, tonic::Status>>,
}

impl Worker {
    /// Sends without waiting. A worker that does not read its stream loses it and its leases in time.
    fn send(&self, message: v1::coordinator_message::Message) -> bool {
        self.out.try_send(Ok(v1::CoordinatorMessage { message: Some(message) })).is_ok()
    }
}

/// The scheduler.
pub struct Scheduler {
    epoch: u64,
    next_lease: u64,
    next_worker: u64,
    pub(crate) jobs: BTreeMap<u64, Job>,
    pub(crate) workers: BTreeMap<u64, Worker>,
    paused_until: Option<Instant>,
    only: Option<u64>,
}

/// A tile named by a lease that is not the scheduler's any more.
pub(crate) struct Stale;

impl Scheduler {
    /// Nothing to do yet, in `epoch`.
    pub fn new(epoch: u64) -> Self {
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

    /// Gives out tiles of one job alone. A one-process bake does not go on with what another one left.
    pub fn restrict_to(&mut self, job: u64) {
        self.only = Some(job);
    }

    /// The coordinator's epoch.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Takes up a job with what is known of its tiles.
    ///
    /// # Errors
    /// Why not, when the stored specification or plan is of another version of the program.
    pub fn take_up(&mut self, record: JobRecord, tiles: Vec<TileRecord>) -> Result<(), String> {
        let job = Job::of(record, tiles)?;
        self.jobs.insert(job.record.id, job);
        Ok(())
    }

    /// A worker has come: its number, and those of the leases it names that are still its own.
    pub(crate) fn join(
        &mut self,
        hello: &v1::Hello,
        out: mpsc::Sender<Result<v1::CoordinatorMessage, tonic::Status>>,
    ) -> (u64, Vec<v1::Lease>) {
        let number = self.next_worker;
        self.next_worker += 1;
        let now = Instant::now();
        let mut kept = Vec::new();
        for lease in &hello.held {
            let Some(job) = self.jobs.get_mut(&lease.job) else { continue };
            let Some(slot) = job.slots.get_mut(lease.tile as usize) else { continue };
            let id = (lease.epoch, lease.lease);
            let free = match &slot.lease {
                None => matches!(slot.state, TileState::Open),
                // The same lease, from the worker's earlier stream.
                Some(l) => l.id == id,
            };
            if free {
                slot.lease = Some(Leased::new(id, number, now));
                kept.push(*lease);
            }
        }
        let worker = Worker {
            name: hello.name.clone(),
            profiles: hello.profiles.clone(),
            wants: 0,
            draining: false,
            out,
        };
        self.workers.insert(number, worker);
        (number, kept)
    }

    /// A worker's stream has ended. Its leases live a little longer, so that it can come back for them; a worker
    /// that said it was draining, or held none, is simply gone.
    pub(crate) fn leave(&mut self, worker: u64, now: Instant) {
        let draining = self.workers.remove(&worker).is_some_and(|w| w.draining);
        for job in self.jobs.values_mut() {
            for slot in &mut job.slots {
                // It will not come back for a tile that was granted while it said so.
                slot.lease.take_if(|l| draining && l.worker == worker);
                if let Some(l) = slot.lease.as_mut().filter(|l| l.worker == worker) {
                    l.gone = Some(now);
                }
            }
            if job.timing.is_some_and(|(w, _)| w == worker) {
                job.timing = None;
            }
        }
    }

    /// A worker wants so many more tiles.
    pub(crate) fn want(&mut self, worker: u64, tiles: u32) {
        if let Some(w) = self.workers.get_mut(&worker) {
            // Two in hand at most: more is a fault of the worker's.
            w.wants = w.wants.saturating_add(tiles).min(2);
        }
    }

    /// A worker takes no more.
    pub(crate) fn drain(&mut self, worker: u64) {
        if let Some(w) = self.workers.get_mut(&worker) {
            w.draining = true;
            w.wants = 0;
        }
    }

    /// Renews a lease. Answers whether it is still the worker's.
    pub(crate) fn renew(&mut self, progress: &v1::Progress) -> Result<(), Stale> {
        let leased = progress.lease.and_then(|l| self.leased(&l)).ok_or(Stale)?;
        let now = Instant::now();
        leased.renewed = now;
        // A tile that has not begun waits for the one before it; that is no sign of being stuck.
        let waiting = progress.cells == 0 && progress.samples == 0;
        if waiting || (leased.cells, leased.samples) != (progress.cells, progress.samples) {
            leased.moved = now;
        }
        (leased.cells, leased.samples) = (progress.cells, progress.samples);
        Ok(())
    }

    fn leased(&mut self, lease: &v1::Lease) -> Option<&mut Leased> {
        let slot = self.jobs.get_mut(&lease.job)?.slots.get_mut(lease.tile as usize)?;
        slot.lease.as_mut().filter(|l| l.id == (lease.epoch, lease.lease))
    }

    /// Gives a lease up. Answers whether it was there.
    pub(crate) fn release(&mut self, lease: &v1::Lease) -> bool {
        if self.leased(lease).is_none() {
            return false;
        }
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.slots[lease.tile as usize].lease = None;
        }
        true
    }

    /// Takes leases back whose worker has gone, that were not renewed for `ttl` or have not moved for `stuck`; answers how many.
    pub(crate) fn reap(&mut self, now: Instant, ttl: Duration, stuck: Duration) -> usize {
        let mut revoked = Vec::new();
        for (id, job) in &mut self.jobs {
            if job.timing.is_some_and(|(_, since)| now - since > TIMING_LIMIT) {
                job.timing = None;
            }
            for (tile, slot) in job.slots.iter_mut().enumerate() {
                let Some(why) = slot.lease.as_ref().and_then(|l| l.over(now, ttl, stuck)) else { continue };
                let Some(l) = slot.lease.take() else { continue };
                let from = self.workers.get(&l.worker).map(|w| format!(" from worker {}", w.name));
                tracing::warn!("tile {tile} of job {id} is taken back{}: {why}", from.unwrap_or_default());
                revoked.push((l.worker, lease_of(*id, tile, l.id)));
            }
        }
        for (worker, lease) in &revoked {
            if let Some(w) = self.workers.get(worker) {
                w.send(v1::coordinator_message::Message::Revoke(v1::Revoke { lease: Some(*lease) }));
            }
        }
        revoked.len()
    }

    /// Takes back all leases of a job.
    pub(crate) fn revoke_job(&mut self, job: u64) {
        let Some(entry) = self.jobs.get_mut(&job) else { return };
        for (tile, slot) in entry.slots.iter_mut().enumerate() {
            if let Some(l) = slot.lease.take()
                && let Some(w) = self.workers.get(&l.worker)
            {
                let lease = Some(lease_of(job, tile, l.id));
                w.send(v1::coordinator_message::Message::Revoke(v1::Revoke { lease }));
            }
        }
    }

    /// Gives out no leases for a while.
    pub(crate) fn pause_leasing(&mut self, now: Instant) {
        self.paused_until = Some(now + PAUSE);
    }

    /// Gives tiles to the workers that want some: the oldest job first, its tiles in the plan's order.
    ///
    /// # Errors
    /// The store's, when a job's state could not be written.
    pub(crate) fn pump(&mut self, store: &dyn Store, now: Instant) -> Result<(), StoreError> {
        if self.paused_until.is_some_and(|until| now < until) {
            return Ok(());
        }
        self.paused_until = None;
        let numbers: Vec<u64> = self.workers.keys().copied().collect();
        // One tile each in turn, so that the first worker does not take two while another has none.
        loop {
            let mut given = false;
            for number in &numbers {
                given |= self.give(*number, store, now)?;
            }
            if !given {
                return Ok(());
            }
        }
    }

    /// Gives one tile to a worker, or asks it to time its backends. Answers whether it got a tile.
    fn give(&mut self, number: u64, store: &dyn Store, now: Instant) -> Result<bool, StoreError> {
        use v1::coordinator_message::Message;
        if self.workers.get(&number).is_none_or(|w| w.wants == 0 || w.draining) {
            return Ok(false);
        }
        // Workers that can run each profile.
        let mut able: BTreeMap<String, u64> = BTreeMap::new();
        for profile in self.workers.values().flat_map(|w| &w.profiles) {
            *able.entry(profile.clone()).or_default() += 1;
        }
        let leased = self.jobs.values().flat_map(|j| &j.slots).filter_map(|s| s.lease.as_ref());
        let busy: BTreeSet<u64> = leased.map(|l| l.worker).collect();
        // What others without a tile can run: tiles that are left go to them, before anybody has a second one in hand.
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
                        let spec = Some(job.spec.to_proto());
                        if worker.send(Message::Time(v1::Time { job: *id, spec })) {
                            job.timing = Some((number, now));
                        }
                        continue;
                    }
                    Binding::Time | Binding::Cannot => continue,
                }
                // Bound now, perhaps to another profile than this worker's: look again.
                return self.give(number, store, now);
            };
            if !worker.profiles.contains(&profile) {
                continue;
            }
            let idle = idle.iter().filter(|profiles| profiles.contains(&profile)).count();
            let mut ready = (0..job.slots.len()).filter(|t| job.ready(*t, now));
            let (first, more) = (ready.next(), ready.take(idle).count());
            let (tile, from) = match (first, busy.contains(&number)) {
                (Some(_), true) if more < idle => continue,
                (Some(tile), _) => (tile, None),
                // Nothing is left but what others have not begun with.
                (None, false) => match job.waiting() {
                    Some((tile, lease)) => (tile, Some((lease.worker, lease_of(*id, tile, lease.id)))),
                    None => continue,
                },
                (None, true) => continue,
            };
            if job.record.state == JobState::Queued {
                use crate::store::JobPhase::Queued;
                job.record = store.set_job_state(*id, &[Queued], JobState::Running, 0)?;
            }
            let lease = (self.epoch, self.next_lease);
            self.next_lease += 1;
            let grant = v1::Grant {
                lease: Some(lease_of(*id, tile, lease)),
                spec: Some(job.spec.to_proto()),
                packs: job.packs(tile),
                millis: job.millis_for_a_tile(able.get(&profile).copied().unwrap_or(1)),
                profile,
            };
            if !worker.send(Message::Grant(grant)) {
                return Ok(false);
            }
            worker.wants -= 1;
            job.slots[tile].lease = Some(Leased::new(lease, number, now));
            if let Some((from, lease)) = from
                && let Some(other) = self.workers.get(&from)
            {
                tracing::info!(
                    "tile {tile} of job {id} goes from worker {}, which has another, to an idle one",
                    other.name
                );
                other.send(Message::Revoke(v1::Revoke { lease: Some(lease) }));
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// A worker has timed its backends for a job: the fastest is bound.
    pub(crate) fn timed(
        &mut self,
        number: u64,
        timed: &v1::Timed,
        store: &dyn Store,
    ) -> Result<(), StoreError> {
        let (Some(job), Some(worker)) = (self.jobs.get_mut(&timed.job), self.workers.get(&number)) else {
            return Ok(());
        };
        // Only the worker that was asked, and only while nothing is bound.
        if job.timing.is_none_or(|(asked, _)| asked != number) || job.record.profile.is_some() {
            return Ok(());
        }
        job.timing = None;
        let offered: Vec<v1::ProfileTime> =
            timed.times.iter().filter(|t| worker.profiles.contains(&t.profile)).cloned().collect();
        let fastest = fastest(&offered);
        let Some(fastest) = fastest else {
            job.timing_faults += 1;
            if job.timing_faults < MAX_ATTEMPTS {
                return Ok(());
            }
            let reason =
                "no backend of the workers that were asked can sample this scene; see their logs".to_owned();
            use crate::store::JobPhase::{Queued, Running};
            let failed = JobState::Failed { reason };
            store.set_job_state(timed.job, &[Queued, Running], failed, crate::core::now_ms())?;
            self.jobs.remove(&timed.job);
            return Ok(());
        };
        let each: Vec<String> = offered
            .iter()
            .map(|t| format!("{} {:.2} ms a cube", t.profile, t.seconds_per_cube * 1e3))
            .collect();
        tracing::info!(
            "job {}: {}; chosen: {} (a gpu must be {CLEARLY} times as fast as the cpu, and no software)",
            timed.job,
            each.join(", "),
            fastest.profile
        );
        job.record.profile = Some(store.bind_profile(timed.job, &fastest.profile)?);
        Ok(())
    }
}

fn lease_of(job: u64, tile: usize, id: LeaseId) -> v1::Lease {
    v1::Lease { job, tile: tile as u32, epoch: id.0, lease: id.1 }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;
    use sightline_model::{BackendChoice, SamplingParams};
    use sightline_model::{JobSpec, Method};
    use sightline_proto::v1::coordinator_message::Message;
    use sightline_proto::v1::jobs_server::Jobs as _;
    use sightline_scene::{Object, Scene, Triangle};
    use sightline_viewcells::Division;

    use super::*;
    use crate::core::{Config, Coordinator};
    use crate::jobs_service::JobsService;

    /// A coordinator with a job of two tiles.
    async fn two_tiles(directory: &std::path::Path) -> Arc<Coordinator> {
        let coordinator = Coordinator::open(Config::new(directory.to_owned())).unwrap();
        let triangle = Triangle { v: [Vec3::ZERO, Vec3::X, Vec3::Y] };
        let objects = vec![Object { name: "all".to_owned(), first: 0, count: 1 }];
        let scene = coordinator.take_scene(&Scene::new("test", vec![triangle], objects).unwrap()).unwrap();
        let spec = JobSpec {
            scene,
            division: Division::Grid([2, 1, 1]),
            view_box: [Vec3::ZERO, Vec3::ONE],
            sampling: SamplingParams::default(),
            backend: BackendChoice::Cpu,
            seed: 1,
            time_budget_ms: 0,
            block_cells: 1,
            method: Method::Aggressive,
            certificates: false,
        };
        let request = v1::SubmitRequest {
            request_id: "one".to_owned(),
            name: "two tiles".to_owned(),
            spec: Some(spec.to_proto()),
        };
        JobsService(Arc::clone(&coordinator)).submit(tonic::Request::new(request)).await.unwrap();
        coordinator
    }

    type Told = mpsc::Receiver<Result<v1::CoordinatorMessage, tonic::Status>>;

    /// A worker that has come: its number, and what it is told.
    fn come(scheduler: &mut Scheduler, name: &str) -> (u64, Told) {
        let hello =
            v1::Hello { name: name.to_owned(), profiles: vec!["cpu/test".to_owned()], ..Default::default() };
        let (out, told) = mpsc::channel(8);
        (scheduler.join(&hello, out).0, told)
    }

    /// Who has each tile.
    fn hands(scheduler: &Scheduler) -> Vec<Option<u64>> {
        let slots = scheduler.jobs.values().flat_map(|j| &j.slots);
        slots.map(|s| s.lease.as_ref().map(|l| l.worker)).collect()
    }

    #[tokio::test]
    async fn nobody_gets_a_second_tile_while_another_worker_has_none() {
        let directory = tempfile::tempdir().unwrap();
        let coordinator = two_tiles(directory.path()).await;
        let mut scheduler = coordinator.lock();
        let ((a, _told_a), (b, _told_b)) = (come(&mut scheduler, "a"), come(&mut scheduler, "b"));
        scheduler.want(a, 2);
        scheduler.pump(&*coordinator.store, Instant::now()).unwrap();
        assert_eq!(hands(&scheduler), [Some(a), None]);
        scheduler.want(b, 2);
        scheduler.pump(&*coordinator.store, Instant::now()).unwrap();
        assert_eq!(hands(&scheduler), [Some(a), Some(b)]);
    }

    #[tokio::test]
    async fn a_tile_that_waits_goes_to_a_worker_that_comes_late() {
        let directory = tempfile::tempdir().unwrap();
        let coordinator = two_tiles(directory.path()).await;
        let mut scheduler = coordinator.lock();
        let (a, mut told_a) = come(&mut scheduler, "a");
        scheduler.want(a, 2);
        scheduler.pump(&*coordinator.store, Instant::now()).unwrap();
        assert_eq!(hands(&scheduler), [Some(a), Some(a)]);
        let (b, mut told_b) = come(&mut scheduler, "b");
        scheduler.want(b, 2);
        scheduler.pump(&*coordinator.store, Instant::now()).unwrap();
        assert_eq!(hands(&scheduler), [Some(a), Some(b)]);
        let next = |told: &mut Told| told.try_recv().ok().and_then(|m| m.unwrap().message);
        let mut leases = Vec::new();
        for _ in 0..2 {
            let Some(Message::Grant(grant)) = next(&mut told_a) else { panic!("no grant") };
            leases.push(grant.lease);
        }
        assert_eq!(next(&mut told_a), Some(Message::Revoke(v1::Revoke { lease: leases[1] })));
        let Some(Message::Grant(grant)) = next(&mut told_b) else { panic!("no grant") };
        assert_eq!(grant.lease.unwrap().tile, leases[1].unwrap().tile);
        // What has begun is nobody else's, and neither is a worker's only tile.
        let (c, _told_c) = come(&mut scheduler, "c");
        scheduler.want(c, 2);
        scheduler.pump(&*coordinator.store, Instant::now()).unwrap();
        assert_eq!(hands(&scheduler), [Some(a), Some(b)]);
    }
}
