//! The scheduler as a state machine: it receives an event and the time, and returns effects.
//!
//! The scheduler does not read a clock or lock a mutex, and does not depend on threads, files, channels or a
//! store. The only randomness is a generator seeded at construction. So a run is a function of its events,
//! and the simulator runs the same code as the coordinator. The cost of an event is logarithmic in the size
//! of the state. Exceptions are a job that is added or ends, and a tile that is set aside: they inspect all
//! tiles of one job.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_numbers::random::SplitMix64;
use sightline_records::JobPhase;
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex, WorkerId};

use super::crew::Crew;
use super::death::{Death, DeathOf, Missing};
use super::event::{Effect, Event, Note, StoreCommand};
use super::job::{OpenJob, Output};
use super::messages::Now;
use super::pools::{CHOICES, Pools, Profile};
use super::queue::{Account, User};
use super::spot_check::Name;
use super::worker_totals::WorkerTotals;

/// The time without grants after the store could not be written, in milliseconds.
pub(super) const PAUSE: u64 = 10_000;
/// The time between two attempts to write a result that the disk has no space for, in milliseconds.
pub(super) const SPACE_EVERY: u64 = 10_000;
/// The delay between two ticks, in milliseconds, above which the coordinator itself stood still.
const STALLED: u64 = 3000;
/// The minimum time after a standstill before leases end, in milliseconds, so that the scheduler first
/// receives the reports that workers sent during the standstill.
const AFTER_STALL: u64 = 3000;

/// The settings of the scheduler.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// The epoch of this start of the coordinator.
    pub epoch: Epoch,
    /// The time after which a lease ends unless it is renewed, in milliseconds.
    pub ttl: u64,
    /// The time without progress after which a tile is revoked, in milliseconds.
    pub stuck: u64,
    /// The seed for the jitter of back-offs.
    pub seed: u64,
    /// The fraction of done tiles that spot checks compute again, from 0 to 1.
    pub spot_check: f64,
    /// The secret seed that determines the tiles for spot checks.
    pub spot_seed: u64,
}

/// A connected worker.
#[derive(Debug)]
pub(super) struct Worker {
    pub(super) name: String,
    /// The signature: the name with the worker's identity.
    pub(super) signature: Name,
    /// The version of the worker's program.
    pub(super) version: String,
    /// The time of the connection, in milliseconds since 1970.
    pub(super) joined: u64,
    /// The time of the last message, in milliseconds since 1970.
    pub(super) heard: u64,
    pub(super) done: WorkerTotals,
    pub(super) instance: u64,
    pub(super) profiles: BTreeSet<Profile>,
    /// True for each tracer choice that the worker can serve.
    pub(super) serves: [bool; CHOICES],
    pub(super) wants: u32,
    pub(super) draining: bool,
    /// The time until which the worker gets no commands, because an earlier command could not be sent.
    pub(super) backpressured_until: Option<u64>,
    /// True after a lease ran out although the stream exists. The worker gets no tiles until it requests
    /// tiles again.
    pub(super) unresponsive: bool,
    /// The first lease that ran out since the worker's last message.
    pub(super) unheard: Option<Lease>,
    pub(super) leases: BTreeSet<LeaseId>,
    /// True if the worker can help leaders.
    pub(super) can_help: bool,
    pub(super) helps: Option<Lease>,
    /// The jobs for which the worker times its backends.
    pub(super) timing: BTreeSet<JobId>,
}

/// A tile leased to a worker.
#[derive(Debug)]
pub(super) struct Leased {
    pub(super) job: JobId,
    pub(super) tile: TileIndex,
    /// The connection that holds the lease, also after the connection has ended.
    pub(super) worker: WorkerId,
    pub(super) profile: Profile,
    /// The time of the grant.
    pub(super) given: u64,
    pub(super) renewed: u64,
    pub(super) moved: u64,
    /// The time at which the worker's stream ended.
    pub(super) gone: Option<u64>,
    pub(super) cells: u64,
    pub(super) samples: u64,
    /// The time of the first reported progress.
    pub(super) begun: Option<u64>,
    /// True if the lease is in its pool's list of waiting tiles.
    pub(super) waits: bool,
    /// The time at which the lease's timer fires.
    pub(super) timer: u64,
    /// True if the lease is the check of a done tile.
    pub(super) checks: bool,
}

