//! A scene prepared for deciding view cells.

use sightline_scene::{Scene, SceneError};

use crate::occluders::Occluders;
use crate::surfaces::Surfaces;

/// The occluders and the closed surfaces of a scene, for [`crate::decide()`] and [`crate::decide_group`].
///
/// Both are complete when the value exists: the methods compute nothing lazily and hold no lock. So any
/// thread, including threads of a rayon pool, can decide cells. Queries that need no surfaces use only
/// [`Occluders`].
pub struct ExactScene {
    occluders: Occluders,
    surfaces: Surfaces,
}

impl ExactScene {
    /// Computes the occluders and the surfaces of a scene, on all threads of the current rayon pool.
    ///
    /// # Errors
    /// [`SceneError`] from [`Occluders::new`] if the scene has more corners than can be numbered or culls
    /// back faces.
    pub fn prepare(scene: &Scene) -> Result<Self, SceneError> {
        let occluders = Occluders::new(scene)?;
        let surfaces = Surfaces::new(&occluders);
        Ok(Self {
            occluders,
            surfaces,
        })
    }

    /// Returns the occluders.
    pub fn occluders(&self) -> &Occluders {
        &self.occluders
    }

    /// Returns the closed surfaces.
    pub fn surfaces(&self) -> &Surfaces {
        &self.surfaces
    }
}
