//! Starting a coordinator, and the work that it does every second.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sightline_records::ids::{Epoch, JobId};
use sightline_records::{JobPhase, JobState};
use sightline_scheduler::{Event, Job, Scheduler, Settings};
use sightline_store::{
    BlobError, BlobPlace, Blobs, FileBlobs, ObjectBlobs, Outcomes, SledStore, Store, StoreError,
};

use crate::blobs::ownership;
use crate::blobs::references::KeepingError;
use crate::clock::{Clock, SystemClock};
use crate::dispatch::run::happened;
use crate::dispatch::{FollowUps, tell};
use crate::jobs::retention_clock::{Ages, RetentionClock};
use crate::jobs::retention_stamp;
use crate::jobs::stored_spec;
use crate::kept::Retention;
use crate::quota::Quotas;
use crate::state::{Coordinator, Leases};
use crate::telemetry::events::{EventLog, Kind, LogEvent};
use crate::workers::crews::Crews;

/// The settings of a coordinator on one machine's disk.
#[derive(Clone, Debug)]
pub struct Config {
    /// The directory of the store (`state/`) and of the blobs (`blobs/`).
    pub data_dir: PathBuf,
    /// How long leases live.
    pub leases: Leases,
    /// What users may have and do.
    pub quotas: Quotas,
    /// How long things are kept.
    pub retention: Retention,
    /// Where the blobs are; `None` for `blobs/` in the data directory.
    pub blobs: Option<BlobPlace>,
}

impl Config {
    /// The default settings with this data directory.
    pub fn new(data_dir: PathBuf) -> Self {
        let (leases, quotas, retention) =
            (Leases::default(), Quotas::default(), Retention::default());
        Self {
            data_dir,
            leases,
            quotas,
            retention,
            blobs: None,
        }
    }

    /// Opens the blobs. `shared` is the name under which this process writes to a directory that others use,
    /// too.
    ///
    /// # Errors
    /// [`BlobError`] when the place cannot be used.
    pub fn open_blobs(&self, shared: Option<&str>) -> Result<Box<dyn Blobs>, BlobError> {
        let in_files = |directory: &Path| match shared {
            None => FileBlobs::open(directory),
            Some(name) => FileBlobs::open_shared(directory, name),
        };
        Ok(match &self.blobs {
            None => Box::new(in_files(&self.data_dir.join("blobs"))?),
            Some(BlobPlace::Directory(directory)) => Box::new(in_files(directory)?),
            Some(BlobPlace::Bucket(place)) => {
                Box::new(ObjectBlobs::open(place, &self.data_dir.join("copies"))?)
            }
        })
    }
}

impl Config {
    /// Opens the blobs for reading only. Copies of objects of a bucket go into the folder `copies`.
    ///
    /// # Errors
    /// [`BlobError`] when the place cannot be used.
    pub fn inspect_blobs(&self, copies: &Path) -> Result<Box<dyn Blobs>, BlobError> {
        Ok(match &self.blobs {
            None => Box::new(FileBlobs::inspect(&self.data_dir.join("blobs"))?),
            Some(BlobPlace::Directory(directory)) => Box::new(FileBlobs::inspect(directory)?),
            Some(BlobPlace::Bucket(place)) => Box::new(ObjectBlobs::open(place, copies)?),
        })
    }
}

