//! Closed surfaces: what they hide without a query.
//!
//! Take the triangles that hang together by their edges. Where every edge has an even number of them they enclose
//! something: going from place to place, the parity of the number of crossings says whether one is inside or outside, and
//! depends on the two places alone (the boundary of a boundary is nothing, mod 2). So if a view cell that the surface does not
//! meet has one parity, and the side of a triangle turned to it the other, then every segment from the cell to the inside of
//! that triangle crosses the surface before: the triangle is hidden. That is so of the back of every solid, of the inside of a
//! wall, of all that faces away.
//!
//! Real surfaces have holes. Edges with an odd number of triangles are closed by *patches*, a fan from one corner for all
//! that hang together; the argument then holds for segments that miss the patches, and so for all if none of the patches meets the
//! convex hull of cell and triangle. [`crate::checker`] decides all this again from the scene alone.

use std::cmp::Ordering;

use glam::Vec3;
use rayon::prelude::*;
use sightline_numbers::union_find::UnionFind;
use sightline_scene::exact::{orient2d_sign, orient3d_sign};

use crate::cell::Cell;
use crate::evidence::few_odd_edges;
use crate::occluder::Occluders;
use crate::rays::Random;
use crate::segment::{Crossing, crossing};

/// Segments tried to learn a parity: most are in general position at once.
const TRIES: u32 = 6;

/// The surfaces of a scene that enclose something.
pub struct Surfaces {
    /// The surface a triangle is part of, and the parity on the side its normal points to; none where that is not known
    /// or makes no sense because other triangles of the surface pass through it.
    sides: Vec<Option<(u32, bool)>>,
    /// The surface a triangle is part of, if it is one of these.
    of: Vec<Option<u32>>,
    surfaces: Vec<Surface>,
}

struct Surface {
    min: Vec3,
    max: Vec3,
    patches: Vec<[Vec3; 3]>,
}

/// What the surfaces say from one view cell.
pub struct FromCell<'a> {
    surfaces: &'a Surfaces,
    scene: &'a Occluders,
    cell: Cell,
    /// The parity of the cell by surface; none for one that meets the cell, or not to be found out.
    parity: Vec<Option<bool>>,
}

