//! Closed surfaces: triangles that are hidden without a query.
//!
//! Take a set of triangles that are connected by shared edges. If every edge has an even number of triangles,
//! the set encloses a volume. The parity of the number of crossings along a path then shows if the path goes
//! from outside to inside. The parity depends only on the two ends of the path (the boundary of a boundary is
//! empty, modulo 2). Suppose that a view cell that the surface does not meet has one parity, and that the
//! side of a triangle towards the cell has the other. Then every segment from the cell to the interior of
//! that triangle crosses the surface earlier, so the triangle is hidden. This holds for the back of every
//! solid and for the inside of a wall.
//!
//! Real surfaces have holes. *Patches* close the edges with an odd number of triangles: a fan from one corner
//! for each connected set of such edges. The argument then holds for segments that miss the patches, and so
//! for all segments if no patch meets the convex hull of cell and triangle.
//! [`sightline_certificate::checker`] repeats all these decisions from only the triangles.

use std::cmp::Ordering;

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::certificate::few_odd_edges;
use sightline_geometry::predicates::orient3d_sign;
use sightline_geometry::predicates::{Crossing, crossing};
use sightline_numbers::union_find::UnionFind;
use sightline_scene::TriangleId;

use super::crossing_order::sooner;
use super::patches::cover;
use super::piercing::may_pierce;
use crate::arithmetic::random::Random;
use crate::geometry::Cell;
use crate::occluders::Occluders;

/// The maximum number of segments tried to determine a parity. For most parities, the first segment is in
/// general position and determines it.
const TRIES: u32 = 6;

/// The closed surfaces of a scene.
pub struct Surfaces {
    /// For each triangle, the index of its surface, and the parity on the side to which the triangle's normal
    /// points: true for inside.
    ///
    /// The value is `None` if the parity was not determined, or is undefined because other triangles of the
    /// surface pass through the triangle.
    sides: Vec<Option<(u32, bool)>>,
    /// For each triangle, the index of its closed surface; `None` if the triangle is in no closed surface.
    by_triangle: Vec<Option<u32>>,
    surfaces: Vec<ClosedSurface>,
}

/// The bounding box of a closed surface's triangles, and the patches that close the surface.
struct ClosedSurface {
    min: Vec3,
    max: Vec3,
    patches: Vec<[Vec3; 3]>,
}

/// The parities of one view cell, one for each closed surface.
pub struct FromCell<'a> {
    surfaces: &'a Surfaces,
    scene: &'a Occluders,
    cell: Cell,
    /// For each surface, the parity of the cell: true if the cell is inside the surface.
    ///
    /// The value is `None` if the surface meets the cell or no parity was determined.
    parity: Vec<Option<bool>>,
}

/// The part of a cell from which a closed surface hides a triangle of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HiddenFrom {
    /// No part: the surface is not known to hide the triangle.
    Nothing,
    /// The part of the cell on this side of the triangle's plane.
    From(Ordering),
    /// The whole cell.
    All,
}

