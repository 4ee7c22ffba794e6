//! A tree of boxes around the triangles of a scene, to find the triangles near a box or a segment.
//!
//! Comparisons of boxes in single precision are exact, because the coordinates are the scene's coordinates.

use glam::Vec3;
use sightline_numbers::Aabb;

/// The triangles of a scene with an index for queries near a segment, which visit few other triangles.
pub struct TriangleTree<'a> {
    all: &'a [[Vec3; 3]],
    /// The boxes as a binary heap: the root at 1, and the children of `i` at 2i and 2i + 1. Node k of a level
    /// contains the k-th of the level's equal parts of `order`.
    boxes: Vec<Aabb>,
    order: Vec<u32>,
    depth: u32,
}

/// The typical number of triangles in a leaf.
const LEAF: usize = 4;
/// The number of pieces into which a look-up divides a segment, each with a separate box.
const PIECES: u32 = 64;

impl<'a> TriangleTree<'a> {
    /// Creates the tree of the triangles in `order`.
    pub fn new(all: &'a [[Vec3; 3]], mut order: Vec<u32>) -> Self {
        let count = order.len();
        let depth = (count / LEAF).max(1).ilog2();
        let mut boxes = vec![Aabb::EMPTY; 2 << depth];
        let least = |t: u32| {
            all[t as usize]
                .iter()
                .fold(Vec3::INFINITY, |m, v| m.min(*v))
        };
        for level in 0..=depth {
            for k in 0..1usize << level {
                let range = part(count, level, k);
                let items = &mut order[range];
                let bounds = Aabb::around(items.iter().flat_map(|t| all[*t as usize]));
                boxes[(1 << level) + k] = bounds;
                if level < depth && !items.is_empty() {
                    let axis = (bounds.max - bounds.min).max_position();
                    let half = part(count, level + 1, 2 * k).len();
                    if half < items.len() {
                        items.select_nth_unstable_by(half, |s, t| {
                            least(*s)[axis].total_cmp(&least(*t)[axis]).then(s.cmp(t))
                        });
                    }
                }
            }
        }
        Self {
            all,
            boxes,
            order,
            depth,
        }
    }

    /// Returns the triangles, in the order of the scene.
    pub fn all(&self) -> &'a [[Vec3; 3]] {
        self.all
    }

    /// Appends every triangle of the tree whose bounds meet the box. Then sorts `out` and removes duplicates.
    pub fn in_box(&self, bounds: Aabb, out: &mut Vec<u32>) {
        let mut open = vec![(0u32, 0usize)];
        while let Some((level, k)) = open.pop() {
            if !self.boxes[(1 << level) + k].touches(&bounds) {
                continue;
            }
            if level < self.depth {
                open.extend([(level + 1, 2 * k), (level + 1, 2 * k + 1)]);
                continue;
            }
            let leaf = &self.order[part(self.order.len(), level, k)];
            out.extend(
                leaf.iter()
                    .filter(|t| Aabb::around(self.all[**t as usize]).touches(&bounds)),
            );
        }
        out.sort_unstable();
        out.dedup();
    }

    /// Returns every triangle of the tree that may have a point on a segment, ascending. The ends of the
    /// segment are points in the boxes `p` and `q`.
    pub fn along(&self, p: Aabb, q: Aabb) -> Vec<u32> {
        let mut out = Vec::new();
        let (p, q) = (p.corners(), q.corners());
        for piece in 0..PIECES {
            // A point of the segment is (1 − t)p + tq. For t between two multiples of 1/64, the coordinates
            // of the point are between the coordinates of the boxes there. The weights are exact. The error
            // of two products and a sum is less than 1e-15 of the largest coordinate.
            let share = |k: u32, corner: usize| {
                let t = f64::from(k) / f64::from(PIECES);
                p[corner].as_dvec3() * (1.0 - t) + q[corner].as_dvec3() * t
            };
            let (a, b) = (
                share(piece, 0).min(share(piece + 1, 0)),
                share(piece, 1).max(share(piece + 1, 1)),
            );
            let slack = p
                .iter()
                .chain(&q)
                .fold(0.0f64, |m, v| m.max(f64::from(v.abs().max_element())))
                * 1e-15;
            let down = |x: f64| ((x - slack) as f32).next_down();
            let up = |x: f64| ((x + slack) as f32).next_up();
            self.in_box(
                Aabb {
                    min: Vec3::new(down(a.x), down(a.y), down(a.z)),
                    max: Vec3::new(up(b.x), up(b.y), up(b.z)),
                },
                &mut out,
            );
        }
        out.sort_unstable();
        out.dedup();
        out
    }
}

/// Returns the range of the `k`-th of 2^level equal parts of `items` items.
fn part(items: usize, level: u32, k: usize) -> std::ops::Range<usize> {
    let at = |k: usize| ((items as u128 * k as u128) >> level) as usize;
    at(k)..at(k + 1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-10i8..10).prop_map(|p| Vec3::from(p.map(f32::from)))
    }

    proptest! {
        #[test]
        fn queries_return_every_near_triangle(
            triangles in prop::collection::vec(prop::array::uniform3(point()), 0..60),
            p in point(),
            q in point(),
        ) {
            let tree = TriangleTree::new(&triangles, (0..triangles.len() as u32).collect());
            let along = tree.along(Aabb::new(p, p), Aabb::new(q, q));
            let bounds = Aabb::around([p, q]);
            let mut in_box = Vec::new();
            tree.in_box(bounds, &mut in_box);
            for (id, t) in triangles.iter().enumerate() {
                let (min, max) = (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
                let touches = min.cmple(bounds.max).all() && max.cmpge(bounds.min).all();
                prop_assert_eq!(in_box.contains(&(id as u32)), touches);
                // True if a point of the segment is in the triangle's box.
                let hit = (0..=640).any(|k| {
                    let x = p.as_dvec3() + (q - p).as_dvec3() * (f64::from(k) / 640.0);
                    x.cmpge(min.as_dvec3()).all() && x.cmple(max.as_dvec3()).all()
                });
                prop_assert!(!hit || along.contains(&(id as u32)));
            }
        }
    }
}
