//! The check that the closed surface of a triangle hides the triangle from a cell.
//!
//! # The argument
//!
//! Let S be a finite set of triangles such that every edge, as a pair of positions, belongs to an even number
//! of them. Then S is a cycle modulo 2. For a point off S, define its *parity* as the number of triangles
//! that a path from the point to infinity crosses, modulo 2, in general position. Two such paths form a
//! closed curve, and a closed curve crosses a cycle an even number of times, so the parity does not depend on
//! the path. A segment between two points crosses S an odd number of times if and only if their parities
//! differ.
//!
//! A real surface has holes. Its edges with an odd number of triangles form, modulo 2, a cycle of edges:
//! every vertex is the end of an even number of them. A fan of *patches* from one vertex of each connected
//! part has exactly these edges as its boundary, so the surface with its patches is closed. A segment that
//! meets no patch and whose ends have different parities crosses a triangle of the surface itself.
//!
//! A cell that no triangle of S and no patch meets has one parity. The two sides of a triangle that no other
//! triangle of S intersects have one parity each, and these differ. On the side whose parity differs from the
//! cell's parity, every segment from the cell to just before the triangle crosses S: the triangle is *hidden
//! from that side*.
//!
//! # Checks
//!
//! The following checks use only the scene, in integers:
//!
//! 1. The *surface* of a triangle is the set of triangles with area that are connected to it through edges
//!    with equal end positions. If it has few odd edges ([`few_odd_edges`]), patches close each connected
//!    part of these edges. A patch is a triangle from an edge to the lowest corner of the part, by the bits
//!    of its coordinates.
//! 2. No triangle of the surface meets the cell. The cell's parity is counted along a segment from its centre
//!    to a point outside the bounds of the surface. The segment touches no edge of a triangle or patch.
//! 3. No other triangle of the surface has a point inside this triangle. The parity of a side is counted
//!    along a segment that ends inside the triangle on that side.
//! 4. No patch has a point in the convex hull of cell and triangle: an axis-parallel plane, the patch's
//!    plane, or the triangle's plane separates them. So no patch meets the cell, the triangle, or a segment
//!    between them.
//!
//! If a fixed number of attempts finds no segment in general position, the checker rejects the claim.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::sync::OnceLock;

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_numbers::union_find::UnionFind;

use super::boxes::meets_box;
use super::geometry::{
    Plane, Point, cut, exact, has_area, height, join, klein, mixed, plane, point, sign,
};
use super::polygon::inside;
use super::tree::TriangleTree;
use crate::certificate::few_odd_edges;

/// The maximum number of segments tried to determine one parity, each in another direction.
const TRIES: u32 = 16;

/// The surfaces of a scene, and the parities of their triangles, computed on first use.
pub struct Surfaces {
    /// For each triangle, the index of its surface in `all`; `None` if it is in no closed surface.
    by_triangle: Vec<Option<u32>>,
    all: Vec<Surface>,
    /// For each triangle, the parity on the side that its normal points to, computed on first use.
    front: Vec<OnceLock<Option<bool>>>,
}

struct Surface {
    min: Vec3,
    max: Vec3,
    patches: Vec<[Vec3; 3]>,
}

/// Returns the bits of a position's coordinates, with −0 as 0.
fn key(v: Vec3) -> [u32; 3] {
    (v + Vec3::ZERO).to_array().map(f32::to_bits)
}