/// A coordinator that cannot start.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blobs failed.
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
    /// Opens the store and the blobs in the data directory, which is created if it is missing, and starts on
    /// them.
    ///
    /// # Errors
    /// [`OpenError`] when the directory is in use, damaged, or cannot be written.
    pub fn open(config: Config) -> Result<Arc<Self>, OpenError> {
        let store = SledStore::open(&config.data_dir.join("state"))?;
        let blobs = config.open_blobs(None)?;
        Self::open_on(config, Box::new(store), blobs)
    }

    /// The same on a store and blobs that lie elsewhere, for a coordinator that leads others: the data
    /// directory holds what it alone needs, and can lose.
    ///
    /// # Errors
    /// The store's.
    pub fn open_on(
        config: Config,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
    ) -> Result<Arc<Self>, OpenError> {
        let outcomes = Outcomes::of(config.data_dir.join("crews"));
        let event_log = EventLog::of(config.data_dir.join("events"));
        let kept = (
            outcomes,
            event_log,
            Some((config.data_dir, config.quotas, config.retention)),
        );
        Self::start(config.leases, store, blobs, Box::new(SystemClock), kept)
    }

    /// Starts on a store: begins its next epoch and continues the jobs that have not ended. Keeps no outcomes
    /// of phases, so that crews have leaders alone.
    ///
    /// # Errors
    /// The store's; the blobs' where they cannot be reached.
    pub fn new(
        leases: Leases,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
    ) -> Result<Arc<Self>, OpenError> {
        Self::start(
            leases,
            store,
            blobs,
            clock,
            (Outcomes::nowhere(), EventLog::nowhere(), None),
        )
    }

    fn start(
        leases: Leases,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
        (outcomes, event_log, config): (Outcomes, EventLog, Option<(PathBuf, Quotas, Retention)>),
    ) -> Result<Arc<Self>, OpenError> {
        let epoch = Epoch(store.begin_epoch()?);
        // An empty blob store receives the store's name before the first blob.
        if let Some(refusal) = ownership::check(store.identity()?.id(), &*blobs)?.refusal() {
            tracing::warn!("{refusal}");
        }
        // Before any end of a job is recorded.
        let started = clock.now();
        let retention = config
            .as_ref()
            .map_or_else(Retention::default, |(.., retention)| *retention);
        let ages = Ages {
            jobs: retention.keep,
            blobs: Some(retention.grace),
        };
        let mut retention_clock = RetentionClock::new(store.retention_stamp()?, ages, started);
        let stamp = retention_clock.stamp(started);
        store.stamp_retention(stamp)?;
        retention_clock.recorded(&stamp);
        let settings = Settings {
            epoch,
            ttl: leases.ttl.as_millis() as u64,
            stuck: leases.stuck.as_millis() as u64,
            seed: started.unix_ms,
            spot_check: leases.spot_check,
            spot_seed: spot_seed(leases.spot_check)?,
        };
        let mut jobs = Vec::new();
        for record in store.jobs()? {
            if !record.state.phase().ended() {
                let (id, tiles) = (record.id, store.tiles(record.id)?);
                // Its tiles may be at work: workers finish them while it is paused, too.
                let runs = record.profile.is_some();
                // A job whose specification cannot be reached now is no job that has failed.
                if let Ok((_, Some(parts))) = stored_spec::part(&record.spec)
                    && let Err(e) = blobs.open_checked(&parts)
                    && e.passes()
                {
                    return Err(e.into());
                }
                let work = stored_spec::whole(&*blobs, &record.spec);
                match work.and_then(|work| Job::new(record, Arc::new(work), tiles)) {
                    Ok(job) => jobs.push(if runs { job.after_restart() } else { job }),
                    Err(reason) => {
                        // The job ends, so that submitting it again begins a new one.
                        tracing::error!("job {id} cannot be continued: {reason}");
                        let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
                        store.set_job_state(
                            id,
                            &from,
                            JobState::Failed { reason },
                            started.unix_ms,
                        )?;
                    }
                }
            }
        }
        // Quarantined workers may have had a hand in what is kept of phases.
        let trusted = store.quarantined()?.is_empty();
        outcomes.sweep(|job| trusted && jobs.iter().any(|j: &Job| j.record.id == job));
        let crews = Crews::new(outcomes);
        let kept = (crews, event_log);
        let identity = store.identity()?;
        let mut this = Self::of(
            leases,
            &identity,
            store,
            blobs,
            clock,
            kept,
            Scheduler::new(settings),
        );
        if let Some((data_dir, quotas, retention)) = config {
            (this.data_dir, this.quotas, this.retention) = (Some(data_dir), quotas, retention);
        }
        this.continue_retention(retention_clock);
        this.store.report_syncs(&this.metrics);
        let this = Arc::new(this);
        let version = env!("CARGO_PKG_VERSION");
        let text = format!(
            "the coordinator starts, version {version}; jobs to go on with: {}",
            jobs.len()
        );
        this.happened(LogEvent::of(Kind::Coordinator, text));
        retention_stamp::report(&this);
        for quarantined in this.store.quarantined()? {
            happened(&this, Event::Quarantined(quarantined.worker));
        }
        for job in jobs {
            happened(&this, Event::TakenUp(Box::new(job)));
        }
        Ok(this)
    }

    /// From now on grants tiles of `job` alone; other jobs stay as they are. A bake in one process does not
    /// continue other bakes of its store.
    pub fn restrict_to(self: &Arc<Self>, job: impl Into<JobId>) {
        happened(self, Event::Restricted(job.into()));
    }
}

/// A number by which tiles are drawn for checks and that no worker knows; not needed without checks.
fn spot_seed(share: f64) -> Result<u64, StoreError> {
    if share <= 0.0 {
        return Ok(0);
    }
    getrandom::u64().map_err(|e| StoreError::Random {
        what: e.to_string(),
    })
}

/// Takes back leases whose worker has gone, that were not renewed or make no progress, and tries again what
/// waited. To be called a few times a second.
pub(crate) fn tick(c: &Coordinator) -> FollowUps {
    tell(c, Event::Tick)
}
