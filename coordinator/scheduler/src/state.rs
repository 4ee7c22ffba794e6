//! The scheduler as a state machine: an event and the time in, effects out.
//!
//! It reads no clock, takes no lock, and knows no thread, file, channel or store. The only randomness is a
//! generator seeded at construction. So a run is a function of its events, and the simulator drives the same
//! code as the coordinator. Every event costs the logarithm of what there is, except for a job that is taken
//! up or ends, and a tile that is set aside, which look at all tiles of one job.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_numbers::random::SplitMix64;
use sightline_records::JobPhase;
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex, WorkerId};

use super::crew::Crew;
use super::death::{Death, DeathOf, Missing};
use super::event::{Effect, Event, Note, StoreCommand};
use super::job::{Job, Output};
use super::messages::Now;
use super::pools::{CHOICES, Pools, Profile};
use super::queue::{Account, User};
use super::spot_check::Name;
use super::worker_totals::WorkerTotals;

/// How long no tiles are granted after the store could not be written.
pub(super) const PAUSE: u64 = 10_000;
/// Time between two attempts to write a result that the disk has no space for.
pub(super) const SPACE_EVERY: u64 = 10_000;
/// A tick that comes this much later than the one before says that the coordinator itself stood still.
const STALLED: u64 = 3000;
/// After a standstill leases end at the earliest after this time, so that reports that wait are read first.
const AFTER_STALL: u64 = 3000;

/// The settings of the scheduler.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// This start of the coordinator.
    pub epoch: Epoch,
    /// How long a lease lives without being renewed, in milliseconds.
    pub ttl: u64,
    /// How long a tile may make no progress, in milliseconds.
    pub stuck: u64,
    /// Seeds the jitter of back-offs.
    pub seed: u64,
    /// The share of tiles that are computed again.
    pub spot_check: f64,
    /// The secret seed with which these tiles are drawn.
    pub spot_seed: u64,
}

/// A connected worker.
#[derive(Debug)]
pub(super) struct Worker {
    pub(super) name: String,
    /// The name with the worker's identity.
    pub(super) signature: Name,
    /// Version of its program.
    pub(super) version: String,
    /// When it connected and when its last message came, in milliseconds since 1970.
    pub(super) joined: u64,
    pub(super) heard: u64,
    pub(super) done: WorkerTotals,
    pub(super) instance: u64,
    pub(super) profiles: BTreeSet<Profile>,
    /// For each choice whether it can serve it.
    pub(super) serves: [bool; CHOICES],
    pub(super) wants: u32,
    pub(super) draining: bool,
    /// It did not take an order; it gets none until then.
    pub(super) backpressured_until: Option<u64>,
    /// A lease of it ran out although its stream is there: it gets nothing until it asks again.
    pub(super) silent: bool,
    /// The first lease that ran out since it has said anything.
    pub(super) unheard: Option<Lease>,
    pub(super) leases: BTreeSet<LeaseId>,
    /// Whether it can help leaders, and the one whom it helps.
    pub(super) can_help: bool,
    pub(super) helps: Option<Lease>,
    /// Jobs for which it times its backends.
    pub(super) timing: BTreeSet<JobId>,
}

/// A tile leased to a worker.
#[derive(Debug)]
pub(super) struct Leased {
    pub(super) job: JobId,
    pub(super) tile: TileIndex,
    /// The connection that holds it, also after the connection's end.
    pub(super) worker: WorkerId,
    pub(super) profile: Profile,
    /// When it was given.
    pub(super) given: u64,
    pub(super) renewed: u64,
    pub(super) moved: u64,
    /// When the worker's stream ended.
    pub(super) gone: Option<u64>,
    pub(super) cells: u64,
    pub(super) samples: u64,
    /// When it was first seen to make progress.
    pub(super) begun: Option<u64>,
    /// Whether it is in its pool's list of waiting tiles.
    pub(super) waits: bool,
    /// When its timer fires.
    pub(super) timer: u64,
    /// Whether it is the check of a done tile.
    pub(super) checks: bool,
}

/// What a timer is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Timer {
    /// A lease may have ended.
    Lease(LeaseId),
    /// A tile has waited after a fault.
    Tile(JobId, TileIndex),
    /// A job has waited for the timing of backends, or for more workers.
    Parked(JobId),
    /// A job has waited for leases of an earlier epoch.
    Grace(JobId),
    /// A result has waited for space.
    Space(JobId),
    /// A worker may take orders again.
    Deaf(WorkerId),
    /// Leasing goes on.
    Leasing,
}

