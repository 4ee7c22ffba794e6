//! A scene prepared for deciding view cells.

use sightline_scene::{Scene, SceneError};

use crate::occluders::Occluders;
use crate::surfaces::Surfaces;

/// The occluders and the closed surfaces of a scene.
///
/// Both are complete when the value exists: nothing is computed lazily and no lock is held later, so that
/// cells can be decided on any thread, those of a rayon pool among them. Queries that need no surfaces take
/// [`Occluders`] alone.
pub struct ExactScene {
    occluders: Occluders,
    surfaces: Surfaces,
}

impl ExactScene {
    /// Finds the occluders and the surfaces of a scene, on all threads of the current rayon pool.
    ///
    /// # Errors
    /// As [`Occluders::new`]: when the scene has more corners than can be numbered.
    pub fn prepare(scene: &Scene) -> Result<Self, SceneError> {
        let occluders = Occluders::new(scene)?;
        let surfaces = Surfaces::new(&occluders);
        Ok(Self {
            occluders,
            surfaces,
        })
    }

    /// The occluders.
    pub fn occluders(&self) -> &Occluders {
        &self.occluders
    }

    /// The closed surfaces.
    pub fn surfaces(&self) -> &Surfaces {
        &self.surfaces
    }
}
