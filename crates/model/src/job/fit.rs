//! The check that a job fits its scene.

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_viewcells::Division;

use super::visibility::count;
use super::{JobSpec, SpecError, Task};

/// The maximum size of the sets of a fine grid as rows of bits, in bytes.
pub const MOST_FINE_BYTES: u64 = 2 << 30;

/// The facts about a scene on which a job depends.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneFacts {
    /// The number of the scene's triangles.
    pub triangles: u32,
    /// The scene's bounds in world space. They are the view box of a message without a view box.
    pub bounds: Option<Aabb>,
    /// True if some triangles have alpha masks.
    pub has_masks: bool,
    /// True if triangles are seen from their front sides only.
    pub is_culled: bool,
}

impl SceneFacts {
    /// Returns the view box of a message with these corners. Returns the scene's bounds if `corners` is
    /// empty.
    pub(super) fn view_box(&self, corners: &[f32]) -> Result<Aabb, SpecError> {
        match (corners, self.bounds) {
            (&[x0, y0, z0, x1, y1, z1], _) => {
                Ok(Aabb::new(Vec3::new(x0, y0, z0), Vec3::new(x1, y1, z1)))
            }
            ([], Some(bounds)) => Ok(bounds),
            _ => Err(SpecError::NO_VIEW_BOX),
        }
    }
}

impl JobSpec {
    /// Checks that a job can be computed for a scene.
    ///
    /// # Errors
    /// [`SpecError`] if a method other than aggressive is used with alpha masks or back-face culling, if the
    /// region of viewpoints belongs to another scene, or if the sets of a fine grid would need too much
    /// memory.
    pub fn fits(&self, scene: &SceneFacts) -> Result<(), SpecError> {
        let Task::Visibility(task) = &self.task else {
            return Ok(());
        };
        if task.is_decided() && scene.has_masks {
            return Err(SpecError::new(
                "method",
                "exact queries do not read alpha textures; omit --alpha-textures, or give \
                 aggressive, or give --opaque or --see-through for the masked triangles",
            ));
        }
        if task.is_decided() && scene.is_culled {
            return Err(SpecError::new(
                "method",
                "exact queries use both sides of every triangle; give aggressive, or omit \
                 --cull-back-faces",
            ));
        }
        if let (Some(_), Division::Grid(sides)) = (task.cells_by_cost(), task.division())
            // A row of bits for the cost and a row for the coded set.
            && 2 * u64::from(scene.triangles.div_ceil(64)) * 8 * count(*sides) > MOST_FINE_BYTES
        {
            return Err(SpecError::new(
                "fine",
                "the sets of so many cells of this scene need more than 2 GiB of memory; give fewer \
                 fine cells",
            ));
        }
        let greatest = task
            .viewpoints()
            .region()
            .and_then(|r| r.greatest_triangle());
        if greatest.is_some_and(|triangle| triangle >= scene.triangles) {
            return Err(SpecError::new(
                "viewpoints",
                "their region refers to a triangle that the scene does not have; give the \
                 viewpoints of this scene",
            ));
        }
        Ok(())
    }
}
