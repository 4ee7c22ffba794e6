//! A view cell: a box of viewpoints.

use glam::{DVec3, Vec3};
use sightline_numbers::Aabb;

/// A view cell: an axis-aligned box in world space with a positive volume.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    min: Vec3,
    max: Vec3,
}

impl Cell {
    /// Creates the cell between the corner `min` and the corner `max`.
    ///
    /// The result is `None` if the box is empty, flat or not finite, because no open set of lines passes
    /// through a face without area.
    pub fn new(min: Vec3, max: Vec3) -> Option<Self> {
        (min.cmplt(max).all() && min.is_finite() && max.is_finite()).then_some(Self { min, max })
    }

    /// Returns the box of the cell.
    pub fn bounds(&self) -> Aabb {
        Aabb {
            min: self.min,
            max: self.max,
        }
    }

    /// Returns the corners `min` and `max`.
    pub fn corners(&self) -> [Vec3; 2] {
        [self.min, self.max]
    }

    /// Returns all eight corners.
    pub fn all_corners(&self) -> [Vec3; 8] {
        let ends = self.corners();
        std::array::from_fn(|k| Vec3::new(ends[k & 1].x, ends[k >> 1 & 1].y, ends[k >> 2].z))
    }

    /// Returns true if a closed box shares a point with the closed cell.
    pub fn touches(&self, bounds: Aabb) -> bool {
        self.bounds().touches(&bounds)
    }

    /// Estimates the apparent size of the box from `min` to `max`, seen from the cell. The size has no unit
    /// and serves only for comparisons.
    ///
    /// The size is half the box's surface over the square of its distance, which includes half the cell's
    /// size.
    pub fn size_of(&self, min: Vec3, max: Vec3) -> f64 {
        let [lo, hi, min, max] = [self.min, self.max, min, max].map(|v| v.as_dvec3());
        let d = max - min;
        let apart = (min - hi).max(lo - max).max(DVec3::ZERO);
        // The distance includes half the cell's size, so that no box has an infinite size.
        let near = apart.length_squared() + 0.25 * (hi - lo).length_squared();
        (d.x * d.y + d.y * d.z + d.z * d.x) / near
    }
}
