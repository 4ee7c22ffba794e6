//! The state of results: permits and turns of their readers, and the last results that were read.

use std::sync::{Arc, Mutex, OnceLock};

use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_records::ids::{Digest, JobId};
use sightline_scene::{Scene, TriangleId};
use sightline_viewcells::CellIndex;
use tokio::sync::Semaphore;

use crate::quota::FairQueue;

/// Maximum number of simultaneous downloads; further downloads wait. The number is half of tokio's threads
/// for blocking work, so that clients that do not read delay only other downloads.
const MAX_DOWNLOADS: usize = 256;

/// A program that answers queries which need the scene.
pub trait SceneQueries: Send + Sync {
    /// Explains why a triangle is visible from a cell or not. Stops if `is_gone` returns true.
    ///
    /// # Errors
    /// A sentence, if the result or the scene does not permit the query.
    fn why(
        &self,
        pvs: &Pvs,
        scene: Scene,
        cell: CellIndex,
        triangle: TriangleId,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::WhyResponse, String>;

    /// Counts the wrong pixels from the given number of viewpoints. Stops if `is_gone` returns true.
    ///
    /// # Errors
    /// A sentence, if the scene cannot be rendered.
    fn measure(
        &self,
        pvs: &Pvs,
        scene: Scene,
        asked: &v1::MeasureRequest,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::MeasureResponse, String>;
}

/// The partial result that was assembled last.
#[derive(Default)]
pub(crate) struct PartialCache(pub(super) Option<CachedPartial>);

/// A partial result of a job.
pub(super) struct CachedPartial {
    pub(super) job: JobId,
    /// The outputs of the tiles that the partial result contains.
    pub(super) outputs: Vec<Option<Digest>>,
    pub(super) bytes: Arc<[u8]>,
}

/// The shared state of results.
pub(crate) struct ResultState {
    /// The permits for downloads. Each download occupies a thread until its client has read all bytes.
    pub(crate) downloads: Arc<Semaphore>,
    /// The turns of queries and pages that keep a scene in memory.
    pub(crate) questions: FairQueue,
    /// The turns of look-ups in results, and of estimates.
    pub(crate) lookups: FairQueue,
    /// The result that was queried last.
    pub(crate) last_queried: Mutex<Option<(Digest, Arc<Pvs>)>>,
    /// The partial result that was assembled last.
    pub(crate) last_partial: Mutex<PartialCache>,
    /// The program that answers queries which need the scene.
    pub(crate) scene_queries: OnceLock<Box<dyn SceneQueries>>,
}

impl Default for ResultState {
    fn default() -> Self {
        Self {
            downloads: Arc::new(Semaphore::new(MAX_DOWNLOADS)),
            questions: FairQueue::default(),
            lookups: FairQueue::default(),
            last_queried: Mutex::new(None),
            last_partial: Mutex::default(),
            scene_queries: OnceLock::new(),
        }
    }
}
