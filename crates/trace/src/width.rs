//! The minimum width of scenes, below which single precision is too short for a backend.

use sightline_scene::Scene;

/// A scene that is too narrow for a backend.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the scene is only {width:e} wide, but --backend {backend} needs at least {least:e}; scale the scene up"
)]
pub struct TooNarrow {
    /// The largest extent of the scene.
    width: f32,
    /// The name of the backend.
    backend: &'static str,
    /// The minimum width.
    least: f32,
}

/// Checks the largest extent of a scene against the minimum of a backend. A scene whose triangles are all in
/// one point has no visible triangle and passes.
///
/// # Errors
/// [`TooNarrow`] if the extent is below `least`.
pub(crate) fn check(scene: &Scene, backend: &'static str, least: f32) -> Result<(), TooNarrow> {
    let width = (scene.bounds().max - scene.bounds().min).max_element();
    if width > 0.0 && width < least {
        Err(TooNarrow {
            width,
            backend,
            least,
        })
    } else {
        Ok(())
    }
}
