//! The start of a coordinator on a store, and the tick that passes the time to the scheduler.

use std::sync::Arc;

use sightline_records::ids::{Epoch, JobId, TileIndex};
use sightline_records::{JobPhase, JobState};
use sightline_scheduler::{Event, OpenJob, Output, Scheduler, Settings};
use sightline_store::{BlobError, Blobs, Outcomes, SledStore, Store, StoreError};

use crate::blobs::ownership;
use crate::blobs::references::KeepingError;
use crate::clock::{Clock, Moment, SystemClock};
use crate::config::{Config, Leases, RunSettings};
use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::dispatch::dispatcher::Dispatcher;
use crate::dispatch::run::tell_and_run;
use crate::jobs::retention_clock::RetentionClock;
use crate::jobs::retention_stamp;
use crate::jobs::stored_spec;
use crate::jobs::suspensions::Suspensions;
use crate::records::Records;
use crate::results::state::ResultState;
use crate::telemetry::events::{EventKind, EventLog, LogEvent};
use crate::telemetry::state::Telemetry;
use crate::timekeeper::Timekeeper;
use crate::uploads::state::UploadState;
use crate::users::state::UserState;
use crate::workers::crews::Crews;
use crate::workers::state::WorkerState;

/// An error that prevents a coordinator from starting.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blob store failed.
    #[error(transparent)]
    Blobs(#[from] BlobError),
}

impl From<KeepingError> for OpenError {
    fn from(error: KeepingError) -> Self {
        match error {
            KeepingError::Store(e) => Self::Store(e),
            KeepingError::Blob(e) => Self::Blobs(e),
        }
    }
}

impl Coordinator {
    /// Opens the store and the blobs in the data directory, and starts on them. A missing data directory is
    /// created.
    ///
    /// # Errors
    /// [`OpenError`] if the directory is in use, damaged, or cannot be written.
    pub fn open(config: Config) -> Result<Arc<Self>, OpenError> {
        let store = SledStore::open(&config.data_dir.join("state"))?;
        let blobs = config.open_blobs(None)?;
        Self::open_on(config, Box::new(store), blobs)
    }

    /// Starts on an opened store and opened blobs, inside or outside the data directory.
    ///
    /// The other files of the data directory are outcomes of phases (`crews`), the event log (`events`) and
    /// copies of objects (`copies`), which the coordinator can lose.
    ///
    /// # Errors
    /// [`OpenError`] if the store or the blobs fail.
    pub fn open_on(
        config: Config,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
    ) -> Result<Arc<Self>, OpenError> {
        let parts = Parts {
            outcomes: Outcomes::in_directory(config.data_dir.join("crews")),
            event_log: EventLog::open(config.data_dir.join("events")),
            settings: RunSettings {
                leases: config.leases,
                quotas: config.quotas,
                retention: config.retention,
                data_dir: Some(config.data_dir),
            },
        };
        Self::start(parts, store, blobs, Box::new(SystemClock))
    }

    /// Starts on a store: begins its next epoch, and continues the jobs that have not ended. This coordinator
    /// does not store outcomes of phases, so crews have no helpers.
    ///
    /// # Errors
    /// [`OpenError`] if the store fails or the blobs cannot be reached.
    pub fn new(
        leases: Leases,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
    ) -> Result<Arc<Self>, OpenError> {
        let parts = Parts {
            outcomes: Outcomes::nowhere(),
            event_log: EventLog::in_memory(),
            settings: RunSettings {
                leases,
                ..RunSettings::default()
            },
        };
        Self::start(parts, store, blobs, clock)
    }

