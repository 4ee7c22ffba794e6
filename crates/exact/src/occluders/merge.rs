//! The merging of coplanar neighbours into convex faces.

use std::cmp::Ordering;

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::proof::OccluderTriangle;
use sightline_geometry::predicates::{orient2d_sign, orient3d_sign};
use sightline_numbers::union_find::UnionFind;

use super::occluder::{Occluder, OccluderId, border};

/// The maximum number of edges in the border of a merged occluder.
const MOST_EDGES: usize = 24;

/// The convex faces during merging. A face's border has the orientation of its first triangle.
pub struct MergedFaces<'a> {
    triangles: &'a [[Vec3; 3]],
    corners: &'a [u32],
    /// The sets of triangles that form a face, by union-find.
    sets: UnionFind,
    /// The face of each set of triangles, at the index of the set's root; `None` at other indices and for
    /// triangles that do not block.
    faces: Vec<Option<Face>>,
    /// The pairs of coplanar triangles that share an edge.
    pairs: Vec<(u32, u32)>,
}

#[derive(Clone)]
struct Face {
    triangles: Vec<OccluderTriangle>,
    /// The directed boundary edges, each with its corner numbers and positions.
    border: Vec<FaceEdge>,
    /// The coordinate axis, 0 to 2, along which the face is projected to a plane.
    axis: usize,
    /// True if the border runs clockwise in the projection.
    mirrored: bool,
}

#[derive(Clone, Copy)]
struct FaceEdge {
    from: u32,
    to: u32,
    ends: [Vec3; 2],
}

impl<'a> MergedFaces<'a> {
    /// Creates one face per blocking triangle. `corners` contains three corner numbers per triangle, and
    /// `solid` is true for triangles that block.
    pub fn new(triangles: &'a [[Vec3; 3]], corners: &'a [u32], solid: &[bool]) -> Self {
        let n = triangles.len();
        let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * n);
        for (id, c) in corners
            .chunks_exact(3)
            .enumerate()
            .filter(|(id, _)| solid[*id])
        {
            for k in 0..3 {
                let (a, b) = (c[k], c[(k + 1) % 3]);
                edges.push((a.min(b), a.max(b), id as u32));
            }
        }
        edges.par_sort_unstable();
        let flat = |(s, t): &(u32, u32)| {
            let v = triangles[*s as usize];
            triangles[*t as usize]
                .iter()
                .all(|p| orient3d_sign(v[0], v[1], v[2], *p) == Ordering::Equal)
        };
        let pairs = edges
            .par_windows(2)
            .filter(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1))
            .map(|pair| (pair[0].2, pair[1].2))
            .filter(flat)
            .collect();
        let faces = (0..n)
            .into_par_iter()
            .map(|id| {
                solid[id].then(|| {
                    Face::from_triangle(id as u32, &triangles[id], &corners[3 * id..3 * id + 3])
                })
            })
            .collect();
        Self {
            triangles,
            corners,
            sets: UnionFind::new(n),
            faces,
            pairs,
        }
    }

    /// Merges coplanar neighbouring faces until no union of two neighbours is convex.
    pub fn merge(&mut self) {
        let mut pairs = std::mem::take(&mut self.pairs);
        loop {
            let before = pairs.len();
            let mut joined = false;
            pairs.retain(|(s, t)| {
                let (a, b) = (self.sets.root(*s), self.sets.root(*t));
                if a == b {
                    return false;
                }
                let (lo, hi) = (a.min(b), a.max(b));
                let (Some(x), Some(y)) = (&self.faces[lo as usize], &self.faces[hi as usize])
                else {
                    return false;
                };
                match x.joined(y, self.triangles) {
                    Some(face) => {
                        self.faces[lo as usize] = Some(face);
                        self.faces[hi as usize] = None;
                        self.sets.join(lo, hi);
                        joined = true;
                        false
                    }
                    None => true,
                }
            });
            if !joined || pairs.len() == before {
                return;
            }
        }
    }

    /// Returns the faces as occluders, and the occluder of each triangle; `None` for triangles that do not
    /// block.
    pub fn finish(mut self) -> (Vec<Occluder>, Vec<Option<OccluderId>>) {
        let n = self.triangles.len();
        let roots: Vec<u32> = (0..n as u32).map(|i| self.sets.root(i)).collect();
        let mut number = vec![None; n];
        let mut kept = Vec::new();
        for (id, face) in self.faces.iter().enumerate() {
            if let Some(face) = face {
                number[id] = Some(OccluderId(kept.len() as u32));
                kept.push(face);
            }
        }
        let occluders = kept
            .par_iter()
            .map(|face| face.occluder(self.triangles, self.corners))
            .collect();
        let occluder_ids = roots.iter().map(|r| number[*r as usize]).collect();
        (occluders, occluder_ids)
    }
}

