//! The cuts of one tetrahedron by the planes of the triangles that pass through its inside.
//!
//! The cuts form a tree, whose leaves are the parts of the tetrahedron. A triangle descends the tree in
//! pieces. A cut divides a piece, or the cut records the triangle of a piece that lies in the cut. A piece
//! that reaches a part and passes through the inside of the part adds a cut: the triangle's plane cuts the
//! part. So only triangles that pass through a part cut the part. This is the tree of Fuchs, Kedem and
//! Naylor, "On Visible Surface Generation by A Priori Tree Structures", 1980, within one tetrahedron.

use super::local::LocalGeometry;
use super::planes::NONE;
use super::polygon::{Corners, Polygon, Split, part, split};

/// Bit that marks a child of a cut as a part. The lower bits are the number of the part.
pub const LEAF: u32 = 1 << 31;

/// A cut of a tetrahedron by a plane.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    /// The global number of the plane.
    pub plane: u32,
    /// The children in front of the cut and behind the cut.
    ///
    /// A child is the index of another cut, or the number of a part with the bit [`LEAF`].
    pub children: [u32; 2],
    /// The index of the parent cut, and the side of the parent on which this cut is: 0 in front, 1 behind.
    ///
    /// The parent of the first cut is `NONE`.
    pub parent: (u32, u8),
}

/// The cuts of a tetrahedron. The numbers of parts follow the order of the tree, front before back.
#[derive(Clone, Debug, Default)]
pub struct Cuts {
    /// The cuts; the first is the root.
    pub cuts: Vec<Cut>,
    /// Pairs of the index of a cut and the id of a triangle that lies in the cut, ascending.
    pub triangles: Vec<(u32, u32)>,
}

/// A triangle that cuts tetrahedra, with the global numbers of its planes.
#[derive(Clone, Copy)]
pub struct Cutter {
    /// The id of the triangle.
    pub id: u32,
    /// The corners of the triangle, as point numbers.
    pub corners: [u32; 3],
    /// The number of the triangle's plane.
    pub plane: u32,
    /// The numbers of the planes through the edges from each corner to the next.
    pub edges: [u32; 3],
}

impl Cutter {
    /// Returns the triangle as a polygon with local numbers.
    pub fn polygon(&self, local: &mut LocalGeometry<'_>) -> Polygon {
        let plane = local.plane(self.plane, &self.corners);
        let c = self.corners;
        let loops = (0..3)
            .map(|i| {
                (
                    local.point(c[i]),
                    local.plane(self.edges[i], &[c[i], c[(i + 1) % 3]]),
                )
            })
            .collect();
        Polygon { plane, loops }
    }

    /// Returns the local numbers of the planes through the triangle's edges, each with the side on which the
    /// triangle is: 1 in front, −1 behind.
    pub fn sides(&self, local: &mut LocalGeometry<'_>) -> [(u32, i8); 3] {
        let c = self.corners;
        std::array::from_fn(|i| {
            let edge = local.plane(self.edges[i], &[c[i], c[(i + 1) % 3]]);
            let apart = local.point(c[(i + 2) % 3]);
            (edge, local.side(apart, edge))
        })
    }
}

impl Cuts {
    /// Returns the number of parts, which is the number of cuts plus one.
    pub fn parts(&self) -> u32 {
        self.cuts.len() as u32 + 1
    }

    /// Cuts a tetrahedron by triangles in the given order.
    ///
    /// Triangles that do not pass through the tetrahedron's inside add no cuts.
    pub fn new(
        local: &mut LocalGeometry<'_>,
        tetrahedron: Corners,
        cutters: impl Iterator<Item = Cutter>,
    ) -> Self {
        let mut tree = Self::default();
        let inner: [i8; 4] = std::array::from_fn(|k| {
            let corner = local.point(tetrahedron.points[k]);
            local.side(corner, tetrahedron.faces[k])
        });
        for cutter in cutters {
            let mut piece = Some(cutter.polygon(local));
            for (face, side) in tetrahedron.faces.into_iter().zip(inner) {
                piece = piece.and_then(|p| part(local, p, face, side));
            }
            if let Some(piece) = piece {
                tree.insert(local, piece, cutter.id);
            }
        }
        tree.number_parts();
        tree.triangles.sort_unstable();
        tree
    }

    fn insert(&mut self, local: &mut LocalGeometry<'_>, piece: Polygon, id: u32) {
        let plane = local.number(piece.plane);
        if self.cuts.is_empty() {
            self.cut(plane, (NONE, 0), id);
            return;
        }
        let mut todo = vec![(piece, 0u32)];
        while let Some((piece, at)) = todo.pop() {
            let by = local.plane(self.cuts[at as usize].plane, &[]);
            match split(local, piece, by) {
                Split::On => self.triangles.push((at, id)),
                Split::Parts(front, back) => {
                    for (side, piece) in [(1, back), (0, front)] {
                        let Some(piece) = piece else { continue };
                        match self.cuts[at as usize].children[usize::from(side)] {
                            NONE => {
                                let new = self.cut(plane, (at, side), id);
                                self.cuts[at as usize].children[usize::from(side)] = new;
                            }
                            child => todo.push((piece, child)),
                        }
                    }
                }
            }
        }
    }

    fn cut(&mut self, plane: u32, parent: (u32, u8), id: u32) -> u32 {
        let new = self.cuts.len() as u32;
        self.cuts.push(Cut {
            plane,
            children: [NONE; 2],
            parent,
        });
        self.triangles.push((new, id));
        new
    }

    /// Numbers the parts. Parts in front of a cut are numbered before parts behind the cut.
    fn number_parts(&mut self) {
        let mut parts = 0;
        let mut todo = if self.cuts.is_empty() {
            vec![]
        } else {
            vec![(0u32, 1u8), (0, 0)]
        };
        while let Some((at, side)) = todo.pop() {
            let child = &mut self.cuts[at as usize].children[usize::from(side)];
            if *child == NONE {
                *child = LEAF | parts;
                parts += 1;
            } else {
                let next = *child;
                todo.extend([(next, 1), (next, 0)]);
            }
        }
    }

    /// Returns the pairs of [`Self::triangles`] for the cut with this index.
    pub fn triangles_in(&self, cut: u32) -> &[(u32, u32)] {
        let first = self.triangles.partition_point(|(c, _)| *c < cut);
        let count = self.triangles[first..].partition_point(|(c, _)| *c == cut);
        &self.triangles[first..first + count]
    }
}
