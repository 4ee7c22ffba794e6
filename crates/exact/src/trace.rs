//! What one sight line meets, decided exactly.

use std::cmp::Ordering;

use glam::DVec3;

use crate::occluder::Occluders;
use crate::prism::Pair;
use crate::vector::Space;

/// What a segment from a point of A to a point of B meets in between.
#[derive(Debug, PartialEq, Eq)]
pub enum Met {
    /// No triangle at all: a witness.
    Nothing,
    /// It passes through the inside of these triangles.
    Blocked(Vec<u32>),
    /// It touches a triangle's border, and passes through none.
    Grazing,
}

/// Follows the segment from `p` to `q`, points of the space inside A and B and close to the doubles given.
///
/// Triangles in the plane of A or of B do not count, and neither does what the segment reaches only at its ends.
pub fn trace(
    space: &mut Space,
    scene: &Occluders,
    pair: &Pair,
    (p, q): (u32, u32),
    (near_p, near_q): (DVec3, DVec3),
) -> Met {
    let mut candidates = Vec::new();
    scene.along(near_p, near_q, &mut candidates);
    let mut blocked = Vec::new();
    let mut grazing = false;
    for id in candidates {
        let before = space.size();
        match meets(space, scene, pair, (p, q), id) {
            Touch::Through => blocked.push(id),
            Touch::Border => grazing = true,
            Touch::Not => {}
        }
        space.truncate(before);
    }
    match (blocked.is_empty(), grazing) {
        (false, _) => Met::Blocked(blocked),
        (true, true) => Met::Grazing,
        (true, false) => Met::Nothing,
    }
}

enum Touch {
    Not,
    Border,
    Through,
}

fn meets(space: &mut Space, scene: &Occluders, pair: &Pair, (p, q): (u32, u32), id: u32) -> Touch {
    let corners = scene.triangle(id).map(|v| {
        let point = space.frame().given(v.as_dvec3());
        space.point(point)
    });
    let [a, b, c] = corners;
    let (sp, sq) = (space.orient(a, b, c, p), space.orient(a, b, c, q));
    if sp == sq && sp != Ordering::Equal {
        return Touch::Not;
    }
    let sides = [space.orient(p, q, a, b), space.orient(p, q, b, c), space.orient(p, q, c, a)];
    if sides.contains(&Ordering::Greater) && sides.contains(&Ordering::Less) {
        return Touch::Not;
    }
    if sp == Ordering::Equal || sq == Ordering::Equal {
        // In the plane of A or of B it is not in between; else the segment ends on it, and touches.
        let in_plane = |space: &mut Space, of: &[u32]| {
            corners.iter().all(|t| space.orient(of[0], of[1], of[2], *t) == Ordering::Equal)
        };
        let (at_a, at_b) = (sp == Ordering::Equal, sq == Ordering::Equal);
        let exempt = at_a && in_plane(space, &pair.a) || at_b && in_plane(space, &pair.b);
        return if exempt { Touch::Not } else { Touch::Border };
    }
    if sides.contains(&Ordering::Equal) { Touch::Border } else { Touch::Through }
}
