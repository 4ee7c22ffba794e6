//! The dyadic lattice of sample positions.
//!
//! Sample positions are integers, and a single function computes world positions from them. So a lattice
//! point has the same `f32` position, bit for bit, in all cells and tiles and on all machines.

use std::sync::Arc;

use glam::Vec3;

/// The number of lattice units along a side of a grid cell: 2^16, so a cell can be halved sixteen times.
pub const UNITS_PER_CELL: u32 = 1 << 16;

/// A position on the lattice, in units from the view box's lowest corner.
pub type LatticePoint = [u32; 3];

/// The lattice over a view box.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    min: Vec3,
    max: Vec3,
    units: [u32; 3],
    /// The world coordinates of all lattice positions between the faces of the box, along each axis. `None`
    /// if the positions are evenly spaced.
    planes: Option<Arc<[Vec<f32>; 3]>>,
}

impl Lattice {
    /// Creates the lattice of `cells` grid cells along each axis over the closed box `min` … `max`.
    /// [`crate::Division`] checks the arguments.
    pub(crate) fn new(min: Vec3, max: Vec3, cells: [u32; 3]) -> Self {
        Self {
            min,
            max,
            units: cells.map(|c| c * UNITS_PER_CELL),
            planes: None,
        }
    }

    /// Creates the lattice with a position at each of these world coordinates, which must ascend along each
    /// axis and be inside the box.
    pub(crate) fn of_planes(min: Vec3, max: Vec3, planes: Arc<[Vec<f32>; 3]>) -> Self {
        Self {
            min,
            max,
            units: planes.each_ref().map(|p| p.len() as u32 + 1),
            planes: Some(planes),
        }
    }

    /// Returns the lattice coordinate of the world coordinate `at` in a lattice of planes, or `None` if no
    /// plane has this coordinate.
    pub(crate) fn unit(&self, axis: usize, at: f32) -> Option<u32> {
        let planes = self.planes.as_ref()?;
        planes[axis]
            .binary_search_by(|plane| plane.total_cmp(&at))
            .ok()
            .map(|k| k as u32 + 1)
    }

    /// Returns the number of units along each axis.
    pub fn units(&self) -> [u32; 3] {
        self.units
    }

    /// Returns the world coordinate of the lattice coordinate `k` along `axis`. The first and the last
    /// lattice coordinate have exactly the coordinates of the box.
    pub fn coordinate(&self, axis: usize, k: u32) -> f32 {
        let (lo, hi) = (self.min[axis], self.max[axis]);
        if k == 0 {
            lo
        } else if k >= self.units[axis] {
            hi
        } else if let Some(planes) = &self.planes {
            planes[axis][k as usize - 1]
        } else {
            let t = f64::from(k) / f64::from(self.units[axis]);
            (f64::from(lo) + (f64::from(hi) - f64::from(lo)) * t) as f32
        }
    }

    /// Returns the world position of a lattice point.
    pub fn position(&self, p: LatticePoint) -> Vec3 {
        Vec3::new(
            self.coordinate(0, p[0]),
            self.coordinate(1, p[1]),
            self.coordinate(2, p[2]),
        )
    }

    /// Returns the world length of `units` lattice units along `axis`, for an evenly spaced lattice.
    pub fn length(&self, axis: usize, units: u32) -> f64 {
        (f64::from(self.max[axis]) - f64::from(self.min[axis])) * f64::from(units)
            / f64::from(self.units[axis])
    }
}