impl Surfaces {
    /// Computes the closed surfaces of a scene.
    pub fn new(scene: &Occluders) -> Self {
        let n = scene.len();
        let solid = |t: u32| scene.occluder_id(TriangleId(t)).is_some();
        let mut edges: Vec<([u32; 2], u32)> = Vec::new();
        for t in (0..n as u32).filter(|t| solid(*t)) {
            let c = scene.corners(t);
            edges.extend(
                [(0, 1), (1, 2), (2, 0)].map(|(i, j)| ([c[i].min(c[j]), c[i].max(c[j])], t)),
            );
        }
        edges.par_sort_unstable();
        let mut sets = UnionFind::new(n);
        for run in edges.chunk_by(|a, b| a.0 == b.0) {
            run.iter()
                .skip(1)
                .for_each(|(_, t)| sets.join(run[0].1, *t));
        }
        // The odd edges, by the surface that contains them.
        let mut odd: Vec<(u32, [u32; 2], [Vec3; 2])> = Vec::new();
        for run in edges
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|r| r.len() % 2 == 1)
        {
            let (edge, t) = run[0];
            let at = |corner: u32| {
                scene
                    .corners(t)
                    .iter()
                    .position(|c| *c == corner)
                    .unwrap_or(0)
            };
            let ends = edge.map(|c| scene.triangle(t)[at(c)]);
            odd.push((sets.root(t), edge, ends));
        }
        odd.sort_unstable_by_key(|o| (o.0, o.1));
        let mut usable = vec![true; n];
        let mut patches: Vec<(u32, Vec<[Vec3; 3]>)> = Vec::new();
        let mut members = vec![0usize; n];
        (0..n as u32)
            .filter(|t| solid(*t))
            .for_each(|t| members[sets.root(t) as usize] += 1);
        for run in odd.chunk_by(|a, b| a.0 == b.0) {
            if !few_odd_edges(run.len(), members[run[0].0 as usize]) {
                usable[run[0].0 as usize] = false;
            } else {
                patches.push((
                    run[0].0,
                    cover(&run.iter().map(|o| o.2).collect::<Vec<_>>()),
                ));
            }
        }
        let mut number = vec![None; n];
        let (mut surface_ids, mut surfaces) = (vec![None; n], Vec::<ClosedSurface>::new());
        for t in (0..n as u32).filter(|t| solid(*t)) {
            let root = sets.root(t);
            if !usable[root as usize] {
                continue;
            }
            let id = *number[root as usize].get_or_insert_with(|| {
                let at = patches.binary_search_by_key(&root, |p| p.0);
                let patches = at.map_or(Vec::new(), |at| std::mem::take(&mut patches[at].1));
                surfaces.push(ClosedSurface {
                    min: Vec3::INFINITY,
                    max: Vec3::NEG_INFINITY,
                    patches,
                });
                surfaces.len() as u32 - 1
            });
            let s = &mut surfaces[id as usize];
            for v in scene.triangle(t) {
                (s.min, s.max) = (s.min.min(*v), s.max.max(*v));
            }
            surface_ids[t as usize] = Some(id);
        }
        let mut all = Self {
            sides: Vec::new(),
            by_triangle: surface_ids,
            surfaces,
        };
        all.sides = (0..n as u32)
            .into_par_iter()
            .map_init(Vec::new, |scratch, t| {
                let s = all.by_triangle[t as usize]?;
                if all.is_pierced(scene, s, t, scratch) {
                    return None;
                }
                Some((s, all.front(scene, s, t, scratch)?))
            })
            .collect();
        all
    }

    /// Returns true if another triangle of surface `s` may have points in the interior of triangle `t`.
    fn is_pierced(&self, scene: &Occluders, s: u32, t: u32, near: &mut Vec<u32>) -> bool {
        let v = *scene.triangle(t);
        near.clear();
        scene
            .hierarchy()
            .in_box(v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]), near);
        near.iter().any(|u| {
            *u != t
                && self.by_triangle[*u as usize] == Some(s)
                && may_pierce(&v, scene.triangle(*u), scene.corners(t), scene.corners(*u))
        })
    }

    /// Computes the parity of surface `s` on the side to which the normal of triangle `t` points, or returns
    /// `None` if no tried segment determines the parity.
    fn front(&self, scene: &Occluders, s: u32, t: u32, near: &mut Vec<u32>) -> Option<bool> {
        let [a, b, c] = *scene.triangle(t);
        let mut random = Random::new(u64::from(s), u64::from(t));
        for _ in 0..TRIES {
            let (x, y) = (random.unit().sqrt() as f32, random.unit() as f32);
            let inside = a * (1.0 - x) + b * (x * (1.0 - y)) + c * (x * y);
            let from = self.outside(s, inside, &mut random);
            let to = inside + (inside - from) * 1e-3;
            if crossing([a, b, c], from, to) != Crossing::Inside {
                continue;
            }
            let before = |u: &[Vec3; 3]| match sooner(u, &[a, b, c], from, to) {
                Ordering::Less => Some(true),
                Ordering::Greater => Some(false),
                Ordering::Equal => None,
            };
            if let Some(odd) = self.crossings(scene, s, from, to, Some(t), &before, near) {
                return Some(odd == (orient3d_sign(a, b, c, from) == Ordering::Greater));
            }
        }
        None
    }

    /// Chooses a random point outside of the surface and its patches, nearly along an axis from the point
    /// `from`.
    fn outside(&self, s: u32, from: Vec3, random: &mut Random) -> Vec3 {
        let ClosedSurface { min, max, .. } = &self.surfaces[s as usize];
        let size = (*max - *min).max_element();
        let axis = (random.unit() * 3.0) as usize;
        let mut jitter = || ((random.unit() - 0.5) * 0.02) as f32 * size;
        let mut to = from + Vec3::new(jitter(), jitter(), jitter());
        let past = size * 0.1 + f32::MIN_POSITIVE;
        let up = max[axis] - from[axis] < from[axis] - min[axis];
        to[axis] = if up {
            max[axis] + past
        } else {
            min[axis] - past
        };
        to
    }

    /// Returns true if the segment from `p` to `q` crosses an odd number of triangles and patches of surface
    /// `s`. The triangle `without` does not count.
    ///
    /// Another triangle or patch counts if `counts` returns true for it. The result is `None` if the segment
    /// touches the border of a triangle or patch, or if `counts` returns `None`.
    fn crossings(
        &self,
        scene: &Occluders,
        s: u32,
        p: Vec3,
        q: Vec3,
        without: Option<u32>,
        counts: &dyn Fn(&[Vec3; 3]) -> Option<bool>,
        near: &mut Vec<u32>,
    ) -> Option<bool> {
        near.clear();
        let size = f64::from(p.abs().max(q.abs()).max_element());
        scene.along(p.as_dvec3(), q.as_dvec3(), size, near);
        let own = near
            .iter()
            .filter(|u| self.by_triangle[**u as usize] == Some(s) && Some(**u) != without);
        let mut odd = false;
        for u in own
            .map(|u| scene.triangle(*u))
            .chain(&self.surfaces[s as usize].patches)
        {
            odd ^= match crossing(*u, p, q) {
                Crossing::Not => false,
                Crossing::Touches => return None,
                Crossing::Inside => counts(u)?,
            };
        }
        Some(odd)
    }

    /// Computes the parity of a cell for each surface. `meeting` contains the blocking triangles that meet
    /// the cell.
    pub fn seen_from<'a>(
        &'a self,
        scene: &'a Occluders,
        cell: Cell,
        meeting: &[u32],
    ) -> FromCell<'a> {
        let mut met = vec![false; self.surfaces.len()];
        meeting
            .iter()
            .filter_map(|t| self.by_triangle[*t as usize])
            .for_each(|s| met[s as usize] = true);
        let [min, max] = cell.corners();
        let middle = (min * 0.5 + max * 0.5).clamp(min, max);
        let parity = (0..self.surfaces.len() as u32)
            .map(|s| {
                let ClosedSurface { min, max, .. } = &self.surfaces[s as usize];
                if met[s as usize] {
                    return None;
                }
                if middle.cmplt(*min).any() || middle.cmpgt(*max).any() {
                    return Some(false);
                }
                let mut random = Random::new(u64::from(s), 0);
                (0..TRIES).find_map(|_| {
                    let to = self.outside(s, middle, &mut random);
                    let out = to.cmplt(*min).any() || to.cmpgt(*max).any();
                    let odd = || {
                        self.crossings(scene, s, middle, to, None, &|_| Some(true), &mut Vec::new())
                    };
                    out.then(odd).flatten()
                })
            })
            .collect();
        FromCell {
            surfaces: self,
            scene,
            cell,
            parity,
        }
    }
}