/// What a surface hides of one of its triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hides {
    /// Nothing that is known.
    Nothing,
    /// What is seen of it from this side of its plane, on which part of the cell is.
    From(Ordering),
    /// All of it.
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
            edges.extend([(0, 1), (1, 2), (2, 0)].map(|(i, j)| ([c[i].min(c[j]), c[i].max(c[j])], t)));
        }
        edges.par_sort_unstable();
        let mut sets = UnionFind::new(n);
        for run in edges.chunk_by(|a, b| a.0 == b.0) {
            run.iter().skip(1).for_each(|(_, t)| sets.join(run[0].1, *t));
        }
        // Odd edges by the surface they belong to.
        let mut odd: Vec<(u32, [u32; 2], [Vec3; 2])> = Vec::new();
        for run in edges.chunk_by(|a, b| a.0 == b.0).filter(|r| r.len() % 2 == 1) {
            let (edge, t) = run[0];
            let at = |corner: u32| scene.corners(t).iter().position(|c| *c == corner).unwrap_or(0);
            let ends = edge.map(|c| scene.triangle(t)[at(c)]);
            odd.push((sets.root(t), edge, ends));
        }
        odd.sort_unstable_by_key(|o| (o.0, o.1));
        let mut usable = vec![true; n];
        let mut patches: Vec<(u32, Vec<[Vec3; 3]>)> = Vec::new();
        let mut members = vec![0usize; n];
        (0..n as u32).filter(|t| solid(*t)).for_each(|t| members[sets.root(t) as usize] += 1);
        for run in odd.chunk_by(|a, b| a.0 == b.0) {
            if !few_odd_edges(run.len(), members[run[0].0 as usize]) {
                usable[run[0].0 as usize] = false;
            } else {
                patches.push((run[0].0, cover(&run.iter().map(|o| o.2).collect::<Vec<_>>())));
            }
        }
        let mut number = vec![None; n];
        let (mut of, mut surfaces) = (vec![None; n], Vec::<Surface>::new());
        for t in (0..n as u32).filter(|t| solid(*t)) {
            let root = sets.root(t);
            if !usable[root as usize] {
                continue;
            }
            let id = *number[root as usize].get_or_insert_with(|| {
                let at = patches.binary_search_by_key(&root, |p| p.0);
                let patches = at.map_or(Vec::new(), |at| std::mem::take(&mut patches[at].1));
                surfaces.push(Surface { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY, patches });
                surfaces.len() as u32 - 1
            });
            let s = &mut surfaces[id as usize];
            for v in scene.triangle(t) {
                (s.min, s.max) = (s.min.min(*v), s.max.max(*v));
            }
            of[t as usize] = Some(id);
        }
        let mut all = Self { sides: Vec::new(), of, surfaces };
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
        scene.hierarchy().in_box(v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]), near);
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

    /// A point outside of all the surface and its patches, along an axis from some point, or nearly.
    fn outside(&self, s: u32, from: Vec3, random: &mut Random) -> Vec3 {
        let Surface { min, max, .. } = &self.surfaces[s as usize];
        let size = (*max - *min).max_element();
        let axis = (random.unit() * 3.0) as usize;
        let mut jitter = || ((random.unit() - 0.5) * 0.02) as f32 * size;
        let mut to = from + Vec3::new(jitter(), jitter(), jitter());
        let past = size * 0.1 + f32::MIN_POSITIVE;
        let up = max[axis] - from[axis] < from[axis] - min[axis];
        to[axis] = if up { max[axis] + past } else { min[axis] - past };
        to
    }

    /// Whether the segment crosses an odd number of triangles and patches, of those that `counts` does not leave out; none where it
    /// touches one that it does not pass through.
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
        let own = near.iter().filter(|u| self.of[**u as usize] == Some(s) && Some(**u) != without);
        let mut odd = false;
        for u in own.map(|u| scene.triangle(*u)).chain(&self.surfaces[s as usize].patches) {
            odd ^= match crossing(*u, p, q) {
                Crossing::Not => false,
                Crossing::Touches => return None,
                Crossing::Inside => counts(u)?,
            };
        }
        Some(odd)
    }

    /// What the surfaces say from a cell that the triangles `meeting` meet.
    pub fn seen_from<'a>(&'a self, scene: &'a Occluders, cell: Cell, meeting: &[u32]) -> FromCell<'a> {
        let mut met = vec![false; self.surfaces.len()];
        meeting.iter().filter_map(|t| self.of[*t as usize]).for_each(|s| met[s as usize] = true);
        let [min, max] = cell.corners();
        let middle = (min * 0.5 + max * 0.5).clamp(min, max);
        let parity = (0..self.surfaces.len() as u32)
            .map(|s| {
                let Surface { min, max, .. } = &self.surfaces[s as usize];
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
                    let odd =
                        || self.crossings(scene, s, (middle, to), None, &|_| Some(true), &mut Vec::new());
                    out.then(odd).flatten()
                })
            })
            .collect();
        FromCell { surfaces: self, scene, cell, parity }
    }
}

impl FromCell<'_> {
    /// Whether a triangle, which does not meet the cell, is hidden by the surface it is part of.
    pub fn hides(&self, t: u32) -> Hides {
        let Some((s, front)) = self.surfaces.sides[t as usize] else { return Hides::Nothing };
        let Some(cell) = self.parity[s as usize] else { return Hides::Nothing };
        // The side it is hidden from: the one with the other parity.
        let hidden = if cell == front { Ordering::Less } else { Ordering::Greater };
        let v = self.scene.triangle(t);
        let sides = self.cell.all_corners().map(|p| orient3d_sign(v[0], v[1], v[2], p));
        if !sides.contains(&hidden)
            || !self.surfaces.surfaces[s as usize].patches.iter().all(|p| self.apart(v, p))
        {
            return Hides::Nothing;
        }
        if sides.contains(&hidden.reverse()) { Hides::From(hidden) } else { Hides::All }
    }

    /// Whether a patch is seen to have no point in the convex hull of the cell and a triangle: some axis, the patch's plane or the
    /// triangle's separates them.
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

