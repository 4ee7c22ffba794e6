//! Closed surfaces: triangles that are hidden without a query.
//!
//! Take a connected set of triangles, connected by shared edges. If every edge has an even number of them,
//! the set encloses a volume: the parity of the number of crossings along a path says whether the path goes
//! from outside to inside, and depends on the two ends only (the boundary of a boundary is empty, modulo 2).
//! If a view cell that the surface does not meet has one parity, and the side of a triangle that faces the
//! cell has the other, then every segment from the cell to the interior of that triangle crosses the surface
//! earlier: the triangle is hidden. This holds for the back of every solid and for the inside of a wall.
//!
//! Real surfaces have holes. Edges with an odd number of triangles are closed by *patches*: a fan from one
//! corner for each connected set of such edges. The argument then holds for segments that miss the patches,
//! and so for all segments if no patch meets the convex hull of cell and triangle.
//! [`sightline_certificate::checker`] decides all this again from the triangles alone.

use std::cmp::Ordering;

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::certificate::few_odd_edges;
use sightline_geometry::predicates::orient3d_sign;
use sightline_geometry::predicates::{Crossing, crossing};
use sightline_numbers::union_find::UnionFind;

use super::crossing_order::sooner;
use super::patches::cover;
use super::piercing::may_pierce;
use crate::arithmetic::random::Random;
use crate::geometry::Cell;
use crate::occluders::Occluders;

/// Segments tried to find a parity; most first ones are in general position.
const TRIES: u32 = 6;

/// The closed surfaces of a scene.
pub struct Surfaces {
    /// For each triangle, its surface and the parity on the side of its normal; none where the parity was not
    /// found, or is undefined because other triangles of the surface pass through the triangle.
    sides: Vec<Option<(u32, bool)>>,
    /// For each triangle, its closed surface, if it has one.
    of: Vec<Option<u32>>,
    surfaces: Vec<ClosedSurface>,
}

struct ClosedSurface {
    min: Vec3,
    max: Vec3,
    patches: Vec<[Vec3; 3]>,
}

/// The parities of one view cell.
pub struct FromCell<'a> {
    surfaces: &'a Surfaces,
    scene: &'a Occluders,
    cell: Cell,
    /// The parity of the cell by surface; none if the surface meets the cell or no parity was found.
    parity: Vec<Option<bool>>,
}

/// From which part of a cell a surface hides one of its triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hides {
    /// No part, as far as known.
    Nothing,
    /// The part on this side of the triangle's plane.
    From(Ordering),
    /// The whole cell.
    All,
}

impl Surfaces {
    /// Finds the surfaces of a scene.
    pub fn new(scene: &Occluders) -> Self {
        let n = scene.len();
        let solid = |t: u32| scene.of(t).is_some();
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
        // Odd edges by the surface they belong to.
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
            of: surface_ids,
            surfaces,
        };
        all.sides = (0..n as u32)
            .into_par_iter()
            .map_init(Vec::new, |scratch, t| {
                let s = all.of[t as usize]?;
                if all.is_pierced(scene, s, t, scratch) {
                    return None;
                }
                Some((s, all.front(scene, s, t, scratch)?))
            })
            .collect();
        all
    }

    /// Whether other triangles of the surface may have points inside a triangle.
    fn is_pierced(&self, scene: &Occluders, s: u32, t: u32, near: &mut Vec<u32>) -> bool {
        let v = *scene.triangle(t);
        near.clear();
        scene
            .hierarchy()
            .in_box(v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]), near);
        near.iter().any(|u| {
            *u != t
                && self.of[*u as usize] == Some(s)
                && may_pierce(&v, scene.triangle(*u), scene.corners(t), scene.corners(*u))
        })
    }

    /// The parity on the side a triangle's normal points to.
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
            if let Some(odd) = self.crossings(scene, s, (from, to), Some(t), &before, near) {
                return Some(odd == (orient3d_sign(a, b, c, from) == Ordering::Greater));
            }
        }
        None
    }

    /// A point outside of the surface and its patches, nearly along an axis from a point.
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

    /// Whether the segment crosses an odd number of the triangles and patches for which `counts` is true;
    /// none where it only touches one, or where `counts` is none.
    fn crossings(
        &self,
        scene: &Occluders,
        s: u32,
        (p, q): (Vec3, Vec3),
        without: Option<u32>,
        counts: &dyn Fn(&[Vec3; 3]) -> Option<bool>,
        near: &mut Vec<u32>,
    ) -> Option<bool> {
        near.clear();
        let size = f64::from(p.abs().max(q.abs()).max_element());
        scene.along(p.as_dvec3(), q.as_dvec3(), size, near);
        let own = near
            .iter()
            .filter(|u| self.of[**u as usize] == Some(s) && Some(**u) != without);
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

    /// The parities of a cell. `meeting` holds the triangles that meet the cell.
    pub fn seen_from<'a>(
        &'a self,
        scene: &'a Occluders,
        cell: Cell,
        meeting: &[u32],
    ) -> FromCell<'a> {
        let mut met = vec![false; self.surfaces.len()];
        meeting
            .iter()
            .filter_map(|t| self.of[*t as usize])
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
                        self.crossings(
                            scene,
                            s,
                            (middle, to),
                            None,
                            &|_| Some(true),
                            &mut Vec::new(),
                        )
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
    /// From which part of the cell a triangle that does not meet the cell is hidden by its surface.
    pub fn hides(&self, t: u32) -> Hides {
        let Some((s, front)) = self.surfaces.sides[t as usize] else {
            return Hides::Nothing;
        };
        let Some(cell) = self.parity[s as usize] else {
            return Hides::Nothing;
        };
        // The side it is hidden from: the one with the other parity.
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
            return Hides::Nothing;
        }
        if sides.contains(&hidden.reverse()) {
            Hides::From(hidden)
        } else {
            Hides::All
        }
    }

    /// Whether an axis, the patch's plane or the triangle's plane separates a patch from the convex hull of
    /// the cell and a triangle.
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
        let side = |of: &[Vec3; 3], p: &Vec3| orient3d_sign(of[0], of[1], of[2], *p);
        let first = side(patch, &cell[0]);
        if first != Ordering::Equal && cell.iter().chain(t).all(|p| side(patch, p) == first) {
            return true;
        }
        // The triangle's plane: all of the cell on one side or on it, all of the patch strictly on the other.
        let beyond = side(t, &patch[0]);
        beyond != Ordering::Equal
            && patch.iter().all(|p| side(t, p) == beyond)
            && cell.iter().all(|p| side(t, p) != beyond)
    }
}