impl Surfaces {
    pub fn new(scene: &[[Vec3; 3]]) -> Self {
        let mut edges: Vec<([[u32; 3]; 2], u32)> = Vec::new();
        for (t, v) in scene.iter().enumerate().filter(|(_, v)| has_area(v)) {
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                let (p, q) = (key(v[i]), key(v[j]));
                edges.push(([p.min(q), p.max(q)], t as u32));
            }
        }
        edges.sort_unstable();
        let mut sets = UnionFind::new(scene.len());
        edges
            .windows(2)
            .filter(|w| w[0].0 == w[1].0)
            .for_each(|w| sets.join(w[0].1, w[1].1));
        let mut odd: BTreeMap<u32, Vec<[[u32; 3]; 2]>> = BTreeMap::new();
        for run in edges
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|r| r.len() % 2 == 1)
        {
            odd.entry(sets.root(run[0].1)).or_default().push(run[0].0);
        }
        let mut members: BTreeMap<u32, usize> = BTreeMap::new();
        for (t, _) in scene.iter().enumerate().filter(|(_, v)| has_area(v)) {
            *members.entry(sets.root(t as u32)).or_default() += 1;
        }
        let mut number: BTreeMap<u32, u32> = BTreeMap::new();
        let (mut surface_ids, mut all) = (vec![None; scene.len()], Vec::<Surface>::new());
        for (t, v) in scene.iter().enumerate().filter(|(_, v)| has_area(v)) {
            let root = sets.root(t as u32);
            let border = odd.get(&root).map_or(&[][..], |b| b);
            if !few_odd_edges(border.len(), members[&root]) {
                continue;
            }
            let id = *number.entry(root).or_insert_with(|| {
                all.push(Surface {
                    min: v[0],
                    max: v[0],
                    patches: patches(border),
                });
                all.len() as u32 - 1
            });
            let s = &mut all[id as usize];
            (s.min, s.max) = v
                .iter()
                .fold((s.min, s.max), |(a, b), p| (a.min(*p), b.max(*p)));
            surface_ids[t] = Some(id);
        }
        Self {
            by_triangle: surface_ids,
            all,
            front: vec![OnceLock::new(); scene.len()],
        }
    }

    /// Returns the number of surfaces.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Returns the side of a triangle's plane on which its surface hides the triangle from a cell. `parity`
    /// caches the parity of the cell for each surface. The error is the reason why the surface hides no side.
    pub fn hidden_side(
        &self,
        scene: &TriangleTree<'_>,
        cell: Aabb,
        parity: &[OnceLock<Option<bool>>],
        t: u32,
    ) -> Result<Ordering, &'static str> {
        let s = self.by_triangle[t as usize]
            .ok_or("the triangle does not belong to a closed surface")?;
        let of_cell = parity[s as usize]
            .get_or_init(|| self.parity_of(scene, s, cell))
            .ok_or("the triangle's surface meets the cell, or the parity of the cell cannot be decided")?;
        let front = self.front[t as usize]
            .get_or_init(|| self.parity_in_front(scene, s, t))
            .ok_or("the surface passes through the triangle, or the triangle's parity cannot be decided")?;
        let v = &scene.all()[t as usize];
        if !self.all[s as usize]
            .patches
            .iter()
            .all(|p| apart(cell, v, p))
        {
            return Err("a patch of the surface may be between the cell and the triangle");
        }
        Ok(if of_cell == front {
            Ordering::Less
        } else {
            Ordering::Greater
        })
    }

    /// Computes the parity of a cell for surface `s`. Returns `None` if the surface meets the cell or no
    /// tried segment is in general position.
    fn parity_of(&self, scene: &TriangleTree<'_>, s: u32, cell: Aabb) -> Option<bool> {
        let mut near = Vec::new();
        scene.in_box(cell, &mut near);
        let own = |u: &&u32| self.by_triangle[**u as usize] == Some(s);
        if near
            .iter()
            .filter(own)
            .any(|u| meets_box(&scene.all()[*u as usize], cell))
        {
            return None;
        }
        let middle = (cell.min.as_dvec3() + cell.max.as_dvec3()) * 0.5;
        let from = point(middle.to_array());
        (0..TRIES)
            .find_map(|k| self.parity(scene, s, &from, cell, self.outside(s, middle, k), None))
    }

    /// Computes the parity on the side of a triangle that its normal points to. Returns `None` if that side
    /// has more than one parity or the parity cannot be decided.
    fn parity_in_front(&self, scene: &TriangleTree<'_>, s: u32, t: u32) -> Option<bool> {
        let v = &scene.all()[t as usize];
        let bounds = Aabb::around(*v);
        let corners = exact(v);
        let flat = plane([&corners[0], &corners[1], &corners[2]]);
        let mut near = Vec::new();
        scene.in_box(bounds, &mut near);
        let pierces = |u: &&u32| **u != t && pierces(&corners, &flat, &scene.all()[**u as usize]);
        if near
            .iter()
            .filter(|u| self.by_triangle[**u as usize] == Some(s))
            .any(|u| pierces(&u))
        {
            return None;
        }
        (0..TRIES).find_map(|k| {
            // The point is inside the triangle, because all weights are positive.
            let weights = [1 + k % 5, 1 + k % 3, 1 + k % 7].map(IBig::from);
            let at = mixed(&corners, &weights);
            let near = (v[0].as_dvec3() + v[1].as_dvec3() + v[2].as_dvec3()) / 3.0;
            let out = self.outside(s, near, k);
            let side = sign(&height(&flat, &point(out)));
            let odd = self.parity(scene, s, &at, bounds, out, Some(t))?;
            (side != Ordering::Equal).then_some(odd == (side == Ordering::Greater))
        })
    }

    /// Returns a point outside the bounds of surface `s`, displaced from the point `from` mainly along an
    /// axis. Each attempt `k` gives another point.
    fn outside(&self, s: u32, from: glam::DVec3, k: u32) -> [f64; 3] {
        let Surface { min, max, .. } = &self.all[s as usize];
        let (min, max) = (min.as_dvec3().min(from), max.as_dvec3().max(from));
        let size = (max - min).max_element();
        let axis = k as usize % 3;
        let mut to = from.to_array();
        // The displacements have periods 5 and 7, so the directions differ for each attempt.
        to[(axis + 1) % 3] += size * 0.0131 * f64::from(1 + k % 5);
        to[(axis + 2) % 3] -= size * 0.0077 * f64::from(1 + k % 7);
        to[axis] = if k.is_multiple_of(2) {
            max[axis] + size
        } else {
            min[axis] - size
        };
        to
    }

    /// Returns true if a segment crosses the surface and its patches an odd number of times. The segment
    /// leads from a point inside `bounds` to a point outside the surface. The count excludes the triangle
    /// `without`. Returns `None` if the segment touches an edge.
    fn parity(
        &self,
        scene: &TriangleTree<'_>,
        s: u32,
        from: &Point,
        bounds: Aabb,
        to: [f64; 3],
        without: Option<u32>,
    ) -> Option<bool> {
        let Surface { min, max, patches } = &self.all[s as usize];
        let out = (0..3).any(|k| to[k] < f64::from(min[k]) || to[k] > f64::from(max[k]));
        if !out || !to.iter().all(|c| c.is_finite()) {
            return None;
        }
        let end = point(to);
        let around = Aabb::new(
            to.map(|c| (c as f32).next_down()).into(),
            to.map(|c| (c as f32).next_up()).into(),
        );
        let along = scene.along(bounds, around);
        let own = along
            .iter()
            .filter(|u| self.by_triangle[**u as usize] == Some(s) && Some(**u) != without);
        let mut odd = false;
        for u in own.map(|u| &scene.all()[*u as usize]).chain(patches) {
            odd ^= passes(u, from, &end)?;
        }
        Some(odd)
    }
}

