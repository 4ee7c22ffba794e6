//! The region that holds all viewpoints of a job, for the sampler and for exact queries.

use glam::Vec3;
use sightline_model::Viewpoints;
use sightline_numbers::Aabb;
use sightline_portals::{ForeignRegion, Reached};
use sightline_scene::Scene;

/// The region of a job.
pub struct JobRegion(Reached);

impl JobRegion {
    /// Prepares the region of a job with its planes; `None` when viewpoints are not restricted to one.
    ///
    /// # Errors
    /// [`ForeignRegion`].
    pub fn of(viewpoints: &Viewpoints, scene: &Scene) -> Result<Option<Self>, ForeignRegion> {
        viewpoints
            .region()
            .map(|region| Reached::new(region, scene).map(Self))
            .transpose()
    }

    /// The region for exact queries.
    pub fn places(&self) -> &dyn sightline_exact::ExactViewRegion {
        &self.0
    }
}

impl sightline_sample::ViewRegion for JobRegion {
    fn hold(&self, point: Vec3) -> bool {
        self.0.holds(point)
    }

    fn any_in(&self, of: Aabb) -> Option<Vec3> {
        self.0.any_in(of)
    }

    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        self.0.touches(triangle, within)
    }
}