/// The scheduler.
#[derive(Debug)]
pub struct Scheduler {
    pub(super) settings: Settings,
    pub(super) random: SplitMix64,
    pub(super) next_lease: u64,
    pub(super) next_worker: u64,
    pub(super) jobs: BTreeMap<JobId, Job>,
    pub(super) workers: BTreeMap<WorkerId, Worker>,
    pub(super) leases: BTreeMap<LeaseId, Leased>,
    /// Connected workers that sent an instance: by name, and by instance.
    pub(super) names: BTreeMap<String, WorkerId>,
    pub(super) instances: BTreeMap<u64, WorkerId>,
    /// Workers whose streams have ended and that may return.
    pub(super) missing: BTreeMap<WorkerId, Missing>,
    /// Deaths that are cancelled if the worker returns, from the oldest.
    pub(super) deaths: VecDeque<Death>,
    /// Deaths that the store has not recorded yet, and whether they were cancelled in the meantime.
    pub(super) recording: BTreeMap<DeathOf, bool>,
    /// Leased tiles whose leaders can use helpers.
    pub(super) crews: BTreeMap<LeaseId, Crew>,
    /// Users with open jobs.
    pub(super) accounts: BTreeMap<User, Account>,
    pub(super) pools: Pools,
    pub(super) timers: BTreeSet<(u64, Timer)>,
    /// Jobs whose tiles an earlier epoch may have leased, and until when nobody else gets them.
    pub(super) graces: BTreeMap<JobId, u64>,
    pub(super) only: Option<JobId>,
    pub(super) paused_until: Option<u64>,
    /// Done tiles that are to be checked.
    pub(super) spotted: BTreeSet<(JobId, TileIndex)>,
    /// Workers that get no tiles because others have computed other bytes, by signature, and for which tiles.
    pub(super) suspects: BTreeMap<Name, BTreeSet<(JobId, TileIndex)>>,
    /// The signatures of workers that get no tiles because their bytes were wrong.
    pub(super) quarantined: BTreeSet<Name>,
    /// What the store has refused to note about wrong workers.
    pub(super) unsaid: Vec<StoreCommand>,
    /// The last tick, and until when leases do not end because the coordinator stood still.
    last_tick: Option<u64>,
    pub(super) patient_until: u64,
    /// No time of an event is earlier.
    pub(super) clock: u64,
    pub(super) effects: Vec<Effect>,
}

impl Scheduler {
    /// A scheduler without jobs and workers.
    pub fn new(settings: Settings) -> Self {
        Self {
            random: SplitMix64::named(&[settings.seed, settings.epoch.0]),
            settings,
            next_lease: 1,
            next_worker: 1,
            jobs: BTreeMap::new(),
            workers: BTreeMap::new(),
            leases: BTreeMap::new(),
            names: BTreeMap::new(),
            instances: BTreeMap::new(),
            missing: BTreeMap::new(),
            deaths: VecDeque::new(),
            recording: BTreeMap::new(),
            crews: BTreeMap::new(),
            accounts: BTreeMap::new(),
            pools: Pools::default(),
            timers: BTreeSet::new(),
            graces: BTreeMap::new(),
            only: None,
            paused_until: None,
            spotted: BTreeSet::new(),
            suspects: BTreeMap::new(),
            quarantined: BTreeSet::new(),
            unsaid: Vec::new(),
            last_tick: None,
            patient_until: 0,
            clock: 0,
            effects: Vec::new(),
        }
    }

