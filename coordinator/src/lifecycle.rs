//! Starting a coordinator, and the work that it does every second.

use std::path::PathBuf;
use std::sync::Arc;

use crate::clock::{Clock, SystemClock};
use crate::ids::Epoch;
use crate::results;
use crate::scheduler::Scheduler;
use crate::specs;
use crate::state::{Coordinator, Leases};
use crate::store::{BlobError, Blobs, FileBlobs, JobPhase, JobState, SledStore, Store, StoreError};

/// The settings of a coordinator on one machine's disk.
#[derive(Clone, Debug)]
pub struct Config {
    /// The directory of the store (`state/`) and of the blobs (`blobs/`).
    pub data_dir: PathBuf,
    /// How long leases live.
    pub leases: Leases,
}

impl Config {
    /// The default settings with this data directory.
    pub fn new(data_dir: PathBuf) -> Self {
        Self { data_dir, leases: Leases::default() }
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

impl Coordinator {
    /// Opens the store and the blobs in the data directory, which is created if it is missing, and starts on
    /// them.
    ///
    /// # Errors
    /// [`OpenError`] when the directory is in use, damaged, or cannot be written.
    pub fn open(config: Config) -> Result<Arc<Self>, OpenError> {
        let store = SledStore::open(&config.data_dir.join("state"))?;
        let blobs = FileBlobs::open(&config.data_dir.join("blobs"))?;
        Ok(Self::new(config.leases, Box::new(store), Box::new(blobs), Box::new(SystemClock))?)
    }

    /// Starts on a store: begins its next epoch and continues the jobs that have not ended.
    ///
    /// # Errors
    /// The store's.
    pub fn new(
        leases: Leases,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
    ) -> Result<Arc<Self>, StoreError> {
        let mut scheduler = Scheduler::new(Epoch(store.begin_epoch()?));
        for record in store.jobs()? {
            if !record.state.phase().ended() {
                let (id, tiles) = (record.id, store.tiles(record.id)?);
                let spec = specs::whole(&*blobs, &record.spec);
                if let Err(reason) = spec.and_then(|spec| scheduler.take_up(record, &spec, tiles)) {
                    // The job ends, so that submitting it again begins a new one.
                    tracing::error!("job {id} cannot be continued: {reason}");
                    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
                    store.set_job_state(id, &from, JobState::Failed { reason }, clock.now().unix_ms)?;
                }
            }
        }
        let this = Arc::new(Self::of(leases, store, blobs, clock, scheduler));
        results::assemble_ready(&this);
        Ok(this)
    }
}

/// Takes back leases whose worker has gone, that were not renewed or make no progress, and tries again what
/// waited for disk space. To be called every second.
pub(crate) fn tick(c: &Arc<Coordinator>) {
    // Taken before waiting for the lock, for which workers that have returned may be waiting, too.
    let now = c.now().at;
    let expired = c.lock().reap(now, c.leases.ttl, c.leases.stuck);
    if expired > 0 {
        c.changed();
    }
    c.grant_tiles();
    results::assemble_ready(c);
}