/// Patches that close some odd edges: for all that hang together, the triangles of one corner with each of them.
///
/// At every corner an even number of odd edges meet (each triangle has two edges there), so the other edges of the patches cancel.
pub fn cover(odd: &[[Vec3; 2]]) -> Vec<[Vec3; 3]> {
    // −0 is 0.
    let key = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut group: Vec<usize> = (0..odd.len()).collect();
    loop {
        let before = group.clone();
        for i in 0..odd.len() {
            for j in 0..i {
                if odd[i].iter().any(|p| odd[j].iter().any(|q| key(*p) == key(*q))) {
                    let least = group[i].min(group[j]);
                    (group[i], group[j]) = (least, least);
                }
            }
        }
        if group == before {
            break;
        }
    }
    let order = |v: Vec3| [v.x, v.y, v.z].map(f32::to_bits);
    (0..odd.len())
        .filter_map(|i| {
            let members = (0..odd.len()).filter(|j| group[*j] == group[i]);
            let corner = members.flat_map(|j| odd[j]).min_by_key(|v| order(*v + Vec3::ZERO))?;
            let [p, q] = odd[i];
            (key(p) != key(corner) && key(q) != key(corner)).then_some([corner, p, q])
        })
        .collect()
}

/// Which of two triangles a segment that passes through both crosses first.
fn sooner(u: &[Vec3; 3], t: &[Vec3; 3], from: Vec3, to: Vec3) -> Ordering {
    // At from + s(to − from) with s = a / (a + b), a and b the distances of the ends to the plane: s(u) < s(t) when a(u) b(t) < a(t) b(u).
    let heights = |of: &[Vec3; 3]| [from, to].map(|p| height(of, p));
    let ([(au, eau), (bu, ebu)], [(at, eat), (bt, ebt)]) = (heights(u), heights(t));
    let less = |x: (f64, f64), y: (f64, f64), z: (f64, f64), w: (f64, f64)| {
        // Products of what is at most and at least; a few roundings are far below 1e-15.
        (x.0 + x.1) * (y.0 + y.1) * (1.0 + 1e-15) < (z.0 - z.1).max(0.0) * (w.0 - w.1).max(0.0)
    };
    if less((au, eau), (bt, ebt), (at, eat), (bu, ebu)) {
        return Ordering::Less;
    }
    if less((at, eat), (bu, ebu), (au, eau), (bt, ebt)) {
        return Ordering::Greater;
    }
    let exact = |of: &[Vec3; 3]| {
        use crate::predicates::{height, plane};
        let point = |v: Vec3| crate::number::homogeneous(v.as_dvec3().to_array());
        let [a, b, c] = of.map(point);
        let flat = plane([&a, &b, &c]);
        // One scale for both ends: that of the other end's w.
        let (p, q) = (point(from), point(to));
        [height(&flat, &p) * &q[3], height(&flat, &q) * &p[3]]
    };
    let size =
        |x: &dashu_int::IBig| if crate::predicates::sign(x) == Ordering::Less { -x } else { x.clone() };
    let ([au, bu], [at, bt]) = (exact(u), exact(t));
    (size(&au) * size(&bt)).cmp(&(size(&at) * size(&bu)))
}

/// How far a point is from a triangle's plane, times twice the area, and by how much that may be off: the determinant and bound of
/// [`orient3d_sign`].
fn height(t: &[Vec3; 3], p: Vec3) -> (f64, f64) {
    let [a, x, y, z] = [t[0], t[1], t[2], p].map(|v| v.as_dvec3());
    let (x, y, z) = (x - a, y - a, z - a);
    let minor = |i: usize, j: usize| {
        let (l, r) = (x[i] * y[j], x[j] * y[i]);
        (l - r, l.abs() + r.abs())
    };
    let (mx, my, mz) = (minor(1, 2), minor(2, 0), minor(0, 1));
    let det = mx.0 * z.x + my.0 * z.y + mz.0 * z.z;
    let magnitude = mx.1 * z.x.abs() + my.1 * z.y.abs() + mz.1 * z.z.abs();
    (det.abs(), 8.0 * f64::EPSILON * magnitude)
}

