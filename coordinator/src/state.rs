//! The coordinator's shared state: store, blobs, clock, scheduler, and who watches which job.
//!
//! Nothing here decides anything: the subjects (`uploads`, `jobs`, `workers`, `outputs`, `results`) do. Most
//! calls block on the disk; the services make them off the async threads.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use sightline_assemble::SceneSummary;
use sightline_model::receivers::Facts;
use sightline_records::ids::{Digest, JobId};
use sightline_scheduler::{Now, Scheduler};
use sightline_store::{Blobs, Store, StoreIdentity};
use sightline_traces::Traces;
use tokio::sync::Semaphore;

use crate::access::Access;
use crate::clock::{Clock, Moment};
use crate::dispatch::outbox::{Scheduling, Watched};
use crate::jobs::retention_clock::{Ages, FutureBlobs, RetentionClock};
use crate::kept::{LastTrial, PartialCache, ReceiverSettings, Retention, SceneQueries};
use crate::locks::{self, Rank, Ranked};
use crate::outputs::staging::Staging;
use crate::quota::{Budget, Intake, Quotas, RateLimiter, Turns, Usage};
use crate::records::Records;
use crate::telemetry::events::{EventLog, LogEvent};
use crate::telemetry::metrics::Metrics;
use crate::telemetry::spans::Spans;
use crate::uploads::chunks::Uploads;
use crate::workers::crews::Crews;
use crate::workers::identity::IdentityProofs;
use crate::workers::lease_tags::LeaseTags;

/// Simultaneous downloads; more wait. Half of tokio's threads for blocking work, so that clients that do not
/// read delay only each other.
const MOST_DOWNLOADS: usize = 256;
/// Scenes that are read from files at a time; more wait.
const FILES_AT_ONCE: usize = 2;
/// Outputs of tiles that are checked at a time; more wait on the disk.
const MAX_CHECKS: usize = 32;

/// How leases are given.
#[derive(Clone, Copy, Debug)]
pub struct Leases {
    /// How long a lease lives without being renewed. Default 10 s.
    pub ttl: Duration,
    /// How long a tile may make no progress before its lease is taken back. Default 10 min.
    pub stuck: Duration,
    /// The share of tiles that are computed again by another worker, 0 to 1. Default 0.
    pub spot_check: f64,
}

impl Default for Leases {
    fn default() -> Self {
        Self {
            ttl: Duration::from_secs(10),
            stuck: Duration::from_secs(600),
            spot_check: 0.0,
        }
    }
}

/// Receivers that are stored.
#[derive(Clone, Debug)]
pub(crate) struct StoredReceivers {
    /// Their length.
    pub(crate) bytes: u64,
    /// What is to be known of them.
    pub(crate) facts: Arc<Facts>,
}