/// The purpose of a timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Timer {
    /// Checks whether a lease has ended.
    Lease(LeaseId),
    /// Ends the delay of a tile after a fault.
    Tile(JobId, TileIndex),
    /// Ends a job's wait for the timing of backends, or for more workers.
    Parked(JobId),
    /// Ends a job's wait for leases of an earlier epoch.
    Grace(JobId),
    /// Ends the wait for disk space of a job's result.
    Space(JobId),
    /// Ends the time in which a worker gets no commands.
    Backpressure(WorkerId),
    /// Resumes leasing.
    Leasing,
}

/// The connected workers.
#[derive(Debug, Default)]
pub(super) struct Roster {
    /// The number of connections so far.
    pub(super) count: u64,
    pub(super) workers: BTreeMap<WorkerId, Worker>,
    /// Connected workers that sent an instance, by name.
    pub(super) names: BTreeMap<String, WorkerId>,
    /// Connected workers that sent an instance, by instance.
    pub(super) instances: BTreeMap<u64, WorkerId>,
}

/// The workers whose streams have ended, and their deaths.
#[derive(Debug, Default)]
pub(super) struct Deaths {
    /// The workers whose streams have ended and that may return.
    pub(super) missing: BTreeMap<WorkerId, Missing>,
    /// The deaths that are cancelled if the worker returns, from the oldest.
    pub(super) recent: VecDeque<Death>,
    /// The deaths that the store has not recorded yet. True if the death was cancelled in the meantime.
    pub(super) recording: BTreeMap<DeathOf, bool>,
}

/// The leases of this epoch, and the waits for the leases of earlier epochs.
#[derive(Debug, Default)]
pub(super) struct Leases {
    /// The number of leases granted so far.
    pub(super) count: u64,
    pub(super) table: BTreeMap<LeaseId, Leased>,
    /// The jobs whose tiles an earlier epoch may have leased, with the end of their grace.
    pub(super) graces: BTreeMap<JobId, u64>,
}

/// The queues of tiles and of helpers.
#[derive(Debug, Default)]
pub(super) struct Queues {
    /// The ready jobs and idle workers by profile.
    pub(super) pools: Pools,
    /// The users with open jobs.
    pub(super) accounts: BTreeMap<User, Account>,
    /// The leased tiles whose leaders can use helpers.
    pub(super) crews: BTreeMap<LeaseId, Crew>,
}

/// The checks of outputs, and the workers that they concern.
#[derive(Debug, Default)]
pub(super) struct Trust {
    /// The done tiles that must be checked.
    pub(super) spotted: BTreeSet<(JobId, TileIndex)>,
    /// The workers that get no tiles because other workers computed other bytes, by signature, with the
    /// tiles.
    pub(super) suspects: BTreeMap<Name, BTreeSet<(JobId, TileIndex)>>,
    /// The signatures of the quarantined workers, which get no tiles because their bytes were wrong.
    pub(super) quarantined: BTreeSet<Name>,
    /// The quarantine commands that the store has rejected.
    pub(super) refused: Vec<StoreCommand>,
}

/// The time and the timers.
#[derive(Debug, Default)]
pub(super) struct Time {
    /// The latest time of an event. Times never decrease.
    pub(super) clock: u64,
    pub(super) timers: BTreeSet<(u64, Timer)>,
    pub(super) last_tick: Option<u64>,
    /// The end of the time in which leases do not end because the coordinator stood still.
    pub(super) patient_until: u64,
    /// The end of the time in which no tiles are granted.
    pub(super) paused_until: Option<u64>,
}

