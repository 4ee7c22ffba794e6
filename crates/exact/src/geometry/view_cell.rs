//! A view cell: the box that contains the viewpoints.

use glam::{DVec3, Vec3};
use sightline_numbers::Aabb;

/// A view cell: an axis-aligned box in world space with a positive volume.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    min: Vec3,
    max: Vec3,
}

impl Cell {
    /// The box between its least and greatest corner. None if it is empty, flat or not finite: no open set of
    /// lines passes through a face without area.
    pub fn new(min: Vec3, max: Vec3) -> Option<Self> {
        (min.cmplt(max).all() && min.is_finite() && max.is_finite()).then_some(Self { min, max })
    }

    /// The box.
    pub fn bounds(&self) -> Aabb {
        Aabb {
            min: self.min,
            max: self.max,
        }
    }

    /// Least and greatest corner.
    pub fn corners(&self) -> [Vec3; 2] {
        [self.min, self.max]
    }

    /// All eight corners.
    pub fn all_corners(&self) -> [Vec3; 8] {
        let ends = self.corners();
        std::array::from_fn(|k| Vec3::new(ends[k & 1].x, ends[k >> 1 & 1].y, ends[k >> 2].z))
    }

    /// Whether a closed box has a point in common with the closed cell.
    pub fn touches(&self, of: Aabb) -> bool {
        self.bounds().touches(&of)
    }

    /// How large a box looks from the cell: half its surface over the square of its distance. For comparisons
    /// only.
    pub fn size_of(&self, min: Vec3, max: Vec3) -> f64 {
        let [lo, hi, min, max] = [self.min, self.max, min, max].map(|v| v.as_dvec3());
        let d = max - min;
        let apart = (min - hi).max(lo - max).max(DVec3::ZERO);
        // Half the cell's size is added, so that no box has an infinite size.
        let near = apart.length_squared() + 0.25 * (hi - lo).length_squared();
        (d.x * d.y + d.y * d.z + d.z * d.x) / near
    }
}