/// A coordinator without its network. [`serve`](crate::serve) puts it on the network.
pub struct Coordinator {
    pub(crate) leases: Leases,
    /// The store, with the locks of its changes.
    pub(crate) store: Records,
    pub(crate) blobs: Box<dyn Blobs>,
    clock: Box<dyn Clock>,
    /// Crews, and the outcomes of the phases of unfinished tiles.
    pub(crate) crews: Crews,
    /// What happened.
    pub(crate) event_log: EventLog,
    /// The spans of jobs.
    pub(crate) spans: Arc<Spans>,
    /// The origin of the scheduler's time.
    origin: Instant,
    /// Never held during a call of the store.
    scheduling: Mutex<Scheduling>,
    watched: Mutex<Watched>,
    /// The facts of the scene used last: consecutive jobs often have the same scene.
    pub(crate) last_scene: Mutex<Option<(Digest, Arc<SceneSummary>)>>,
    /// What was to be known of receivers last: the tiles of a job have the same.
    pub(crate) last_receivers: Mutex<Option<(Digest, StoredReceivers)>>,
    /// The result of a part of a job that was made last.
    pub(crate) last_partial: Mutex<PartialCache>,
    /// Permits for downloads, each of which occupies a thread for as long as its client takes.
    pub(crate) downloads: Arc<Semaphore>,
    /// Permits for reading scenes from files.
    pub(crate) files: Arc<Semaphore>,
    /// Permits for checking outputs of tiles.
    pub(crate) checks: Arc<Semaphore>,
    /// Turns for holding a large upload in memory: users and all workers together come one after the other.
    pub(crate) large: Turns,
    /// The memory of requests that were not handled yet.
    pub(crate) intake: Arc<Intake>,
    /// The bytes of uploads that have not ended.
    pub(crate) unfinished: Budget,
    /// The turns of questions and pages that hold a scene.
    pub(crate) questions: Turns,
    /// The turns of look-ups in results, and of estimates.
    pub(crate) lookups: Turns,
    /// What is asked of callers; nothing when it is not set.
    pub(crate) access: OnceLock<Arc<Access>>,
    /// How long things are kept.
    pub(crate) retention: Retention,
    /// The clocks of retention. May be locked under every other lock.
    retention_clock: Mutex<RetentionClock>,
    /// The lock of stamps of these clocks, so that an earlier stamp does not replace a later one.
    stamping: Mutex<()>,
    /// The unneeded blobs with times in the future.
    future_blobs: Mutex<FutureBlobs>,
    /// What users may have, and how often they call.
    pub(crate) quotas: Quotas,
    pub(crate) pace: RateLimiter,
    /// What users had when it was counted last.
    pub(crate) counted: Mutex<BTreeMap<String, (Instant, Usage)>>,
    /// Held while it is looked whether a user may have something, until it is recorded.
    quota_turn: Mutex<()>,
    /// What is counted.
    pub(crate) metrics: Metrics,
    /// Where the data is, if it is in files.
    pub(crate) data_dir: Option<PathBuf>,
    /// When it was last looked whether the coordinator is ready.
    pub(crate) last_trial: Mutex<LastTrial>,
    /// The chunks that were sent and are no scene yet.
    pub(crate) uploads: Uploads,
    /// The outputs that workers write by themselves.
    pub(crate) staging: Staging,
    /// The proofs of leases, and of the identities of workers.
    pub(crate) lease_tags: LeaseTags,
    pub(crate) identities: IdentityProofs,
    /// Who answers what needs the scene.
    pub(crate) answers: OnceLock<Box<dyn SceneQueries>>,
    /// The result that was asked about last.
    pub(crate) last_asked: Mutex<ReceiverSettings>,
    /// The jobs that wait for a scene or receivers whose file is lost.
    pub(crate) lost: Mutex<BTreeMap<JobId, MissingBlob>>,
    /// Held while jobs are paused for want of these, or go on with them.
    lost_turn: Mutex<()>,
}

/// What a job waits for, because its file is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MissingBlob {
    /// Its scene.
    Scene(Digest),
    /// Its receivers.
    Receivers(Digest),
}

impl MissingBlob {
    /// The digest of what is lost.
    pub(crate) fn digest(self) -> Digest {
        let (Self::Scene(digest) | Self::Receivers(digest)) = self;
        digest
    }
}

impl Coordinator {
    /// Creates the state from its parts. `identity` is the identity of the store.
    pub(crate) fn of(
        leases: Leases,
        identity: &StoreIdentity,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
        (crews, event_log): (Crews, EventLog),
        scheduler: Scheduler,
    ) -> Self {
        let origin = clock.now().at;
        let retention_clock = Mutex::new(RetentionClock::new(None, Ages::default(), clock.now()));
        Self {
            leases,
            store: Records::new(store),
            blobs,
            clock,
            crews,
            event_log,
            spans: Arc::default(),
            origin,
            scheduling: Mutex::new(Scheduling::new(scheduler)),
            watched: Mutex::default(),
            last_scene: Mutex::new(None),
            last_receivers: Mutex::new(None),
            last_partial: Mutex::default(),
            downloads: Arc::new(Semaphore::new(MOST_DOWNLOADS)),
            files: Arc::new(Semaphore::new(FILES_AT_ONCE)),
            checks: Arc::new(Semaphore::new(MAX_CHECKS)),
            large: Turns::of_bounded_requests(),
            intake: Arc::default(),
            unfinished: Budget::default(),
            questions: Turns::default(),
            lookups: Turns::default(),
            access: OnceLock::new(),
            retention: Retention::default(),
            retention_clock,
            stamping: Mutex::default(),
            future_blobs: Mutex::default(),
            quotas: Quotas::default(),
            pace: RateLimiter::default(),
            counted: Mutex::default(),
            quota_turn: Mutex::default(),
            metrics: Metrics::default(),
            data_dir: None,
            last_trial: Mutex::new(None),
            uploads: Uploads::default(),
            staging: Staging::default(),
            lease_tags: LeaseTags::new(identity),
            identities: IdentityProofs::new(identity),
            answers: OnceLock::new(),
            last_asked: Mutex::new(None),
            lost: Mutex::default(),
            lost_turn: Mutex::default(),
        }
    }

