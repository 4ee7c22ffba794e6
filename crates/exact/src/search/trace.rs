//! Tracing a sight line: which triangles it meets, decided exactly.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_geometry::rounding::UNIT as U;

use crate::line_space::space::Space;
use crate::line_space::stabbing_polyhedron::Pair;
use crate::occluders::Occluders;
use crate::search::local::Local;

/// What a segment from a point of A to a point of B meets in between.
#[derive(Debug, PartialEq, Eq)]
pub enum Met {
    /// No triangle at all: a witness.
    Nothing,
    /// It passes through the interior of these triangles. The flag says whether it comes from the front, the
    /// side from which the corners appear counter-clockwise.
    Blocked(Vec<(u32, bool)>),
    /// It touches the border of a triangle and passes through the interior of none.
    Grazing,
}

impl Local<'_> {
    /// Traces the segment from `p` to `q`, points of the space inside A and B and close to `near_p` and
    /// `near_q`.
    ///
    /// Triangles in the plane of A or of B do not count.
    pub fn trace(
        &mut self,
        scene: &Occluders,
        (p, q): (u32, u32),
        (near_p, near_q): (DVec3, DVec3),
    ) -> Met {
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        scene.along(near_p, near_q, self.pair.size, &mut candidates);
        let slack = scene.slack(self.pair.size);
        let mut blocked = Vec::new();
        let mut grazing = false;
        for id in &candidates {
            if surely_missed(scene.triangle(*id), (near_p, near_q), slack) {
                self.space.decisions.filtered += 1;
                continue;
            }
            let corners = self.corner_points(scene, *id);
            match touch(&mut self.space, &mut self.pair, (p, q), *id, corners) {
                Touch::Through(front) => blocked.push((*id, front)),
                Touch::Border => grazing = true,
                Touch::Not => {}
            }
        }
        self.candidates = candidates;
        match (blocked.is_empty(), grazing) {
            (false, _) => Met::Blocked(blocked),
            (true, true) => Met::Grazing,
            (true, false) => Met::Nothing,
        }
    }
}

/// Whether doubles show that a line passes a triangle's edges on different sides and so misses the triangle.
/// Both points may be off by `slack`.
///
/// Each turn is a product of three differences, each off by at most e = 2 slack and a rounding. With n the
/// greatest magnitude of a difference plus e, the turn is off by at most 3·6en² for these errors and 100un³
/// for its own roundings ([`crate::geometry::predicates::orient_points`]).
fn surely_missed(triangle: &[Vec3; 3], (p, q): (DVec3, DVec3), slack: f64) -> bool {
    let [a, b, c] = triangle.map(|v| v.as_dvec3() - p);
    let d = q - p;
    let n = a.abs().max(b.abs()).max(c.abs()).max(d.abs()).max_element();
    let e = 2.0 * slack + U * n;
    let n = n + e;
    let bound = (19.0 * e + 100.0 * U * n) * n * n;
    let turns = [d.cross(a).dot(b), d.cross(b).dot(c), d.cross(c).dot(a)];
    turns.iter().any(|t| *t > bound) && turns.iter().any(|t| *t < -bound)
}

enum Touch {
    Not,
    Border,
    /// Whether it comes from the side from which the corners appear counter-clockwise.
    Through(bool),
}

/// How the segment meets one triangle.
fn touch(
    space: &mut Space,
    pair: &mut Pair,
    (p, q): (u32, u32),
    id: u32,
    corners: [u32; 3],
) -> Touch {
    if pair.flat.get(&id).is_some_and(|f| f.contains(&true)) {
        return Touch::Not;
    }
    let [a, b, c] = corners;
    let (sp, sq) = (
        space.filtered_orient(a, b, c, p),
        space.filtered_orient(a, b, c, q),
    );
    if sp.is_some() && sp == sq {
        return Touch::Not;
    }
    let sides = [
        space.orient(p, q, a, b),
        space.orient(p, q, b, c),
        space.orient(p, q, c, a),
    ];
    if sides.contains(&Ordering::Greater) && sides.contains(&Ordering::Less) {
        return Touch::Not;
    }
    let (sp, sq) = match (sp, sq) {
        (Some(sp), Some(sq)) => (sp, sq),
        _ => {
            // An end may be on the triangle's plane, for example because the triangle is in A's plane or in
            // B's.
            if in_planes(space, pair, id, &corners).contains(&true) {
                return Touch::Not;
            }
            let (sp, sq) = (space.orient(a, b, c, p), space.orient(a, b, c, q));
            if sp == sq && sp != Ordering::Equal {
                return Touch::Not;
            }
            (sp, sq)
        }
    };
    if sp == Ordering::Equal || sq == Ordering::Equal || sides.contains(&Ordering::Equal) {
        Touch::Border
    } else {
        Touch::Through(sp == Ordering::Greater)
    }
}

/// Whether a triangle lies in A's plane, and whether in B's; such a triangle is not between A and B.
fn in_planes(space: &mut Space, pair: &mut Pair, id: u32, corners: &[u32; 3]) -> [bool; 2] {
    if let Some(known) = pair.flat.get(&id) {
        return *known;
    }
    let flat = [&pair.a, &pair.b].map(|of| {
        corners
            .iter()
            .all(|t| space.orient(of[0], of[1], of[2], *t) == Ordering::Equal)
    });
    pair.flat.insert(id, flat);
    flat
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::frame::Source;
    use crate::geometry::predicates::orient;

    proptest! {
        /// A triangle reported as missed is missed by every line between points that are off by at most the
        /// slack.
        #[test]
        fn what_is_surely_missed_is_missed(
            p in prop::array::uniform5(prop::array::uniform3(-4i32..5)),
            off in prop::array::uniform6(-1.0f64..1.0),
            scale in -140i32..100, slack in prop_oneof![Just(0.0), Just(1e-14), Just(1e-3), Just(0.3)],
        ) {
            let scale = f32::powi(2.0, scale);
            let at = |i: usize| Vec3::from(p[i].map(|c| c as f32 * scale));
            let triangle = [at(0), at(1), at(2)];
            let ends = [at(3), at(4)].map(|v| v.as_dvec3());
            let slack = slack * f64::from(scale);
            if surely_missed(&triangle, (ends[0], ends[1]), slack) {
                let moved = [DVec3::from([off[0], off[1], off[2]]), DVec3::from([off[3], off[4], off[5]])];
                let ends: [Source; 2] = std::array::from_fn(|k| Source::Given(ends[k] + moved[k] * slack));
                let corners = triangle.map(|v| Source::Given(v.as_dvec3()));
                let turn = |(i, j): (usize, usize)| orient([&ends[0], &ends[1], &corners[i], &corners[j]]);
                let turns = [(0, 1), (1, 2), (2, 0)].map(turn);
                let both = turns.contains(&Ordering::Greater) && turns.contains(&Ordering::Less);
                prop_assert!(both, "{:?}", turns);
            }
        }
    }
}
