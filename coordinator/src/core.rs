//! The coordinator's one piece of shared state: store, blobs, scheduler, and who wants to know of changes.
//!
//! Everything here blocks on the disk; the services call it off the async threads.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::sync::{Semaphore, watch};

use crate::scene_facts::LastScene;
use crate::scheduler::Scheduler;
use crate::store::{BlobError, Blobs, JobPhase, JobState, SledStore, Store, StoreError};

/// Downloads at a time; more wait. Half of the threads that tokio has for what blocks, so that clients that do not read stop
/// nobody but each other.
const MOST_DOWNLOADS: usize = 256;

/// How a coordinator is set up.
#[derive(Clone, Debug)]
pub struct Config {
    /// Where everything is kept.
    pub data_dir: PathBuf,
    /// How long a lease lives without being renewed. Default 10 s.
    pub lease: Duration,
    /// How long a tile may make no progress before its lease is taken back. Default 10 min.
    pub stuck: Duration,
}

impl Config {
    /// The defaults, in `data_dir`.
    pub fn new(data_dir: PathBuf) -> Self {
        Self { data_dir, lease: Duration::from_secs(10), stuck: Duration::from_secs(600) }
    }
}

/// Why a coordinator cannot start.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blobs.
    #[error(transparent)]
    Blobs(#[from] BlobError),
}

/// A running coordinator without its network.
pub struct Coordinator {
    pub(crate) config: Config,
    pub(crate) store: Box<dyn Store>,
    pub(crate) blobs: Blobs,
    pub(crate) scheduler: Mutex<Scheduler>,
    /// Counts changes; watchers wait for it.
    pub(crate) changes: watch::Sender<u64>,
    pub(crate) last_scene: LastScene,
    /// Permits for downloads, each of which keeps a thread for as long as its client takes.
    pub(crate) downloads: Arc<Semaphore>,
}

impl Coordinator {
    /// Opens the data directory, begins the next epoch and takes up the jobs that have not ended.
    ///
    /// # Errors
    /// [`OpenError`] when the directory is in use, damaged, or cannot be written.
    pub fn open(config: Config) -> Result<Arc<Self>, OpenError> {
        let store = SledStore::open(&config.data_dir.join("state"))?;
        let blobs = Blobs::open(&config.data_dir.join("blobs"))?;
        let epoch = store.begin_epoch()?;
        let mut scheduler = Scheduler::new(epoch);
        for record in store.jobs()? {
            if !record.state.phase().ended() {
                let (id, tiles) = (record.id, store.tiles(record.id)?);
                if let Err(reason) = scheduler.take_up(record, tiles) {
                    // Ended, so that submitting it again begins a new one.
                    tracing::error!("job {id} cannot be taken up: {reason}");
                    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
                    store.set_job_state(id, &from, JobState::Failed { reason }, now_ms())?;
                }
            }
        }
        let this = Arc::new(Self {
            config,
            store: Box::new(store),
            blobs,
            scheduler: Mutex::new(scheduler),
            changes: watch::Sender::new(0),
            last_scene: LastScene::default(),
            downloads: Arc::new(Semaphore::new(MOST_DOWNLOADS)),
        });
        this.assemble_ready();
        Ok(this)
    }

    /// From now on works on `job` alone; other jobs stay as they are.
    pub fn restrict_to(&self, job: u64) {
        self.lock().restrict_to(job);
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Scheduler> {
        // The scheduler's state is derived from the store and checked against it with every command; a panic in
        // the middle of a change can lose a lease, not a result.
        self.scheduler.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says that something changed.
    pub(crate) fn changed(&self) {
        self.changes.send_modify(|n| *n += 1);
    }

    /// Gives out tiles to whoever wants some and can take them.
    pub(crate) fn pump(&self) {
        let mut scheduler = self.lock();
        if let Err(e) = scheduler.pump(&*self.store, Instant::now()) {
            scheduler.pause_leasing(Instant::now());
            tracing::error!("no leases are given out for a while: {e}");
        }
    }

    /// Takes back leases whose worker has gone, that were not renewed or make no progress. Called every second.
    pub(crate) fn reap(self: &Arc<Self>) {
        // Before waiting for the lock, for which workers that have come back may be waiting, too.
        let now = Instant::now();
        let expired = self.lock().reap(now, self.config.lease, self.config.stuck);
        if expired > 0 {
            self.changed();
        }
        self.pump();
        // What could not be put together for want of space is tried again.
        self.assemble_ready();
    }
}

/// Milliseconds since 1970, for records people read.
pub(crate) fn now_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64)
}

#[cfg(test)]
mod tests {
    use sightline_proto::v1;
    use sightline_proto::v1::jobs_server::Jobs as _;
    use sightline_scene::{Object, Scene, Triangle};
    use tonic::{Code, Request};

    use super::*;
    use crate::jobs_service::JobsService;
    use crate::store::NewJob;

    #[tokio::test]
    async fn a_job_of_another_version_is_not_opened_again() {
        let directory = tempfile::tempdir().unwrap();
        let coordinator = Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
        let triangle = Triangle { v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y] };
        let objects = vec![Object { name: "all".to_owned(), first: 0, count: 1 }];
        let scene = coordinator.take_scene(&Scene::new("test", vec![triangle], objects).unwrap()).unwrap();
        let job = NewJob {
            key: [1; 32],
            request_id: String::new(),
            name: "old".to_owned(),
            scene,
            spec: b"of another version".to_vec(),
            tiles: 2,
            submitted_at_ms: 0,
        };
        let id = coordinator.store.submit_job(job).unwrap().id;
        let failed = JobState::Failed { reason: "as it was".to_owned() };
        coordinator.store.set_job_state(id, &[JobPhase::Queued], failed.clone(), 1).unwrap();
        let service = JobsService(Arc::clone(&coordinator));
        let refused = service.retry(Request::new(v1::ShowRequest { job: id })).await.unwrap_err();
        assert_eq!(refused.code(), Code::FailedPrecondition);
        assert!(refused.message().contains("submit it again"), "{refused}");
        assert_eq!(coordinator.store.job(id).unwrap().unwrap().state, failed);
    }
}