/// Returns true if a segment crosses the interior of a triangle. Returns `None` if the segment touches, or
/// may touch, the triangle in another way.
fn passes(t: &[Vec3; 3], p: &Point, q: &Point) -> Option<bool> {
    let [a, b, c] = exact(t);
    let own = plane([&a, &b, &c]);
    let ends = [p, q].map(|e| sign(&height(&own, e)));
    if ends[0] == ends[1] && ends[0] != Ordering::Equal {
        return Some(false);
    }
    let line = join(p, q);
    let sides = [join(&a, &b), join(&b, &c), join(&c, &a)].map(|e| sign(&klein(&line, &e)));
    match (
        sides.contains(&Ordering::Less) && sides.contains(&Ordering::Greater),
        sides.contains(&Ordering::Equal),
    ) {
        (true, _) => Some(false),
        (false, true) => None,
        (false, false) => (!ends.contains(&Ordering::Equal)).then_some(true),
    }
}

/// Returns true if triangle `u` has a point in the interior of triangle `t`. The function clips `u` to the
/// plane of `t` and to the inner sides of the edges of `t`. The remaining polygon is convex, so it has a
/// point in the interior of `t` if and only if its centre is such a point.
fn pierces(t: &[Point; 3], flat: &Plane, u: &[Vec3; 3]) -> bool {
    let [a, b, c] = t;
    let off: Point = std::array::from_fn(|i| {
        if i < 3 {
            &a[i] + &flat[i] * &a[3]
        } else {
            a[3].clone()
        }
    });
    let mut left: Vec<Point> = exact(u).into();
    let negated = |f: &Plane| f.clone().map(|c| -c);
    let mut walls = vec![flat.clone(), negated(flat)];
    for (p, q, r) in [(a, b, c), (b, c, a), (c, a, b)] {
        let wall = plane([p, q, &off]);
        walls.push(if sign(&height(&wall, r)) == Ordering::Less {
            negated(&wall)
        } else {
            wall
        });
    }
    for wall in &walls {
        let heights: Vec<Ordering> = left.iter().map(|p| sign(&height(wall, p))).collect();
        let mut kept = Vec::with_capacity(left.len() + 1);
        for i in 0..left.len() {
            let j = (i + 1) % left.len();
            if heights[i] != Ordering::Less {
                kept.push(left[i].clone());
            }
            if heights[i] == heights[j].reverse() && heights[i] != Ordering::Equal {
                kept.push(cut(&left[i], &left[j], wall));
            }
        }
        left = kept;
    }
    if left.is_empty() {
        return false;
    }
    let weights = vec![IBig::ONE; left.len()];
    inside(&t[..], &mixed(&left, &weights))
}

