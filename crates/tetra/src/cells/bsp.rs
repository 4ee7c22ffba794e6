//! One tetrahedron, cut by the planes of the triangles that pass through its inside.
//!
//! A triangle goes down a tree of cuts in pieces: a cut divides a piece, or the piece lies in the cut and is
//! noted there, or it reaches a part that it passes through the inside of, which its plane then cuts. So no
//! part is cut that a triangle does not pass through. This is the tree of Fuchs, Kedem and Naylor, "On
//! Visible Surface Generation by A Priori Tree Structures", 1980, within one tetrahedron.

use super::local::Local;
use super::planes::NONE;
use super::polygon::{Corners, Polygon, Split, part, split};

/// A child with this bit is a part, its number in the bits below.
pub const LEAF: u32 = 1 << 31;

/// A cut.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    /// The number of its plane.
    pub plane: u32,
    /// What is in front of it and behind it: another cut, or [`LEAF`] and a part.
    pub children: [u32; 2],
    /// The cut that it is in a part of, and on which side (0 in front, 1 behind); `NONE` for the first.
    pub parent: (u32, u8),
}

/// A tetrahedron's cuts, and its parts in the order of the tree, front before back.
#[derive(Clone, Debug, Default)]
pub struct Cuts {
    /// The cuts; the first is the root.
    pub cuts: Vec<Cut>,
    /// Cuts and the triangles that lie in them, ascending.
    pub triangles: Vec<(u32, u32)>,
}

/// A triangle on its way into a tetrahedron, with numbers of planes of its own and through its edges.
#[derive(Clone, Copy)]
pub struct Cutter {
    /// Its id.
    pub id: u32,
    /// Its corners.
    pub corners: [u32; 3],
    /// The number of its plane.
    pub plane: u32,
    /// The numbers of the planes through the edges from each corner to the next.
    pub edges: [u32; 3],
}

impl Cutter {
    /// The triangle as a polygon.
    pub fn polygon(&self, local: &mut Local<'_>) -> Polygon {
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

    /// The planes through its edges, each with the side on which the triangle is.
    pub fn sides(&self, local: &mut Local<'_>) -> [(u32, i8); 3] {
        let c = self.corners;
        std::array::from_fn(|i| {
            let edge = local.plane(self.edges[i], &[c[i], c[(i + 1) % 3]]);
            let apart = local.point(c[(i + 2) % 3]);
            (edge, local.side(apart, edge))
        })
    }
}

impl Cuts {
    /// The number of parts.
    pub fn parts(&self) -> u32 {
        self.cuts.len() as u32 + 1
    }

    /// Cuts a tetrahedron by triangles in the given order. Triangles that do not pass through its inside do
    /// nothing.
    pub fn new(
        local: &mut Local<'_>,
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

    fn insert(&mut self, local: &mut Local<'_>, piece: Polygon, id: u32) {
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

    /// Numbers the parts: what is in front of a cut before what is behind it.
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

    /// The triangles that lie in a cut.
    pub fn triangles_in(&self, cut: u32) -> &[(u32, u32)] {
        let first = self.triangles.partition_point(|(c, _)| *c < cut);
        let count = self.triangles[first..].partition_point(|(c, _)| *c == cut);
        &self.triangles[first..first + count]
    }
}