impl Face {
    fn from_triangle(id: u32, v: &[Vec3; 3], c: &[u32]) -> Self {
        let border = (0..3)
            .map(|k| FaceEdge {
                from: c[k],
                to: c[(k + 1) % 3],
                ends: [v[k], v[(k + 1) % 3]],
            })
            .collect();
        // A triangle with area has area in at least one projection along an axis; the choice is exact.
        let turn =
            |axis: usize| orient2d_sign(flat(v[0], axis), flat(v[1], axis), flat(v[2], axis));
        let axis = (0..3).find(|k| turn(*k) != Ordering::Equal).unwrap_or(0);
        Self {
            triangles: vec![OccluderTriangle {
                triangle: id,
                reversed: false,
            }],
            border,
            axis,
            mirrored: turn(axis) == Ordering::Less,
        }
    }

    /// Returns the union of two faces, or `None` if the union is not convex or has more than [`MOST_EDGES`]
    /// edges.
    fn joined(&self, other: &Self, triangles: &[[Vec3; 3]]) -> Option<Self> {
        if self.border.len() + other.border.len() > MOST_EDGES + 2 {
            return None;
        }
        // Reverse the other border if needed, so that both borders have the same orientation in the
        // projection.
        let OccluderTriangle { triangle, reversed } = other.triangles[0];
        let v = &triangles[triangle as usize];
        let clockwise = orient2d_sign(
            flat(v[0], self.axis),
            flat(v[1], self.axis),
            flat(v[2], self.axis),
        ) == Ordering::Less;
        let flip = (clockwise != reversed) != self.mirrored;
        let mut border = self.border.clone();
        for e in &other.border {
            let e = if flip {
                FaceEdge {
                    from: e.to,
                    to: e.from,
                    ends: [e.ends[1], e.ends[0]],
                }
            } else {
                *e
            };
            match border.iter().position(|f| f.from == e.to && f.to == e.from) {
                Some(i) => {
                    border.remove(i);
                }
                None => border.push(e),
            }
        }
        if border.len() < 3 || border.len() == self.border.len() + other.border.len() {
            return None;
        }
        // The border must be one loop, with every turn to the left or straight on.
        let mut at = 0;
        for step in 1..=border.len() {
            let mut next = border
                .iter()
                .enumerate()
                .filter(|(_, e)| e.from == border[at].to);
            let (Some((i, e)), None) = (next.next(), next.next()) else {
                return None;
            };
            let ([a, b], c) = (border[at].ends, e.ends[1]);
            let turn = orient2d_sign(flat(a, self.axis), flat(b, self.axis), flat(c, self.axis));
            let right = if self.mirrored {
                Ordering::Greater
            } else {
                Ordering::Less
            };
            if turn == right {
                return None;
            }
            at = i;
            if (at == 0) != (step == border.len()) {
                return None;
            }
        }
        // A loop with only left turns may go around twice, so no corner may be to the right of any edge.
        let right = if self.mirrored {
            Ordering::Greater
        } else {
            Ordering::Less
        };
        let outside = |e: &FaceEdge, p: Vec3| {
            orient2d_sign(
                flat(e.ends[0], self.axis),
                flat(e.ends[1], self.axis),
                flat(p, self.axis),
            ) == right
        };
        if border
            .iter()
            .any(|e| border.iter().any(|f| outside(e, f.ends[0])))
        {
            return None;
        }
        let mut all = self.triangles.clone();
        all.extend(other.triangles.iter().map(|t| OccluderTriangle {
            reversed: t.reversed != flip,
            ..*t
        }));
        Some(Self {
            triangles: all,
            border,
            axis: self.axis,
            mirrored: self.mirrored,
        })
    }

    /// Converts the face to an occluder, with its border in the order of its triangles.
    fn occluder(&self, triangles: &[[Vec3; 3]], corners: &[u32]) -> Occluder {
        let mut members = self.triangles.clone();
        members.sort_unstable();
        let (edges, border) = border(&members, triangles, corners);
        Occluder {
            triangles: members,
            border,
            edges,
        }
    }
}

fn flat(p: Vec3, axis: usize) -> [f32; 2] {
    [p[(axis + 1) % 3], p[(axis + 2) % 3]]
}
