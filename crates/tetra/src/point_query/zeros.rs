//! Implications that prove that a corner is on a plane, without integers.
//!
//! Surfaces share points and edges, and walls are parallel, so nearly all signs that doubles do not decide
//! are 0. The rules of this module are implications, never guesses. For a face f whose plane does not contain
//! the viewpoint, let w(f) be the linear form on vectors from the viewpoint that is 1 at each point of the
//! face. For a unit vector, w(f) is the reciprocal of the distance of the face's plane in this direction. The
//! plane [`PlaneOrigin::Meet`] of f and g contains the directions with w(f) = w(g). The plane
//! [`PlaneOrigin::Edge`] is spanned by the directions to the edge's two points.

use super::eye::Eye;
use super::planes::{Corner, NONE, PlaneOrigin, Planes};

impl Planes {
    /// Returns true if a corner is known to be on the plane that `kind` defines. False means that no rule
    /// applies.
    pub(super) fn is_on(&self, eye: &Eye<'_>, corner: &Corner, kind: PlaneOrigin) -> bool {
        let [first, second] = corner.sides.map(|s| self.list[s.plane()].kind);
        // The most frequent and cheapest test is first.
        let names = |p: u32| matches!(kind, PlaneOrigin::Edge(a, b) if p == a || p == b);
        first == kind
            || second == kind
            || (corner.point != NONE && names(corner.point))
            || same(eye, first, kind)
            || same(eye, second, kind)
            || (corner.point != NONE && holds(eye, kind, corner.point))
            || is_at_a_point(eye, first, second, kind)
            || is_along_an_axis(eye, first, second, kind)
            || is_by_meets(eye, first, second, kind)
            || is_in_both(eye, first, kind)
            || is_in_both(eye, second, kind)
    }
}

/// Returns true if two definitions are known to define one plane. `other` is the plane of a side of a corner.
///
/// If the normal of `kind` is 0, the definition does not define a plane, and the sign is 0 in any case.
fn same(eye: &Eye<'_>, other: PlaneOrigin, kind: PlaneOrigin) -> bool {
    match (kind, other) {
        // The linear forms of both faces are 1 at both points of the edge.
        (PlaneOrigin::Edge(a, b), PlaneOrigin::Meet(f, g))
        | (PlaneOrigin::Meet(f, g), PlaneOrigin::Edge(a, b)) => {
            has_edge(f, a, b) && has_edge(g, a, b)
        }
        (PlaneOrigin::Edge(..), PlaneOrigin::Edge(c, d)) => {
            holds(eye, kind, c) && holds(eye, kind, d)
        }
        (PlaneOrigin::Meet(f, g), PlaneOrigin::Meet(h, k)) => others([f, g], [h, k])
            .is_some_and(|(f, h)| h.iter().all(|p| eye.is_in_plane(*p, f) == Some(true))),
        _ => false,
    }
}

/// Returns true if one plane is a meet, and the other plane is the plane of an edge whose two points lie in
/// the planes of both faces of the meet.
fn is_in_both(eye: &Eye<'_>, other: PlaneOrigin, kind: PlaneOrigin) -> bool {
    match (kind, other) {
        (PlaneOrigin::Meet(..), PlaneOrigin::Edge(a, b)) => {
            holds(eye, kind, a) && holds(eye, kind, b)
        }
        (PlaneOrigin::Edge(a, b), PlaneOrigin::Meet(..)) => {
            holds(eye, other, a) && holds(eye, other, b)
        }
        _ => false,
    }
}

/// Returns true if a plane is known to contain the direction to the point with the number `p`.
fn holds(eye: &Eye<'_>, kind: PlaneOrigin, p: u32) -> bool {
    match kind {
        PlaneOrigin::Edge(a, b) => p == a || p == b || eye.turn([p, a, b]) == Some(0),
        PlaneOrigin::Meet(f, g) => [f, g]
            .iter()
            .all(|face| eye.is_in_plane(p, *face) == Some(true)),
        PlaneOrigin::Normal(_) => false,
    }
}