    /// Takes an event in, and gives what is to be done.
    pub fn step(&mut self, event: Event, now: Now) -> Vec<Effect> {
        self.clock = self.clock.max(now.ms);
        let now = Now {
            ms: self.clock,
            ..now
        };
        if let Some(worker) = self.speaker(&event) {
            self.hear(worker, now);
        }
        match event {
            Event::TakenUp(job) => self.take_up(*job, now),
            Event::Restricted(job) => self.restrict(job),
            Event::JobChanged(record) => self.job_changed(*record),
            Event::Stopped(job) => self.stop_now(job),
            Event::Joined(intro) => self.join(intro, now),
            Event::Left(worker) => self.leave(worker, now),
            Event::Wanted(worker, tiles) => self.want(worker, tiles),
            Event::Drains(worker) => self.drain(worker),
            Event::Progressed(progress) => self.progress(&progress, now),
            Event::Failed(worker, failure) => self.failed(worker, failure, now),
            Event::Timed(worker, job, times) => self.timed(worker, job, &times),
            Event::Committed {
                lease,
                digest,
                stats,
            } => self.committed(&lease, digest, &stats, now),
            Event::Checked { lease, digest } => self.checked(&lease, digest),
            Event::Differed { lease, digest } => self.differed(&lease, digest),
            Event::Quarantined(name) => self.quarantine(&name),
            Event::Released(name) => self.release(&name),
            Event::Swept => self.swept(),
            Event::DiskFull(lease) => self.disk_full(&lease, now),
            Event::Undelivered(worker, lease) => self.undelivered(worker, &lease, now),
            Event::FailureRecorded {
                job,
                tile,
                on,
                reason,
                dead: None,
            } => {
                self.judge(job, tile, (on, false), &reason);
            }
            Event::FailureRecorded {
                job,
                tile,
                on,
                reason,
                dead: Some(name),
            } => {
                self.death_recorded((job, tile, name), on, &reason);
            }
            Event::SetAside { job, tile, digest } => self.tile_set_aside(job, tile, digest),
            Event::Bound(job, profile) => self.bound(job, profile),
            Event::Refused(command) => self.refused(command, now),
            Event::AssemblyWaits(job) => self.assembly_waits(job, now),
            Event::AssemblyDropped(job) => {
                if let Some(entry) = self.jobs.get_mut(&job) {
                    entry.assembling = false;
                }
                self.assemble_if_complete(job);
            }
            Event::CrewOpened(lease) => self.crew_opened(lease),
            Event::CrewClosed(lease) => self.crew_closed(lease.id),
            Event::Helped(worker, lease) => self.helped(worker, &lease),
            Event::HelpUndelivered(worker, lease) => self.help_undelivered(worker, &lease, now),
            Event::Tick => self.tick(now),
        }
        self.settle(now);
        std::mem::take(&mut self.effects)
    }

    /// The worker whose message an event is.
    fn speaker(&self, event: &Event) -> Option<WorkerId> {
        match event {
            Event::Wanted(worker, _)
            | Event::Drains(worker)
            | Event::Failed(worker, _)
            | Event::Timed(worker, ..)
            | Event::Helped(worker, _) => Some(*worker),
            Event::Progressed(progress) => self.leases.get(&progress.lease.id).map(|l| l.worker),
            Event::Committed { lease, .. } | Event::Checked { lease, .. } => {
                self.leases.get(&lease.id).map(|l| l.worker)
            }
            _ => None,
        }
    }

    pub(super) fn tell_watchers(&mut self, job: JobId) {
        self.effects.push(Effect::Changed(job));
    }

    pub(super) fn note(&mut self, note: Note) {
        self.effects.push(Effect::Note(note));
    }

    pub(super) fn set_timer(&mut self, at: u64, timer: Timer) {
        self.timers.insert((at, timer));
    }

    /// Grants no tiles for a while.
    pub(super) fn pause_leasing(&mut self, now: Now) {
        let until = now.ms + PAUSE;
        self.paused_until = Some(until);
        self.set_timer(until, Timer::Leasing);
    }

    /// Fires the timers whose time has come.
    fn tick(&mut self, now: Now) {
        if self.last_tick.is_some_and(|last| now.ms - last > STALLED) {
            self.patient_until = now.ms + AFTER_STALL;
        }
        self.last_tick = Some(now.ms);
        while let Some((at, timer)) = self.timers.first().copied().filter(|(at, _)| *at <= now.ms) {
            self.timers.remove(&(at, timer));
            self.fire(timer, now);
        }
        self.find_stragglers(now);
        self.grant_checks(now);
        self.ask_again();
    }

    fn fire(&mut self, timer: Timer, now: Now) {
        match timer {
            Timer::Lease(id) => self.lease_timer(id, now),
            Timer::Tile(job, tile) => self.tile_timer(job, tile, now),
            Timer::Parked(job) => self.parked_timer(job, now),
            Timer::Grace(job) => self.end_grace(job),
            Timer::Space(id) => {
                if let Some(job) = self.jobs.get_mut(&id)
                    && job.no_space_until.is_some_and(|until| until <= now.ms)
                {
                    job.no_space_until = None;
                    self.assemble_if_complete(id);
                }
            }
            Timer::Deaf(id) => {
                if let Some(w) = self.workers.get_mut(&id)
                    && w.backpressured_until.is_some_and(|until| until <= now.ms)
                {
                    w.backpressured_until = None;
                    self.list_worker(id);
                }
            }
            Timer::Leasing => {
                if self.paused_until.is_some_and(|until| until <= now.ms) {
                    self.paused_until = None;
                }
            }
        }
    }