    fn start(
        parts: Parts,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
    ) -> Result<Arc<Self>, OpenError> {
        let Parts {
            settings,
            outcomes,
            event_log,
        } = parts;
        let epoch = Epoch(store.begin_epoch()?);
        let identity = store.identity()?;
        // An empty blob store receives the store's name before its first blob.
        if let Some(refusal) = ownership::check(identity.id(), &*blobs)?.refusal() {
            tracing::warn!("{refusal}");
        }
        let started = clock.now();
        // The stamp has to be in the store before the coordinator records the end of any job.
        let retention_clock = stamped_clock(&*store, &settings, started)?;
        let scheduler = Scheduler::new(scheduler_settings(&settings.leases, epoch, started)?);
        let jobs = open_jobs(&*store, &*blobs, started)?;
        // Quarantined workers may have computed some of the stored outcomes of phases.
        let trusted = store.quarantined()?.is_empty();
        // The end of the last run may have come between the commit of a tile and the removal of its outcomes.
        let is_open = |job: &OpenJob, tile: TileIndex| {
            let tile = job.tiles.get(tile.at());
            tile.is_some_and(|tile| tile.output == Output::Open)
        };
        outcomes.sweep(|id, tile| {
            let job = jobs.iter().find(|job| job.record.id == id);
            trusted && job.is_some_and(|job| is_open(job, tile))
        });
        let this = Arc::new(Self {
            config: settings,
            clock: Timekeeper::new(clock, retention_clock),
            records: Records::new(store),
            blobs,
            dispatcher: Dispatcher::new(scheduler),
            uploads: UploadState::default(),
            workers: WorkerState::new(&identity, Crews::new(outcomes)),
            results: ResultState::default(),
            users: UserState::default(),
            telemetry: Telemetry::new(event_log),
            suspensions: Suspensions::default(),
        });
        this.records.report_syncs(&this.telemetry.metrics);
        let version = env!("CARGO_PKG_VERSION");
        let text = format!(
            "the coordinator starts, version {version}; jobs to continue: {}",
            jobs.len()
        );
        this.record_event(LogEvent::new(EventKind::Coordinator, text));
        retention_stamp::report(&this);
        for quarantined in this.records.quarantined()? {
            tell_and_run(&this, Event::Quarantined(quarantined.worker));
        }
        for job in jobs {
            tell_and_run(&this, Event::TakenUp(Box::new(job)));
        }
        Ok(this)
    }

    /// Restricts grants to the tiles of `job`. Other jobs do not change. A bake in one process uses this, so
    /// that it does not continue other bakes of its store.
    pub fn restrict_to(self: &Arc<Self>, job: impl Into<JobId>) {
        tell_and_run(self, Event::Restricted(job.into()));
    }
}

/// The settings and the files of a coordinator that starts.
struct Parts {
    settings: RunSettings,
    outcomes: Outcomes,
    event_log: EventLog,
}

/// Returns the clock of retention, started from the last stamp of the store, and records a new stamp.
fn stamped_clock(
    store: &dyn Store,
    settings: &RunSettings,
    started: Moment,
) -> Result<RetentionClock, StoreError> {
    let mut clock = RetentionClock::new(store.retention_stamp()?, settings.ages(), started);
    let stamp = clock.stamp(started);
    store.stamp_retention(stamp)?;
    clock.recorded(&stamp);
    Ok(clock)
}

/// Returns the settings of the scheduler for this epoch.
fn scheduler_settings(
    leases: &Leases,
    epoch: Epoch,
    started: Moment,
) -> Result<Settings, StoreError> {
    Ok(Settings {
        epoch,
        ttl: leases.ttl.as_millis() as u64,
        stuck: leases.stuck.as_millis() as u64,
        seed: started.unix_ms,
        spot_check: leases.spot_check,
        spot_seed: spot_seed(leases.spot_check)?,
    })
}

/// Returns the jobs that have not ended, and fails the jobs that this version cannot continue.
fn open_jobs(
    store: &dyn Store,
    blobs: &dyn Blobs,
    started: Moment,
) -> Result<Vec<OpenJob>, OpenError> {
    let mut jobs = Vec::new();
    for record in store.jobs()? {
        if record.state.phase().ended() {
            continue;
        }
        let (id, tiles) = (record.id, store.tiles(record.id)?);
        // Workers finish the leased tiles of a paused job, too, so its tiles may be running.
        let runs = record.profile.is_some();
        // A job whose specification cannot be read at the moment has not failed.
        if let Ok((_, Some(parts))) = stored_spec::part(&record.spec)
            && let Err(e) = blobs.open_checked(&parts)
            && e.passes()
        {
            return Err(e.into());
        }
        let planned = stored_spec::whole(blobs, &record.spec);
        match planned.and_then(|planned| OpenJob::new(record, Arc::new(planned), tiles)) {
            Ok(job) => jobs.push(if runs { job.after_restart() } else { job }),
            Err(reason) => {
                // Fail the job, so that the same submission starts a new one.
                tracing::error!("job {id} cannot be continued: {reason}");
                let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
                let failed = JobState::Failed { reason };
                store.set_job_state(id, &from, failed, started.unix_ms)?;
            }
        }
    }
    Ok(jobs)
}

/// Returns the secret seed with which the scheduler selects tiles for checks, or 0 if `share` is 0.
fn spot_seed(share: f64) -> Result<u64, StoreError> {
    if share <= 0.0 {
        return Ok(0);
    }
    getrandom::u64().map_err(|e| StoreError::Random {
        what: e.to_string(),
    })
}

/// Passes the time to the scheduler, to be called a few times per second. The scheduler ends leases of
/// disconnected workers and leases that were not renewed or made no progress, and repeats commands that wait.
pub(crate) fn tick(c: &Coordinator) -> FollowUps {
    c.tell(Event::Tick)
}
