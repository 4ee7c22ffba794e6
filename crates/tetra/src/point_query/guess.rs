//! A guess of the visible triangle of a beam: the first triangle along the beam's middle.
//!
//! The choice of the first triangle that cuts a beam affects the number of parts but not the visible set. A
//! cut along the edges of a hidden triangle is useless; a cut along a visible triangle is necessary. So
//! doubles without error bounds are sufficient for the guess.

use sightline_geometry::vector::{cross, dot};

use super::beam::center;
use super::planes::Facing;
use super::rounded::Vector;
use super::search::Search;
use super::stack::Beam;
use crate::surfaces::BLOCKS;

/// A ray from the viewpoint, and the first triangle on the ray so far.
struct Ray {
    /// The viewpoint.
    x: Vector,
    /// The direction of the ray, of any length.
    way: Vector,
    /// The reciprocal of each coordinate of `way`.
    inverse: Vector,
    /// The end of the ray, in lengths of `way`.
    most: f64,
    /// The id of the first triangle so far.
    found: Option<u32>,
}

impl Search<'_> {
    /// Returns the id of the first pending triangle that blocks the ray through a beam's middle.
    ///
    /// Returns `None` if no such triangle is nearer than the cap.
    pub(super) fn guess(&mut self, beam: &Beam, cap: Option<&Facing>) -> Option<u32> {
        self.guess_along(beam, cap, center(&beam.ring))
    }

    /// Returns the id of the first pending triangle that blocks the ray in the direction `way` of the beam
    /// ([`Self::guess`]).
    pub(super) fn guess_along(
        &mut self,
        beam: &Beam,
        cap: Option<&Facing>,
        way: Vector,
    ) -> Option<u32> {
        // A triangle at the distance of the cap is the cap itself or coplanar with it, and does not cut the
        // beam better.
        let most = cap.map_or(f64::INFINITY, |cap| {
            cap.height.value / dot(cap.normal.v, way) * (1.0 - 1e-9)
        });
        let mut ray = Ray {
            x: self.eye.x,
            way,
            inverse: way.map(|c| 1.0 / c),
            most,
            found: None,
        };
        for entry in beam.pending.iter().rev() {
            if entry.count > 0 {
                self.meet_leaf(&mut ray, entry.first, entry.count);
            } else {
                self.follow_ray(&mut ray, entry.first);
            }
        }
        ray.found
    }

    fn follow_ray(&mut self, ray: &mut Ray, root: u32) {
        let mut open = std::mem::take(&mut self.scratch.boxes);
        open.clear();
        open.push(root);
        while let Some(number) = open.pop() {
            if self.enters(ray, number).is_none() {
                continue;
            }
            let node = &self.scene.nodes[number as usize];
            if node.count > 0 {
                self.meet_leaf(ray, node.first, node.count);
                continue;
            }
            let [a, b] = [node.first, node.first + 1];
            match (self.enters(ray, a), self.enters(ray, b)) {
                (Some(near_a), Some(near_b)) => {
                    open.extend(if near_a <= near_b { [b, a] } else { [a, b] })
                }
                (Some(_), None) => open.push(a),
                (None, Some(_)) => open.push(b),
                (None, None) => {}
            }
        }
        self.scratch.boxes = open;
    }

    /// Returns the position at which a ray enters the box with this number, in lengths of `way`, or `None` if
    /// the ray misses the box.
    fn enters(&self, ray: &Ray, number: u32) -> Option<f64> {
        let node = &self.scene.nodes[number as usize];
        let (mut from, mut to) = (0.0f64, ray.most);
        for k in 0..3 {
            let a = (f64::from(node.low[k]) - ray.x[k]) * ray.inverse[k];
            let b = (f64::from(node.high[k]) - ray.x[k]) * ray.inverse[k];
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        (from <= to).then_some(from)
    }

    fn meet_leaf(&self, ray: &mut Ray, first: u32, count: u32) {
        for t in &self.scene.order[first as usize..][..count as usize] {
            if self.scene.flags[*t as usize] & BLOCKS == 0 {
                continue;
            }
            let [a, b, c] = self.scene.triangles[*t as usize].map(|p| {
                let p = self.eye.point(p);
                [p[0] - ray.x[0], p[1] - ray.x[1], p[2] - ray.x[2]]
            });
            let sides = [
                dot(cross(a, b), ray.way),
                dot(cross(b, c), ray.way),
                dot(cross(c, a), ray.way),
            ];
            let all = sides[0] + sides[1] + sides[2];
            if all == 0.0 || sides.iter().any(|s| (*s > 0.0) != (all > 0.0)) {
                continue;
            }
            let at = dot(a, cross(b, c)) / all;
            if at > 0.0 && at < ray.most {
                (ray.most, ray.found) = (at, Some(*t));
            }
        }
    }
}
