//! The region that contains all viewpoints of a job, for the sampler and for exact queries.

use glam::Vec3;
use sightline_model::Viewpoints;
use sightline_numbers::Aabb;
use sightline_portals::{ForeignRegion, RegionPlanes};
use sightline_scene::Scene;

/// A job's region of viewpoints, with the planes of its triangles.
pub struct JobRegion(RegionPlanes);

impl JobRegion {
    /// Creates the region of a job from its viewpoints. Returns `None` if the viewpoints are not restricted
    /// to a region.
    ///
    /// # Errors
    /// [`ForeignRegion`] if the region is of another scene.
    pub fn from_viewpoints(
        viewpoints: &Viewpoints,
        scene: &Scene,
    ) -> Result<Option<Self>, ForeignRegion> {
        viewpoints
            .region()
            .map(|region| RegionPlanes::new(region, scene).map(Self))
            .transpose()
    }

    /// Returns the region for exact queries.
    pub fn exact(&self) -> &dyn sightline_exact::ExactViewRegion {
        &self.0
    }
}

impl sightline_sample::ViewRegion for JobRegion {
    fn hold(&self, point: Vec3) -> bool {
        self.0.holds(point)
    }

    fn any_in(&self, bounds: Aabb) -> Option<Vec3> {
        self.0.any_in(bounds)
    }

    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        self.0.touches(triangle, within)
    }
}
