//! The test whether one triangle of a surface may pass through another triangle of the surface.

use std::cmp::Ordering;

use glam::Vec3;
use sightline_geometry::predicates::{Crossing, crossing};
use sightline_geometry::predicates::{orient2d_sign, orient3d_sign};

/// Returns true if a triangle `u` may have a point in the interior of a triangle `t`.
///
/// `ct` and `cu` contain the corner numbers of `t` and `u`. Corners at equal positions have equal numbers.
pub fn may_pierce(t: &[Vec3; 3], u: &[Vec3; 3], ct: [u32; 3], cu: [u32; 3]) -> bool {
    // A shared corner is in the triangle's plane, and exact arithmetic would take long to show this.
    let place = |triangle: &[Vec3; 3], c: [u32; 3], (p, n): (Vec3, u32)| {
        if c.contains(&n) {
            Ordering::Equal
        } else {
            orient3d_sign(triangle[0], triangle[1], triangle[2], p)
        }
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
        // Two different planes through a common edge meet only in the line of this edge.
        return false;
    }
    // u meets t's plane in a segment. If the segment enters t, an end of it is inside t or an edge of t
    // crosses u.
    let edges = [(0, 1), (1, 2), (2, 0)];
    let enters = edges.iter().any(|(i, j)| {
        let (a, b) = (u[*i], u[*j]);
        // A shared corner is on t's border. If the other end is off t's plane, so is the rest of the edge.
        let apart = sides[*i] == sides[*j] && sides[*i] != Ordering::Equal;
        let at_corner = sides[*i] == Ordering::Equal
            && ct.contains(&cu[*i])
            && sides[*j] != Ordering::Equal
            || sides[*j] == Ordering::Equal && ct.contains(&cu[*j]) && sides[*i] != Ordering::Equal;
        if sides[*i] == Ordering::Equal && sides[*j] == Ordering::Equal {
            return enters_in_plane(t, a, b);
        }
        !apart && !at_corner && crossing(*t, a, b) != Crossing::Not
    });
    enters
        || edges.iter().any(|(i, j)| {
            let ends = [i, j].map(|k| place(u, cu, (t[*k], ct[*k])));
            // This is also true for an edge in u's plane: u then meets t's plane along that edge.
            let apart = ends[0] == ends[1];
            let at_corner = ends[0] == Ordering::Equal
                && cu.contains(&ct[*i])
                && ends[1] != Ordering::Equal
                || ends[1] == Ordering::Equal && cu.contains(&ct[*j]) && ends[0] != Ordering::Equal;
            !apart && !at_corner && crossing(*u, t[*i], t[*j]) != Crossing::Not
        })
}

/// Returns true if two triangles in one plane have inner points in common.
///
/// This is the case if no line along an edge of one triangle has the other triangle on its outer side.
fn overlap_in_plane(t: &[Vec3; 3], u: &[Vec3; 3]) -> bool {
    // The triangles are projected along an axis that their plane does not contain, so that both keep their
    // area.
    let turn = |k: usize, p: [Vec3; 3]| {
        let [a, b, c] = p.map(|v| [v[(k + 1) % 3], v[(k + 2) % 3]]);
        orient2d_sign(a, b, c)
    };
    let Some(axis) = (0..3).find(|k| turn(*k, *t) != Ordering::Equal) else {
        return true;
    };
    let separated = |x: &[Vec3; 3], y: &[Vec3; 3]| {
        let inner = turn(axis, *x);
        [(0, 1), (1, 2), (2, 0)]
            .iter()
            .any(|(i, j)| y.iter().all(|p| turn(axis, [x[*i], x[*j], *p]) != inner))
    };
    !(separated(t, u) || separated(u, t))
}

/// Returns true if a segment in a triangle's plane has points in the interior of the triangle.
///
/// This is the case if the segment is not on the outer side of an edge, and corners of the triangle are on
/// both sides of the segment's line.
fn enters_in_plane(t: &[Vec3; 3], a: Vec3, b: Vec3) -> bool {
    let turn = |k: usize, p: [Vec3; 3]| {
        let [a, b, c] = p.map(|v| [v[(k + 1) % 3], v[(k + 2) % 3]]);
        orient2d_sign(a, b, c)
    };
    let Some(axis) = (0..3).find(|k| turn(*k, *t) != Ordering::Equal) else {
        return true;
    };
    let inner = turn(axis, *t);
    let outside = [(0, 1), (1, 2), (2, 0)].iter().any(|(i, j)| {
        [a, b]
            .iter()
            .all(|p| turn(axis, [t[*i], t[*j], *p]) != inner)
    });
    let along = t.map(|v| turn(axis, [a, b, v]));
    !outside && along.contains(&Ordering::Less) && along.contains(&Ordering::Greater)
}