/// The scheduler: assigns the tiles of all open jobs to the connected workers.
#[derive(Debug)]
pub struct Scheduler {
    pub(super) settings: Settings,
    pub(super) random: SplitMix64,
    pub(super) jobs: BTreeMap<JobId, OpenJob>,
    /// The only job whose tiles are leased; `None` for all jobs.
    pub(super) only: Option<JobId>,
    pub(super) roster: Roster,
    pub(super) deaths: Deaths,
    pub(super) leases: Leases,
    pub(super) queues: Queues,
    pub(super) trust: Trust,
    pub(super) time: Time,
    /// The effects of the current event.
    pub(super) effects: Vec<Effect>,
}

impl Scheduler {
    /// Creates a scheduler without jobs and workers.
    pub fn new(settings: Settings) -> Self {
        Self {
            random: SplitMix64::named(&[settings.seed, settings.epoch.0]),
            settings,
            jobs: BTreeMap::new(),
            only: None,
            roster: Roster::default(),
            deaths: Deaths::default(),
            leases: Leases::default(),
            queues: Queues::default(),
            trust: Trust::default(),
            time: Time::default(),
            effects: Vec::new(),
        }
    }

    /// Handles an event and returns the effects that the caller must execute.
    pub fn step(&mut self, event: Event, now: Now) -> Vec<Effect> {
        self.time.clock = self.time.clock.max(now.ms);
        let now = Now {
            ms: self.time.clock,
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
                self.judge(job, tile, on, false, &reason);
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

    /// Returns the worker whose message an event is.
    fn speaker(&self, event: &Event) -> Option<WorkerId> {
        match event {
            Event::Wanted(worker, _)
            | Event::Drains(worker)
            | Event::Failed(worker, _)
            | Event::Timed(worker, ..)
            | Event::Helped(worker, _) => Some(*worker),
            Event::Progressed(progress) => {
                self.leases.table.get(&progress.lease.id).map(|l| l.worker)
            }
            Event::Committed { lease, .. } | Event::Checked { lease, .. } => {
                self.leases.table.get(&lease.id).map(|l| l.worker)
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
        self.time.timers.insert((at, timer));
    }

    /// Pauses the granting of tiles.
    pub(super) fn pause_leasing(&mut self, now: Now) {
        let until = now.ms + PAUSE;
        self.time.paused_until = Some(until);
        self.set_timer(until, Timer::Leasing);
    }

    /// Fires the timers whose time has come.
    fn tick(&mut self, now: Now) {
        if self
            .time
            .last_tick
            .is_some_and(|last| now.ms - last > STALLED)
        {
            self.time.patient_until = now.ms + AFTER_STALL;
        }
        self.time.last_tick = Some(now.ms);
        while let Some((at, timer)) = self
            .time
            .timers
            .first()
            .copied()
            .filter(|(at, _)| *at <= now.ms)
        {
            self.time.timers.remove(&(at, timer));
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
            Timer::Backpressure(id) => {
                if let Some(w) = self.roster.workers.get_mut(&id)
                    && w.backpressured_until.is_some_and(|until| until <= now.ms)
                {
                    w.backpressured_until = None;
                    self.list_worker(id);
                }
            }
            Timer::Leasing => {
                if self.time.paused_until.is_some_and(|until| until <= now.ms) {
                    self.time.paused_until = None;
                }
            }
        }
    }

    /// Returns the facts for checking an output that arrives under a lease, and the permitted use of the
    /// output.
    ///
    /// An output counts if the lease was given, at any time, to a worker that is not quarantined. The
    /// scheduler knows the holder of a lease of this epoch. A lease of an earlier epoch is accepted: its tag,
    /// which the caller has checked, proves that it was given. Its output becomes the tile's first output, or
    /// equals the tile's output, or is rejected. An output of a done tile can only be compared with the
    /// stored one. An output does not count if its lease was given before tiles of the job were reopened,
    /// because it may be computed from those tiles.
    ///
    /// # Errors
    /// The reason, if the tile does not exist.
    pub fn admit(&self, lease: &Lease) -> Result<Admission, NoTile> {
        let job = self.jobs.get(&lease.job).ok_or(NoTile::NoJob(lease.job))?;
        let tile = job.tiles.get(lease.tile.at()).ok_or(NoTile::NoTile)?;
        let given = Some(lease.id.number).filter(|_| lease.id.epoch == self.settings.epoch);
        let given = given.and_then(|number| job.given_to(number, lease.tile));
        // The holder of a lease of an earlier epoch is known if the lease was claimed. If results are
        // checked, unclaimed leases do not count, because no worker would be responsible for them.
        let holder = self
            .leases
            .table
            .get(&lease.id)
            .filter(|l| (l.job, l.tile) == (lease.job, lease.tile));
        let holder = holder
            .and_then(|l| self.roster.workers.get(&l.worker))
            .map(|w| Name::clone(&w.signature));
        let trusting = self.settings.spot_check <= 0.0 && self.trust.quarantined.is_empty();
        let earlier = lease.id.epoch < self.settings.epoch && (trusting || holder.is_some());
        let given = given.or(holder);
        let is_good = |name: &Name| !self.trust.quarantined.contains(name);
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
        let is_check = self.leases.table.get(&lease.id).is_some_and(|l| l.checks);
        let right = match (counts, is_check) {
            (false, _) => Right::Stale,
            (true, true) => Right::Compare { worker },
            (true, false) => Right::Keep { worker, helpers },
        };
        Ok(Admission {
            job: Arc::clone(&job.planned),
            profile: job.record.profile.clone().unwrap_or_default(),
            right,
        })
    }

    /// Returns a job that has not ended.
    pub fn job(&self, id: JobId) -> Option<&OpenJob> {
        self.jobs.get(&id)
    }

    /// Returns the ids of the jobs that have not ended.
    pub fn job_ids(&self) -> Vec<JobId> {
        self.jobs.keys().copied().collect()
    }

    /// Returns the number of connected workers.
    pub fn workers(&self) -> u32 {
        self.roster.workers.len() as u32
    }

    /// Removes a job from the scheduler and ends its leases.
    pub(super) fn drop_job(&mut self, id: JobId) {
        self.revoke_job(id);
        self.unlist_job(id);
        self.trust.spotted.retain(|(job, _)| *job != id);
        self.clear_suspects(id, None);
        if let Some(job) = self.jobs.remove(&id) {
            self.close_account(&job.key.user);
        }
        self.tell_watchers(id);
    }

    /// Starts assembling the result of a job whose tiles are complete.
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

    /// Returns true if tiles of the job may be leased.
    pub(super) fn allowed(&self, job: &OpenJob) -> bool {
        matches!(
            job.record.state.phase(),
            JobPhase::Queued | JobPhase::Running
        ) && self.only.is_none_or(|only| only == job.record.id)
    }
}

/// The facts for checking an output that arrives under a lease; see [`Scheduler::admit`].
#[derive(Debug)]
pub struct Admission {
    /// The planned job of the lease.
    pub job: Arc<PlannedJob>,
    /// The numerics profile of the job.
    pub profile: String,
    /// The permitted use of the output.
    pub right: Right,
}

impl Admission {
    /// Returns true if the output counts.
    pub fn counts(&self) -> bool {
        !matches!(self.right, Right::Stale)
    }
}

/// The permitted use of an output that arrives under a lease.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Right {
    /// The output becomes the output of its tile, unless the tile already has one.
    Keep {
        /// The signature of the worker that holds or held the lease; empty if the worker is unknown.
        worker: String,
        /// The signatures of the other workers that contributed to the tile.
        helpers: Vec<String>,
    },
    /// The lease is the check of a done tile: the output is compared with the tile's output.
    Compare {
        /// The signature of the worker that holds or held the lease; empty if the worker is unknown.
        worker: String,
    },
    /// The output does not count.
    Stale,
}

/// An error about a lease on a job or tile that does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoTile {
    /// The job has ended or does not exist.
    NoJob(JobId),
    /// The job has no tile with this index.
    NoTile,
}