/// Returns true if a plane separates a patch from the convex hull of a cell and a triangle. The function
/// tries a fixed list of planes.
fn apart(Aabb { min: lo, max: hi }: Aabb, t: &[Vec3; 3], patch: &[Vec3; 3]) -> bool {
    let (min, max) = t.iter().fold((lo, hi), |(a, b), v| (a.min(*v), b.max(*v)));
    if (0..3).any(|k| patch.iter().all(|p| p[k] < min[k]) || patch.iter().all(|p| p[k] > max[k])) {
        return true;
    }
    let cell: Vec<Point> = (0..8)
        .map(|k| {
            let at = |axis: usize| {
                f64::from(if k >> axis & 1 == 1 {
                    hi[axis]
                } else {
                    lo[axis]
                })
            };
            point([at(0), at(1), at(2)])
        })
        .collect();
    let (t, patch) = (exact(t), exact(patch));
    let side = |t: &[Point; 3], p: &Point| sign(&height(&plane([&t[0], &t[1], &t[2]]), p));
    let first = side(&patch, &cell[0]);
    if first != Ordering::Equal && cell.iter().chain(&t).all(|p| side(&patch, p) == first) {
        return true;
    }
    let beyond = side(&t, &patch[0]);
    beyond != Ordering::Equal
        && patch.iter().all(|p| side(&t, p) == beyond)
        && cell.iter().all(|p| side(&t, p) != beyond)
}

/// Returns the patches that close a surface with these odd edges.
fn patches(odd: &[[[u32; 3]; 2]]) -> Vec<[Vec3; 3]> {
    let position = |k: [u32; 3]| Vec3::from(k.map(f32::from_bits));
    // For each corner, the lowest corner of the connected part that contains it.
    let mut least: BTreeMap<[u32; 3], [u32; 3]> = odd.iter().flatten().map(|k| (*k, *k)).collect();
    loop {
        let mut changed = false;
        for [p, q] in odd {
            let both = least[p].min(least[q]);
            for end in [p, q] {
                changed |= least.insert(*end, both) != Some(both);
            }
        }
        if !changed {
            break;
        }
    }
    odd.iter()
        .filter(|[p, q]| least[p] != *p && least[p] != *q)
        .map(|[p, q]| [position(least[p]), position(*p), position(*q)])
        .collect()
}