    /// Returns the facts for checking an output that arrives under a lease, and whether the output counts.
    ///
    /// An output counts if the lease was given, however long ago, to a worker that is not quarantined. The
    /// scheduler knows the holder of a lease of this epoch. A lease of an earlier epoch is accepted: its tag,
    /// which the caller has checked, proves that it was given. Its output is the first of the tile, or the
    /// same, or rejected. An output of a done tile can only be compared with the one that stays. None counts
    /// that was leased before tiles of the job were opened again: it may be computed from them.
    ///
    /// # Errors
    /// The reason, when there is no such tile.
    pub fn admit(&self, lease: &Lease) -> Result<Admitted, NoTile> {
        let job = self.jobs.get(&lease.job).ok_or(NoTile::NoJob(lease.job))?;
        let tile = job.tiles.get(lease.tile.at()).ok_or(NoTile::NoTile)?;
        let given = Some(lease.id.number).filter(|_| lease.id.epoch == self.settings.epoch);
        let given = given.and_then(|number| job.given_to(number, lease.tile));
        // Who had a lease of an earlier epoch is known if it was claimed. Where results are checked, others
        // do not count: nobody could be asked for them.
        let holder = self
            .leases
            .get(&lease.id)
            .filter(|l| (l.job, l.tile) == (lease.job, lease.tile));
        let holder = holder
            .and_then(|l| self.workers.get(&l.worker))
            .map(|w| Name::clone(&w.signature));
        let trusting = self.settings.spot_check <= 0.0 && self.quarantined.is_empty();
        let earlier = lease.id.epoch < self.settings.epoch && (trusting || holder.is_some());
        let given = given.or(holder);
        let is_good = |name: &Name| !self.quarantined.contains(name);
        let is_clean = given.as_ref().is_none_or(is_good) && tile.contributors.iter().all(is_good);
        let is_kept = (earlier || given.is_some()) && is_clean;
        let counts =
            lease.id >= job.counts_from && (is_kept || matches!(tile.output, Output::Done(_)));
        let worker = given.map(|name| name.to_string()).unwrap_or_default();
        let helpers = tile
            .contributors
            .iter()
            .filter(|name| ***name != *worker)
            .map(|name| name.to_string())
            .collect();
        let checks = self.leases.get(&lease.id).is_some_and(|l| l.checks);
        let profile = job.record.profile.clone().unwrap_or_default();
        Ok(Admitted {
            work: Arc::clone(&job.work),
            worker,
            helpers,
            profile,
            checks,
            counts,
        })
    }

    /// A job that has not ended.
    pub fn job(&self, id: JobId) -> Option<&Job> {
        self.jobs.get(&id)
    }

    /// The jobs that have not ended.
    pub fn job_ids(&self) -> Vec<JobId> {
        self.jobs.keys().copied().collect()
    }

    /// The number of connected workers.
    pub fn workers(&self) -> u32 {
        self.workers.len() as u32
    }

    /// Ends a job here, with its leases.
    pub(super) fn drop_job(&mut self, id: JobId) {
        self.revoke_job(id);
        self.unlist_job(id);
        self.spotted.retain(|(job, _)| *job != id);
        self.clear_suspects(id, None);
        if let Some(job) = self.jobs.remove(&id) {
            self.close_account(&job.whom.user);
        }
        self.tell_watchers(id);
    }

    /// Starts assembling a job whose tiles are complete.
    pub(super) fn assemble_if_complete(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let complete = job.open() == 0 && job.spots.is_empty();
        if job.runs() && !job.assembling && job.no_space_until.is_none() && complete {
            job.assembling = true;
            self.effects.push(Effect::Assemble(id));
        }
    }

    /// Whether the job may be worked on.
    pub(super) fn allowed(&self, job: &Job) -> bool {
        matches!(
            job.record.state.phase(),
            JobPhase::Queued | JobPhase::Running
        ) && self.only.is_none_or(|only| only == job.record.id)
    }
}

/// See [`Scheduler::admit`].
#[derive(Debug)]
pub struct Admitted {
    /// What the job computes.
    pub work: Arc<PlannedJob>,
    /// The signature of the worker that got the lease; empty when that is not known.
    pub worker: String,
    /// Others who had a hand in the tile.
    pub helpers: Vec<String>,
    /// The numerics profile of the job.
    pub profile: String,
    /// Whether the lease is the check of a done tile, so that the output is compared and not kept.
    pub checks: bool,
    /// Whether the output counts.
    pub counts: bool,
}

/// A lease on something that does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoTile {
    /// The job has ended or does not exist.
    NoJob(JobId),
    /// The job has fewer tiles.
    NoTile,
}
