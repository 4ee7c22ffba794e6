//! Tracing of a sight line: the exact decision which triangles the sight line meets.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_geometry::rounding::UNIT as U;

use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron::Pair;
use crate::occluders::Occluders;
use crate::search::local::{PairState, SightLineEnd};

/// The triangles between A and B that a segment from a point of A to a point of B meets.
#[derive(Debug, PartialEq, Eq)]
pub enum SegmentMeeting {
    /// The segment meets no triangle: it is a witness.
    Nothing,
    /// The segment passes through the interior of these triangles, which are given by their ids.
    ///
    /// The flag is true if the segment comes from the front, the side from which the corners appear
    /// counter-clockwise.
    Blocked(Vec<(u32, bool)>),
    /// The segment touches the border of a triangle, but passes through the interior of none.
    Grazing,
}

impl PairState<'_> {
    /// Traces the segment from `p`, inside A, to `q`, inside B.
    ///
    /// Triangles in the plane of A or in the plane of B do not count as met.
    pub fn trace(&mut self, scene: &Occluders, p: SightLineEnd, q: SightLineEnd) -> SegmentMeeting {
        let ((p, near_p), (q, near_q)) = (p, q);
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        scene.along(near_p, near_q, self.pair.size, &mut candidates);
        let slack = scene.slack(self.pair.size);
        let mut blocked = Vec::new();
        let mut grazing = false;
        for id in &candidates {
            if surely_missed(scene.triangle(*id), near_p, near_q, slack) {
                self.space.decisions.filtered += 1;
                continue;
            }
            let corners = self.corner_points(scene, *id);
            match touch(&mut self.space, &mut self.pair, p, q, *id, corners) {
                TriangleTouch::Through(front) => blocked.push((*id, front)),
                TriangleTouch::Border => grazing = true,
                TriangleTouch::Not => {}
            }
        }
        self.candidates = candidates;
        match (blocked.is_empty(), grazing) {
            (false, _) => SegmentMeeting::Blocked(blocked),
            (true, true) => SegmentMeeting::Grazing,
            (true, false) => SegmentMeeting::Nothing,
        }
    }
}

/// Returns true if doubles show that the line through `p` and `q` misses the triangle.
///
/// This is the case if the line passes the triangle's edges on different sides. Each coordinate of both
/// points may be off by `slack`.
///
/// Each of `turns` is a product of three differences, each off by at most e, which is 2 `slack` plus a
/// rounding. Let n be the largest magnitude of a difference plus e. Then each of `turns` is off by at most
/// 3·6en² for these errors and 100un³ for its own roundings ([`crate::geometry::predicates::orient_points`]).
fn surely_missed(triangle: &[Vec3; 3], p: DVec3, q: DVec3, slack: f64) -> bool {
    let [a, b, c] = triangle.map(|v| v.as_dvec3() - p);
    let d = q - p;
    let n = a.abs().max(b.abs()).max(c.abs()).max(d.abs()).max_element();
    let e = 2.0 * slack + U * n;
    let n = n + e;
    let bound = (19.0 * e + 100.0 * U * n) * n * n;
    let turns = [d.cross(a).dot(b), d.cross(b).dot(c), d.cross(c).dot(a)];
    turns.iter().any(|t| *t > bound) && turns.iter().any(|t| *t < -bound)
}

enum TriangleTouch {
    Not,
    Border,
    /// True if the segment comes from the side from which the corners appear counter-clockwise.
    Through(bool),
}

/// Determines if the segment from `p` to `q` passes through, touches or misses the triangle `id`.
fn touch(
    space: &mut Space,
    pair: &mut Pair,
    p: u32,
    q: u32,
    id: u32,
    corners: [u32; 3],
) -> TriangleTouch {
    if pair.flat.get(&id).is_some_and(|f| f.contains(&true)) {
        return TriangleTouch::Not;
    }
    let [a, b, c] = corners;
    let (sp, sq) = (
        space.filtered_orient(a, b, c, p),
        space.filtered_orient(a, b, c, q),
    );
    if sp.is_some() && sp == sq {
        return TriangleTouch::Not;
    }
    let sides = [
        space.orient(p, q, a, b),
        space.orient(p, q, b, c),
        space.orient(p, q, c, a),
    ];
    if sides.contains(&Ordering::Greater) && sides.contains(&Ordering::Less) {
        return TriangleTouch::Not;
    }
    let (sp, sq) = match (sp, sq) {
        (Some(sp), Some(sq)) => (sp, sq),
        _ => {
            // An end may be on the triangle's plane, for example because the triangle is in A's plane or in
            // B's.
            if in_planes(space, pair, id, &corners).contains(&true) {
                return TriangleTouch::Not;
            }
            let (sp, sq) = (space.orient(a, b, c, p), space.orient(a, b, c, q));
            if sp == sq && sp != Ordering::Equal {
                return TriangleTouch::Not;
            }
            (sp, sq)
        }
    };
    if sp == Ordering::Equal || sq == Ordering::Equal || sides.contains(&Ordering::Equal) {
        TriangleTouch::Border
    } else {
        TriangleTouch::Through(sp == Ordering::Greater)
    }
}

/// Returns true at index 0 if a triangle lies in A's plane, and true at index 1 if the triangle lies in B's
/// plane.
///
/// Such a triangle is not between A and B.
fn in_planes(space: &mut Space, pair: &mut Pair, id: u32, corners: &[u32; 3]) -> [bool; 2] {
    if let Some(known) = pair.flat.get(&id) {
        return *known;
    }
    let flat = [&pair.a, &pair.b].map(|polygon| {
        corners
            .iter()
            .all(|t| space.orient(polygon[0], polygon[1], polygon[2], *t) == Ordering::Equal)
    });
    pair.flat.insert(id, flat);
    flat
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::frame::PointOrigin;
    use crate::geometry::predicates::orient;

    proptest! {
        /// A triangle that the test reports as missed is certainly missed.
        ///
        /// Every line between points that are off by at most the slack misses it.
        #[test]
        fn surely_missed_triangles_are_missed(
            p in prop::array::uniform5(prop::array::uniform3(-4i32..5)),
            off in prop::array::uniform6(-1.0f64..1.0),
            scale in -140i32..100, slack in prop_oneof![Just(0.0), Just(1e-14), Just(1e-3), Just(0.3)],
        ) {
            let scale = f32::powi(2.0, scale);
            let at = |i: usize| Vec3::from(p[i].map(|c| c as f32 * scale));
            let triangle = [at(0), at(1), at(2)];
            let ends = [at(3), at(4)].map(|v| v.as_dvec3());
            let slack = slack * f64::from(scale);
            if surely_missed(&triangle, ends[0], ends[1], slack) {
                let moved = [DVec3::from([off[0], off[1], off[2]]), DVec3::from([off[3], off[4], off[5]])];
                let ends: [PointOrigin; 2] =
                    std::array::from_fn(|k| PointOrigin::Given(ends[k] + moved[k] * slack));
                let corners = triangle.map(|v| PointOrigin::Given(v.as_dvec3()));
                let turn = |(i, j): (usize, usize)| orient([&ends[0], &ends[1], &corners[i], &corners[j]]);
                let turns = [(0, 1), (1, 2), (2, 0)].map(turn);
                let both = turns.contains(&Ordering::Greater) && turns.contains(&Ordering::Less);
                prop_assert!(both, "{:?}", turns);
            }
        }
    }
}