/// Whether a triangle `u` may have a point inside `t`. Their corners are numbered alike where they are at the same place.
fn may_pierce(t: &[Vec3; 3], u: &[Vec3; 3], ct: [u32; 3], cu: [u32; 3]) -> bool {
    // A shared corner is in the plane, and to find that out by arithmetic is what takes longest.
    let place = |of: &[Vec3; 3], c: [u32; 3], (p, n): (Vec3, u32)| {
        if c.contains(&n) { Ordering::Equal } else { orient3d_sign(of[0], of[1], of[2], p) }
    };
    let sides = [0, 1, 2].map(|k| place(t, ct, (u[k], cu[k])));
    if sides[0] != Ordering::Equal && sides.iter().all(|s| *s == sides[0]) {
        return false;
    }
    if sides.iter().all(|s| *s == Ordering::Equal) {
        return overlap_in_plane(t, u);
    }
    let shared = cu.iter().filter(|c| ct.contains(c)).count();
    if shared >= 2 {
        // Two planes with an edge in common have that line in common and no other point.
        return false;
    }
    // What u has in t's plane is a segment: an end of it is inside t, or it comes in through an edge of t.
    let edges = [(0, 1), (1, 2), (2, 0)];
    let enters = edges.iter().any(|(i, j)| {
        let (a, b) = (u[*i], u[*j]);
        // A shared corner is on t's border; the rest of such an edge is off the plane, or is in it and judged by its other end.
        let apart = sides[*i] == sides[*j] && sides[*i] != Ordering::Equal;
        let at_corner = sides[*i] == Ordering::Equal && ct.contains(&cu[*i]) && sides[*j] != Ordering::Equal
            || sides[*j] == Ordering::Equal && ct.contains(&cu[*j]) && sides[*i] != Ordering::Equal;
        if sides[*i] == Ordering::Equal && sides[*j] == Ordering::Equal {
            return enters_in_plane(t, a, b);
        }
        !apart && !at_corner && crossing(*t, a, b) != Crossing::Not
    });
    enters
        || edges.iter().any(|(i, j)| {
            let ends = [i, j].map(|k| place(u, cu, (t[*k], ct[*k])));
            // Also where the edge lies in u's plane: then what u has in t's plane lies along the edge.
            let apart = ends[0] == ends[1];
            let at_corner = ends[0] == Ordering::Equal && cu.contains(&ct[*i]) && ends[1] != Ordering::Equal
                || ends[1] == Ordering::Equal && cu.contains(&ct[*j]) && ends[0] != Ordering::Equal;
            !apart && !at_corner && crossing(*u, t[*i], t[*j]) != Crossing::Not
        })
}

/// Whether two triangles in one plane have inner points in common: no line along an edge of one has the other on its outer side.
fn overlap_in_plane(t: &[Vec3; 3], u: &[Vec3; 3]) -> bool {
    // Projected along an axis the plane does not contain: one in which both keep their area.
    let turn = |k: usize, p: [Vec3; 3]| {
        let [a, b, c] = p.map(|v| [v[(k + 1) % 3], v[(k + 2) % 3]]);
        orient2d_sign(a, b, c)
    };
    let Some(axis) = (0..3).find(|k| turn(*k, *t) != Ordering::Equal) else { return true };
    let separated = |x: &[Vec3; 3], y: &[Vec3; 3]| {
        let inner = turn(axis, *x);
        [(0, 1), (1, 2), (2, 0)]
            .iter()
            .any(|(i, j)| y.iter().all(|p| turn(axis, [x[*i], x[*j], *p]) != inner))
    };
    !(separated(t, u) || separated(u, t))
}

/// Whether a segment in a triangle's plane has points inside the triangle: no line along an edge has it on its outer side, nor does
/// its own line have all of the triangle on one side.
fn enters_in_plane(t: &[Vec3; 3], a: Vec3, b: Vec3) -> bool {
    let turn = |k: usize, p: [Vec3; 3]| {
        let [a, b, c] = p.map(|v| [v[(k + 1) % 3], v[(k + 2) % 3]]);
        orient2d_sign(a, b, c)
    };
    let Some(axis) = (0..3).find(|k| turn(*k, *t) != Ordering::Equal) else { return true };
    let inner = turn(axis, *t);
    let outside = [(0, 1), (1, 2), (2, 0)]
        .iter()
        .any(|(i, j)| [a, b].iter().all(|p| turn(axis, [t[*i], t[*j], *p]) != inner));
    let along = t.map(|v| turn(axis, [a, b, v]));
    !outside && along.contains(&Ordering::Less) && along.contains(&Ordering::Greater)
}
