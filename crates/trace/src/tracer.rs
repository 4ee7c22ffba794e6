//! The interface of a sampling backend, which renders visibility cubes and traces sight lines of a scene.
//!
//! A backend computes the same bits for the same input on every run and thread count. Two backends differ in
//! a few pixels, so a job names its numerics profile.

use glam::Vec3;
use sightline_model::VisibilitySample;

use crate::cube::CubeImage;
use crate::error::TracerError;
use crate::packet::{LineTracer, PassingTracer};

/// The triangles among which sight lines are traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineSet {
    /// The triangles that end a line.
    Blocking = 0,
    /// The triangles that a line passes.
    SeeThrough = 1,
    /// The triangles whose masks decide whether a line passes.
    Masked = 2,
}

impl LineSet {
    /// The number of sets.
    pub const COUNT: usize = 3;
}

/// A backend for one scene and one [`crate::cube::CubeSpec`].
pub trait Tracer: Send + Sync {
    /// Returns the numerics profile: backend, library and version, device.
    ///
    /// Two workers with the same profile compute the same bits. The profile is printable ASCII.
    fn profile(&self) -> &str;

    /// Prepares the rendering of the triangles in `superset` (ascending ids) only, or of the whole scene if
    /// it is `None`.
    ///
    /// A superset serves superset simplification (Nirenstein and Blake 2004, section 4.2.1).
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device cannot hold the geometry.
    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, TracerError>;

    /// Prepares the tracing of sight lines among the triangles `ids` (ascending, the same in every call with
    /// the same set).
    ///
    /// # Errors
    /// [`TracerError`] if the device does not support tracing, or cannot hold the geometry.
    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, TracerError>;

    /// Prepares the tracing of lines among the triangles that end lines and the triangles that lines pass, in
    /// one traversal.
    ///
    /// Returns `None` if the backend traces only among one set of triangles. The ids are as in
    /// [`Tracer::lines`].
    ///
    /// # Errors
    /// The errors of [`Tracer::lines`].
    fn passing(
        &self,
        _blocking: &[u32],
        _see_through: &[u32],
    ) -> Result<Option<Box<dyn PassingTracer + '_>>, TracerError> {
        Ok(None)
    }
}

/// A renderer of cubes of the geometry given to [`Tracer::prepare`]. Degenerate triangles are never seen.
pub trait CubeRenderer: Send + Sync {
    /// Returns one sample per point, in the points' order.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError>;

    /// Returns the full item buffers seen from `point`.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError>;

    /// Returns the full item buffers, and the see-through triangles in front of them as (pixel, id) pairs.
    /// The ids in the buffers are ids of blocking triangles that show.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    fn layers(&self, point: Vec3) -> Result<(CubeImage, Vec<(u32, u32)>), TracerError> {
        Ok((self.image(point)?, Vec::new()))
    }
}
