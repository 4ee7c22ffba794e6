//! Which corners are on which planes for a reason, so that no integers are needed to see that a sign is 0.
//!
//! Surfaces share points and edges, and walls are parallel, so nearly all signs that doubles leave open are
//! 0. What follows are implications, never guesses. For a face f whose plane does not hold the viewpoint, let
//! w(f) be the linear form on directions that is 1 at each of its points: one over how far away its plane is.
//! The plane of a meet of f and g is where w(f) = w(g); that of an edge is spanned by its two points.

use super::eye::Eye;
use super::planes::{Corner, Kind, NONE, Planes};

impl Planes {
    /// Whether a corner is known to be on a plane.
    pub(super) fn is_on(&self, eye: &Eye<'_>, corner: &Corner, kind: Kind) -> bool {
        let [first, second] = corner.sides.map(|s| self.list[s.plane()].kind);
        // The most frequent and cheapest first.
        let names = |p: u32| matches!(kind, Kind::Edge(a, b) if p == a || p == b);
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

/// Whether two kinds are known to name one plane; `other` is a side of a corner. If `kind` is no plane, its
/// sign is 0 anyway.
fn same(eye: &Eye<'_>, other: Kind, kind: Kind) -> bool {
    match (kind, other) {
        // Both forms are 1 at both points.
        (Kind::Edge(a, b), Kind::Meet(f, g)) | (Kind::Meet(f, g), Kind::Edge(a, b)) => {
            has_edge(f, a, b) && has_edge(g, a, b)
        }
        (Kind::Edge(..), Kind::Edge(c, d)) => holds(eye, kind, c) && holds(eye, kind, d),
        (Kind::Meet(f, g), Kind::Meet(h, k)) => others((f, g), (h, k))
            .is_some_and(|(f, h)| h.iter().all(|p| eye.is_in_plane(*p, f) == Some(true))),
        _ => false,
    }
}

/// Whether one of the planes is that of an edge in the line of a meet, which both faces' planes hold.
fn is_in_both(eye: &Eye<'_>, other: Kind, kind: Kind) -> bool {
    match (kind, other) {
        (Kind::Meet(..), Kind::Edge(a, b)) => holds(eye, kind, a) && holds(eye, kind, b),
        (Kind::Edge(a, b), Kind::Meet(..)) => holds(eye, other, a) && holds(eye, other, b),
        _ => false,
    }
}

/// Whether a plane is known to hold the direction to a point.
fn holds(eye: &Eye<'_>, kind: Kind, p: u32) -> bool {
    match kind {
        Kind::Edge(a, b) => p == a || p == b || eye.turn([p, a, b]) == Some(0),
        Kind::Meet(f, g) => [f, g]
            .iter()
            .all(|face| eye.is_in_plane(p, *face) == Some(true)),
        Kind::Normal(_) => false,
    }
}

/// Whether a point is in the direction in which the first two planes meet, and in the third plane.
fn is_at_a_point(eye: &Eye<'_>, first: Kind, second: Kind, kind: Kind) -> bool {
    let both = |p: u32| holds(eye, first, p) && holds(eye, second, p);
    match kind {
        Kind::Edge(a, b) => both(a) || both(b),
        Kind::Meet(f, g) => f
            .into_iter()
            .chain(g)
            .any(|p| holds(eye, kind, p) && both(p)),
        Kind::Normal(_) => false,
    }
}

/// Whether all three planes hold the direction of one axis.
fn is_along_an_axis(eye: &Eye<'_>, first: Kind, second: Kind, kind: Kind) -> bool {
    let Kind::Edge(a, b) = kind else { return false };
    let (p, q) = (eye.point(a), eye.point(b));
    let Some(axis) = (0..3).find(|k| (0..3).all(|j| j == *k || p[j] == q[j])) else {
        return false;
    };
    [first, second].into_iter().all(|plane| match plane {
        Kind::Edge(a, b) => {
            let (p, q) = (eye.point(a), eye.point(b));
            (0..3).all(|j| j == axis || p[j] == q[j])
        }
        Kind::Normal(n) => n[axis] == 0.0,
        Kind::Meet(..) => false,
    })
}

/// Whether two meets with a face in common imply the third plane.
fn is_by_meets(eye: &Eye<'_>, first: Kind, second: Kind, kind: Kind) -> bool {
    match (first, second, kind) {
        // The forms of two faces with a common edge agree in its plane.
        (Kind::Edge(a, b), Kind::Meet(f, g), Kind::Meet(h, k))
        | (Kind::Meet(f, g), Kind::Edge(a, b), Kind::Meet(h, k)) => {
            others((f, g), (h, k)).is_some_and(|(f, h)| has_edge(f, a, b) && has_edge(h, a, b))
        }
        // And if their planes differ, only there.
        (Kind::Meet(f, g), Kind::Meet(h, k), Kind::Edge(a, b)) => others((f, g), (h, k))
            .is_some_and(|(f, h)| {
                let differ = || h.iter().any(|p| eye.is_in_plane(*p, f) == Some(false));
                has_edge(f, a, b) && has_edge(h, a, b) && differ()
            }),
        // w(f) = w(g) and w(g) = w(h).
        (Kind::Meet(f, g), Kind::Meet(h, k), Kind::Meet(i, j)) => {
            others((f, g), (h, k)).is_some_and(|rest| rest == (i, j) || rest == (j, i))
        }
        _ => false,
    }
}

type ZeroFace = [u32; 3];

fn has_edge(face: ZeroFace, a: u32, b: u32) -> bool {
    face.contains(&a) && face.contains(&b)
}

/// Of two pairs of faces with one in common, the two others.
fn others(
    (f, g): (ZeroFace, ZeroFace),
    (h, k): (ZeroFace, ZeroFace),
) -> Option<(ZeroFace, ZeroFace)> {
    match () {
        () if f == h => Some((g, k)),
        () if f == k => Some((g, h)),
        () if g == h => Some((f, k)),
        () if g == k => Some((f, h)),
        () => None,
    }
}
