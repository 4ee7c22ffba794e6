//! What the coordinator keeps: for how long, who answers questions about results, and what was made last.

use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_records::ids::{Digest, JobId};
use sightline_scene::Scene;

/// Answers that need the scene.
pub trait SceneQueries: Send + Sync {
    /// Computes why a triangle is visible from a cell or not. Stops when the asker `is_gone`.
    ///
    /// # Errors
    /// A sentence, when the result or the scene does not allow it.
    fn why(
        &self,
        pvs: &Pvs,
        scene: Scene,
        cell_and_triangle: (u32, u32),
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::WhyResponse, String>;

    /// Counts the wrong pixels from the given number of viewpoints. Stops when the asker `is_gone`.
    ///
    /// # Errors
    /// A sentence, when nothing can be rendered.
    fn measure(
        &self,
        pvs: &Pvs,
        scene: Scene,
        asked: &v1::MeasureRequest,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::MeasureResponse, String>;
}

/// How long things are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// The age from which on ended jobs are deleted, with their results; then scenes that no job names.
    /// `None` keeps them.
    pub keep: Option<Duration>,
    /// The bound of the bytes of results and scenes, above which ended jobs are deleted, the lowest
    /// number first. `None` sets no bound.
    pub keep_bytes: Option<u64>,
    /// A blob that nobody needs is removed this long after it was written.
    pub grace: Duration,
}

impl Default for Retention {
    fn default() -> Self {
        // A client that was interrupted can go on with its upload on the next day.
        Self {
            keep: None,
            keep_bytes: None,
            grace: Duration::from_secs(24 * 3600),
        }
    }
}

/// Why a coordinator is not ready, a sentence each.
pub(crate) type NotReady = Vec<String>;

/// When it was last looked whether the coordinator is ready, and how it was.
pub(crate) type LastTrial = Option<(Instant, Result<(), NotReady>)>;

/// The result that was asked about last.
pub(crate) type ReceiverSettings = Option<(Digest, Arc<Pvs>)>;

/// The result of a part of a job that was made last, and of what.
#[derive(Default)]
pub(crate) struct PartialCache(pub(crate) Option<CachedPartial>);

/// A result of these outputs of a job's tiles.
pub(crate) struct CachedPartial {
    pub(crate) job: JobId,
    pub(crate) of: Vec<Option<Digest>>,
    pub(crate) bytes: Arc<[u8]>,
}
