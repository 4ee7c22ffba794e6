//! Axis-aligned rectangles on the lattice: the faces of cells, which are sampled as quadtrees (Nirenstein
//! 2003, section 4.1.3).

use crate::{Lattice, LatticePoint, UNITS_PER_CELL};

/// A closed rectangle perpendicular to `axis`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rect {
    /// The axis that the rectangle is perpendicular to.
    pub axis: usize,
    /// The lattice coordinate of the rectangle along `axis`.
    pub at: u32,
    /// The lattice coordinates of the lowest corner along the two axes [`Rect::in_plane_axes`].
    pub lo: [u32; 2],
    /// The lattice coordinates of the highest corner along these two axes.
    pub hi: [u32; 2],
}

impl Rect {
    /// Returns the two axes in a plane perpendicular to `axis`, in cyclic order.
    pub fn in_plane_axes(axis: usize) -> (usize, usize) {
        ((axis + 1) % 3, (axis + 2) % 3)
    }

    /// Returns the lattice point at in-plane coordinates (u, v).
    pub fn point(&self, u: u32, v: u32) -> LatticePoint {
        let (au, av) = Self::in_plane_axes(self.axis);
        let mut p = [0; 3];
        p[self.axis] = self.at;
        p[au] = u;
        p[av] = v;
        p
    }

    /// Returns the four corners.
    pub fn corners(&self) -> [LatticePoint; 4] {
        [
            self.point(self.lo[0], self.lo[1]),
            self.point(self.hi[0], self.lo[1]),
            self.point(self.lo[0], self.hi[1]),
            self.point(self.hi[0], self.hi[1]),
        ]
    }

    /// Returns the lengths of the two sides in world units.
    pub fn sides(&self, lattice: &Lattice) -> [f64; 2] {
        let (u, v) = Self::in_plane_axes(self.axis);
        [
            lattice.length(u, self.hi[0] - self.lo[0]),
            lattice.length(v, self.hi[1] - self.lo[1]),
        ]
    }

    /// Returns true if the rectangle spans more than one cell of the grid along a side.
    pub fn spans_cells(&self) -> bool {
        (0..2).any(|i| self.hi[i] - self.lo[i] > UNITS_PER_CELL)
    }

    /// Returns the parts into which a quadtree splits this rectangle, or no parts if neither side can be
    /// halved.
    ///
    /// There are four parts, or two if one side is less than half as long as the other side, so that the
    /// parts of a long rectangle become square. Sides that span several grid cells are cut at a cell border.
    pub fn split(&self, lattice: &Lattice) -> Vec<Self> {
        let sides = self.sides(lattice);
        let longest = sides[0].max(sides[1]);
        let cut = |i: usize| -> Option<u32> {
            let span = self.hi[i] - self.lo[i];
            let several = span > UNITS_PER_CELL;
            // While one side still spans several cells, a side within one cell stays whole.
            if (self.spans_cells() && !several) || span < 2 {
                return None;
            }
            if !self.spans_cells() && sides[i] < 0.5 * longest {
                return None;
            }
            let half = if several {
                (span / UNITS_PER_CELL / 2).max(1) * UNITS_PER_CELL
            } else {
                span / 2
            };
            Some(self.lo[i] + half)
        };
        let ranges = |i: usize| match cut(i) {
            Some(m) => vec![(self.lo[i], m), (m, self.hi[i])],
            None => vec![(self.lo[i], self.hi[i])],
        };
        let (us, vs) = (ranges(0), ranges(1));
        if us.len() * vs.len() == 1 {
            return Vec::new();
        }
        vs.iter()
            .flat_map(|&(v0, v1)| us.iter().map(move |&(u0, u1)| (u0, u1, v0, v1)))
            .map(|(u0, u1, v0, v1)| Self {
                lo: [u0, v0],
                hi: [u1, v1],
                ..*self
            })
            .collect()
    }
}