/// Returns true if all three planes are known to contain the direction to a common point.
///
/// The candidates are the points that define the plane `kind`.
fn is_at_a_point(
    eye: &Eye<'_>,
    first: PlaneOrigin,
    second: PlaneOrigin,
    kind: PlaneOrigin,
) -> bool {
    let both = |p: u32| holds(eye, first, p) && holds(eye, second, p);
    match kind {
        PlaneOrigin::Edge(a, b) => both(a) || both(b),
        PlaneOrigin::Meet(f, g) => f
            .into_iter()
            .chain(g)
            .any(|p| holds(eye, kind, p) && both(p)),
        PlaneOrigin::Normal(_) => false,
    }
}

/// Returns true if all three planes contain the direction of one coordinate axis, to which the edge of `kind`
/// is parallel.
fn is_along_an_axis(
    eye: &Eye<'_>,
    first: PlaneOrigin,
    second: PlaneOrigin,
    kind: PlaneOrigin,
) -> bool {
    let PlaneOrigin::Edge(a, b) = kind else {
        return false;
    };
    let (p, q) = (eye.point(a), eye.point(b));
    let Some(axis) = (0..3).find(|k| (0..3).all(|j| j == *k || p[j] == q[j])) else {
        return false;
    };
    [first, second].into_iter().all(|plane| match plane {
        PlaneOrigin::Edge(a, b) => {
            let (p, q) = (eye.point(a), eye.point(b));
            (0..3).all(|j| j == axis || p[j] == q[j])
        }
        PlaneOrigin::Normal(n) => n[axis] == 0.0,
        PlaneOrigin::Meet(..) => false,
    })
}

/// Returns true if two of the planes are meets with a common face, and `kind` contains the corner as a
/// consequence.
fn is_by_meets(eye: &Eye<'_>, first: PlaneOrigin, second: PlaneOrigin, kind: PlaneOrigin) -> bool {
    match (first, second, kind) {
        // The linear forms of two faces with a common edge are equal in the plane of the edge.
        (PlaneOrigin::Edge(a, b), PlaneOrigin::Meet(f, g), PlaneOrigin::Meet(h, k))
        | (PlaneOrigin::Meet(f, g), PlaneOrigin::Edge(a, b), PlaneOrigin::Meet(h, k)) => {
            others([f, g], [h, k]).is_some_and(|(f, h)| has_edge(f, a, b) && has_edge(h, a, b))
        }
        // If the planes of the two faces differ, their linear forms are equal only in the plane of the edge.
        (PlaneOrigin::Meet(f, g), PlaneOrigin::Meet(h, k), PlaneOrigin::Edge(a, b)) => {
            others([f, g], [h, k]).is_some_and(|(f, h)| {
                let differ = || h.iter().any(|p| eye.is_in_plane(*p, f) == Some(false));
                has_edge(f, a, b) && has_edge(h, a, b) && differ()
            })
        }
        // The third plane follows from w(f) = w(g) and w(g) = w(h).
        (PlaneOrigin::Meet(f, g), PlaneOrigin::Meet(h, k), PlaneOrigin::Meet(i, j)) => {
            others([f, g], [h, k]).is_some_and(|rest| rest == (i, j) || rest == (j, i))
        }
        _ => false,
    }
}

/// The point numbers of a face.
type ZeroFace = [u32; 3];

fn has_edge(face: ZeroFace, a: u32, b: u32) -> bool {
    face.contains(&a) && face.contains(&b)
}

/// Returns the other face of each of two pairs of faces with a common face. Returns `None` if the pairs have
/// no common face.
fn others([f, g]: [ZeroFace; 2], [h, k]: [ZeroFace; 2]) -> Option<(ZeroFace, ZeroFace)> {
    match () {
        () if f == h => Some((g, k)),
        () if f == k => Some((g, h)),
        () if g == h => Some((f, k)),
        () if g == k => Some((f, h)),
        () => None,
    }
}
