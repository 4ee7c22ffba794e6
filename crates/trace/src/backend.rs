//! The interface of a sampling backend, which renders visibility cubes and traces sight lines of a scene.
//!
//! A backend gives the same bits for the same input on every run and thread count. Two backends differ in a
//! few pixels, so a job names its numerics profile.

use glam::Vec3;
use sightline_model::VisibilitySample;

use crate::cube::CubeImage;
use crate::error::BackendError;
use crate::packet::{LineTracer, PassingTracer};

/// The triangles among which sight lines are traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineSet {
    /// Those that end a line.
    Blocking = 0,
    /// Those that a line passes.
    SeeThrough = 1,
    /// Those whose masks decide whether a line passes.
    Masked = 2,
}

impl LineSet {
    /// The number of sets.
    pub const COUNT: usize = 3;
}

/// A backend bound to one scene and one [`crate::cube::CubeSpec`].
pub trait Backend: Send + Sync {
    /// The numerics profile: backend, library and version, device. Two workers with the same profile give the
    /// same bits. Printable ASCII.
    fn profile(&self) -> &str;

    /// Prepares the rendering of the triangles in `superset` (ascending ids) only, or of the whole scene when
    /// `None` (superset simplification; Nirenstein and Blake 2004, section 4.2.1).
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device cannot hold the geometry.
    fn prepare(&self, superset: Option<&[u32]>)
    -> Result<Box<dyn CubeRenderer + '_>, BackendError>;

    /// Prepares the tracing of sight lines among the triangles `ids` (ascending, the same in every call with
    /// the same set).
    ///
    /// # Errors
    /// [`BackendError`] when the device cannot, or cannot hold the geometry.
    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, BackendError>;

    /// Prepares the tracing of lines among those that end them and those that they pass at once; `None` when
    /// the backend traces among one set of triangles only. The ids are as in [`Backend::lines`].
    ///
    /// # Errors
    /// As [`Backend::lines`].
    fn passing(
        &self,
        _blocking: &[u32],
        _see_through: &[u32],
    ) -> Result<Option<Box<dyn PassingTracer + '_>>, BackendError> {
        Ok(None)
    }
}

/// Renders cubes of the geometry given to [`Backend::prepare`]. Degenerate triangles are never seen.
pub trait CubeRenderer: Send + Sync {
    /// One sample a point, in the points' order.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, BackendError>;

    /// The full item buffers seen from `point`.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn image(&self, point: Vec3) -> Result<CubeImage, BackendError>;

    /// The full item buffers, and the see-through triangles in front of them as (pixel, id) pairs. The ids in
    /// the buffers are those of blocking triangles that show.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    fn layers(&self, point: Vec3) -> Result<(CubeImage, Vec<(u32, u32)>), BackendError> {
        Ok((self.image(point)?, Vec::new()))
    }
}