    /// Gives questions that need the scene of a stored result to somebody. Only the first one counts.
    pub fn answer_with(&self, answers: Box<dyn SceneQueries>) {
        drop(self.answers.set(answers));
    }

    /// Asks callers who they are from now on. Only the first one counts.
    pub fn ask_callers(&self, access: Arc<Access>) {
        drop(self.access.set(access));
    }

    /// Sends traces of jobs from now on, of those too that have not ended yet. Only the first one counts.
    pub fn send_traces(&self, traces: Traces) {
        self.spans.send_to(traces);
        let scheduling = self.lock();
        let jobs = scheduling.scheduler.job_ids();
        jobs.into_iter()
            .filter_map(|id| scheduling.scheduler.job(id))
            .for_each(|job| self.spans.taken_up(job));
    }

    /// Returns the current time, which the clock of retention has observed.
    pub(crate) fn now(&self) -> Moment {
        let now = self.clock.now();
        self.retention_clock().observe(now, self.ages());
        now
    }

    /// Returns the ages from which on retention deletes.
    pub(crate) fn ages(&self) -> Ages {
        Ages {
            jobs: self.retention.keep,
            blobs: Some(self.retention.grace),
        }
    }

    /// Locks the clock of retention.
    pub(crate) fn retention_clock(&self) -> MutexGuard<'_, RetentionClock> {
        // Each change is complete before anything can panic.
        self.retention_clock
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the unneeded blobs with times in the future.
    pub(crate) fn future_blobs(&self) -> MutexGuard<'_, FutureBlobs> {
        self.future_blobs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the clock of retention by one that continues the last stamp of the store.
    pub(crate) fn continue_retention(&mut self, clock: RetentionClock) {
        self.retention_clock = Mutex::new(clock);
    }

    /// Returns the right to record a stamp of the clock of retention, unless another thread has it.
    pub(crate) fn try_stamping(&self) -> Option<MutexGuard<'_, ()>> {
        match self.stamping.try_lock() {
            Ok(right) => Some(right),
            Err(TryLockError::Poisoned(e)) => Some(e.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Waits for the right to record a stamp of the clock of retention.
    pub(crate) fn stamping(&self) -> MutexGuard<'_, ()> {
        self.stamping.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that something happened, for people. Does not block.
    pub(crate) fn happened(&self, what: LogEvent) {
        self.event_log.record(self.clock.now().unix_ms, what);
    }

    /// The current time as the scheduler counts it.
    pub(crate) fn now_plain(&self) -> Now {
        let now = self.now();
        let ms = now.at.saturating_duration_since(self.origin).as_millis() as u64;
        Now {
            ms,
            unix_ms: now.unix_ms,
        }
    }

    /// The scheduler. Its state is derived from the store; a panic in the middle of a change can lose a
    /// lease, not a result.
    pub(crate) fn lock(&self) -> Ranked<MutexGuard<'_, Scheduling>> {
        locks::lock(Rank::Scheduler, &self.scheduling)
    }

    /// Who watches which job. May be taken under the scheduler's lock.
    pub(crate) fn watched(&self) -> Ranked<MutexGuard<'_, Watched>> {
        locks::lock(Rank::Watchers, &self.watched)
    }

    /// Returns the right to suspend jobs whose scene or receivers are missing, or to resume them. To be taken
    /// before the lock of [`crate::records::JobChanges`].
    pub(crate) fn lost_turn(&self) -> Ranked<MutexGuard<'_, ()>> {
        locks::lock(Rank::Suspension, &self.lost_turn)
    }

    /// The right to add to what a user has.
    pub(crate) fn quota_turn(&self) -> Ranked<MutexGuard<'_, ()>> {
        locks::lock(Rank::Quota, &self.quota_turn)
    }
}
