//! View cells as boxes on the lattice, and the planes that split them.

use glam::Vec3;

use crate::{Lattice, LatticePoint, Rect};

/// Returns the name in messages of the axis 0 = x, 1 = y or 2 = z.
pub fn axis_name(axis: usize) -> &'static str {
    ["x", "y", "z"].get(axis).copied().unwrap_or("no axis")
}

/// A closed box on the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CellBox {
    /// The lowest corner, in lattice units.
    pub lo: LatticePoint,
    /// The highest corner, in lattice units.
    pub hi: LatticePoint,
}

/// A splitting plane, perpendicular to `axis` at lattice coordinate `at`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Split {
    /// The axis that the plane is perpendicular to: 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// The lattice coordinate of the plane.
    pub at: u32,
}

impl CellBox {
    /// Returns the corners in world space (min, max).
    pub fn world(&self, lattice: &Lattice) -> (Vec3, Vec3) {
        (lattice.position(self.lo), lattice.position(self.hi))
    }

    /// Returns the two children: the box below the plane and the box above it.
    pub fn children(&self, split: Split) -> [Self; 2] {
        let (mut below, mut above) = (*self, *self);
        below.hi[split.axis] = split.at;
        above.lo[split.axis] = split.at;
        [below, above]
    }

    /// Returns the rectangle in which the plane `split` cuts the box.
    pub fn cut(&self, split: Split) -> Rect {
        let (u, v) = Rect::in_plane_axes(split.axis);
        Rect {
            axis: split.axis,
            at: split.at,
            lo: [self.lo[u], self.lo[v]],
            hi: [self.hi[u], self.hi[v]],
        }
    }

    /// Returns face `f` (0 to 5) of the box as a rectangle. The face is perpendicular to the axis `f / 2`, on
    /// the upper side of the box if `f` is even (the numbering of cube faces).
    pub fn face(&self, f: usize) -> Rect {
        let axis = f / 2;
        let at = if f.is_multiple_of(2) {
            self.hi[axis]
        } else {
            self.lo[axis]
        };
        self.cut(Split { axis, at })
    }

    /// Returns true if the lattice point `p` lies in the closed box.
    pub fn contains(&self, p: LatticePoint) -> bool {
        (0..3).all(|a| self.lo[a] <= p[a] && p[a] <= self.hi[a])
    }

    /// Counts the octants around `p` (0 to 8) into which the box extends. The result is 0 if `p` is outside,
    /// 8 inside, 4 in a face, 2 on an edge, and 1 at a corner (Nirenstein 2003, section 4.2.2, "Removing
    /// redundant samples").
    pub fn octants(&self, p: LatticePoint) -> u8 {
        if !self.contains(p) {
            return 0;
        }
        (0..3).fold(8, |n, a| {
            if p[a] == self.lo[a] || p[a] == self.hi[a] {
                n / 2
            } else {
                n
            }
        })
    }

    /// Returns true if `p` lies on the surface of the box.
    pub fn on_surface(&self, p: LatticePoint) -> bool {
        matches!(self.octants(p), 1 | 2 | 4)
    }
}