impl FromCell<'_> {
    /// Returns the part of the cell from which the surface of triangle `t` hides this triangle. The triangle
    /// must not meet the cell.
    pub fn hides(&self, t: u32) -> HiddenFrom {
        let Some((s, front)) = self.surfaces.sides[t as usize] else {
            return HiddenFrom::Nothing;
        };
        let Some(cell) = self.parity[s as usize] else {
            return HiddenFrom::Nothing;
        };
        // The hidden side of the triangle is the side with the other parity.
        let hidden = if cell == front {
            Ordering::Less
        } else {
            Ordering::Greater
        };
        let v = self.scene.triangle(t);
        let sides = self
            .cell
            .all_corners()
            .map(|p| orient3d_sign(v[0], v[1], v[2], p));
        if !sides.contains(&hidden)
            || !self.surfaces.surfaces[s as usize]
                .patches
                .iter()
                .all(|p| self.apart(v, p))
        {
            return HiddenFrom::Nothing;
        }
        if sides.contains(&hidden.reverse()) {
            HiddenFrom::From(hidden)
        } else {
            HiddenFrom::All
        }
    }

    /// Returns true if a plane separates a patch from the convex hull of the cell and a triangle.
    ///
    /// The tested planes are planes perpendicular to the axes, the patch's plane and the triangle's plane.
    fn apart(&self, t: &[Vec3; 3], patch: &[Vec3; 3]) -> bool {
        let [lo, hi] = self.cell.corners();
        let (min, max) = t.iter().fold((lo, hi), |(a, b), v| (a.min(*v), b.max(*v)));
        if patch.iter().all(|p| p.x < min.x)
            || patch.iter().all(|p| p.x > max.x)
            || patch.iter().all(|p| p.y < min.y)
            || patch.iter().all(|p| p.y > max.y)
            || patch.iter().all(|p| p.z < min.z)
            || patch.iter().all(|p| p.z > max.z)
        {
            return true;
        }
        let cell = self.cell.all_corners();
        let side = |t: &[Vec3; 3], p: &Vec3| orient3d_sign(t[0], t[1], t[2], *p);
        let first = side(patch, &cell[0]);
        if first != Ordering::Equal && cell.iter().chain(t).all(|p| side(patch, p) == first) {
            return true;
        }
        // The triangle's plane separates if all of the cell is on one side or on the plane, and all of the
        // patch is strictly on the other side.
        let beyond = side(t, &patch[0]);
        beyond != Ordering::Equal
            && patch.iter().all(|p| side(t, p) == beyond)
            && cell.iter().all(|p| side(t, p) != beyond)
    }
}
