//! The coordinator's shared state: store, blobs, clock, scheduler, and the signal that something changed.
//!
//! Nothing here decides anything: the subjects (`scenes`, `submit`, `jobs`, `sessions`, `results`) do. Most
//! calls block on the disk; the services make them off the async threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sightline_scene::{Aabb, Kinds, Object, Source};
use tokio::sync::{Semaphore, watch};

use crate::clock::{Clock, Moment};
use crate::ids::{Digest, JobId};
use crate::scheduler::Scheduler;
use crate::store::{Blobs, Store};

/// Simultaneous downloads; more wait. Half of tokio's threads for blocking work, so that clients that do not
/// read delay only each other.
const MOST_DOWNLOADS: usize = 256;

/// How long leases live.
#[derive(Clone, Copy, Debug)]
pub struct Leases {
    /// How long a lease lives without being renewed. Default 10 s.
    pub ttl: Duration,
    /// How long a tile may make no progress before its lease is taken back. Default 10 min.
    pub stuck: Duration,
}

impl Default for Leases {
    fn default() -> Self {
        Self { ttl: Duration::from_secs(10), stuck: Duration::from_secs(600) }
    }
}

/// The facts about a scene that the coordinator needs, without the triangles.
pub(crate) struct SceneFacts {
    pub(crate) triangles: u32,
    pub(crate) objects: Vec<Object>,
    pub(crate) bounds: Aabb,
    pub(crate) kinds: Kinds,
    /// The places of the objects in their glTF file; empty for other files.
    pub(crate) sources: Vec<Source>,
    /// Whether some triangles have one side.
    pub(crate) culled: bool,
}

/// A coordinator without its network. [`serve`](crate::serve) puts it on the network.
pub struct Coordinator {
    pub(crate) leases: Leases,
    pub(crate) store: Box<dyn Store>,
    pub(crate) blobs: Box<dyn Blobs>,
    clock: Box<dyn Clock>,
    scheduler: Mutex<Scheduler>,
    /// Counts changes; watchers wait for it.
    pub(crate) changes: watch::Sender<u64>,
    /// The facts of the scene used last: consecutive jobs often have the same scene.
    pub(crate) last_scene: Mutex<Option<(Digest, Arc<SceneFacts>)>>,
    /// Permits for downloads, each of which occupies a thread for as long as its client takes.
    pub(crate) downloads: Arc<Semaphore>,
}

impl Coordinator {
    /// The state from its parts.
    pub(crate) fn of(
        leases: Leases,
        store: Box<dyn Store>,
        blobs: Box<dyn Blobs>,
        clock: Box<dyn Clock>,
        scheduler: Scheduler,
    ) -> Self {
        Self {
            leases,
            store,
            blobs,
            clock,
            scheduler: Mutex::new(scheduler),
            changes: watch::Sender::new(0),
            last_scene: Mutex::new(None),
            downloads: Arc::new(Semaphore::new(MOST_DOWNLOADS)),
        }
    }

    /// From now on grants tiles of `job` alone; other jobs stay as they are.
    pub fn restrict_to(&self, job: impl Into<JobId>) {
        self.lock().restrict_to(job.into());
    }

    /// The current time.
    pub(crate) fn now(&self) -> Moment {
        self.clock.now()
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Scheduler> {
        // The scheduler's state is derived from the store and checked against it with every command; a panic
        // in the middle of a change can lose a lease, not a result.
        self.scheduler.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Signals that something changed.
    pub(crate) fn changed(&self) {
        self.changes.send_modify(|n| *n += 1);
    }

    /// Lets the scheduler grant tiles. When the store refuses, no tiles are granted for a while.
    pub(crate) fn grant_tiles(&self) {
        let mut scheduler = self.lock();
        let now = self.now();
        if let Err(e) = scheduler.grant_tiles(&*self.store, now) {
            scheduler.pause_leasing(now.at);
            tracing::error!("no tiles are granted for a while: {e}");
        }
    }
}
