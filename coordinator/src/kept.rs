//! What the coordinator keeps between questions about results: who answers them, and what was made last.

use std::sync::Arc;

use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_scene::Scene;

use crate::ids::{Digest, JobId};

/// Answers that need the scene.
pub trait Answers: Send + Sync {
    /// Why a triangle is visible from a cell or not.
    ///
    /// # Errors
    /// A sentence, when the result or the scene does not allow it.
    fn why(&self, pvs: &Pvs, scene: Scene, cell: u32, triangle: u32) -> Result<v1::WhyResponse, String>;

    /// The wrong pixels from so many viewpoints.
    ///
    /// # Errors
    /// A sentence, when nothing can be rendered.
    fn measure(
        &self,
        pvs: &Pvs,
        scene: Scene,
        asked: &v1::MeasureRequest,
    ) -> Result<v1::MeasureResponse, String>;
}

/// The result that was asked about last.
pub(crate) type Asked = Option<(Digest, Arc<Pvs>)>;

/// The result of a part of a job that was made last, and of what.
#[derive(Default)]
pub(crate) struct Last(pub(crate) Option<Made>);

/// A result of these outputs of a job's tiles.
pub(crate) struct Made {
    pub(crate) job: JobId,
    pub(crate) of: Vec<Option<Digest>>,
    pub(crate) bytes: Arc<[u8]>,
}
