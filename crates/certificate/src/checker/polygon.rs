//! Convex flat polygons in exact coordinates: validity, clipping, division, containment.

use std::cmp::Ordering;

use dashu_int::IBig;

use super::geometry::{Plane, Point, height, plane, reduced, sign};
use super::{Corners, Refusal};

/// A polygon of a pair, and the plane that contains it.
pub(super) struct Side {
    pub corners: Vec<Point>,
    pub plane: Plane,
    /// The side of the plane that contains the other polygon.
    pub other: Ordering,
}

/// Checks that polygons are flat and strictly convex. A corner may lie on the line of an edge only if it is
/// an end of the edge.
pub(super) fn check_polygons(polygons: &[Corners]) -> Result<(), Refusal> {
    let sound = |c: &Corners| {
        let n = c.len();
        if n < 3 || c.iter().any(|p| sign(&p[3]) != Ordering::Greater) {
            return false;
        }
        let flat = plane([&c[0], &c[1], &c[2]]);
        let off: Point = std::array::from_fn(|i| {
            if i < 3 {
                &c[0][i] + &flat[i] * &c[0][3]
            } else {
                c[0][3].clone()
            }
        });
        let left =
            |i: usize, k: usize| sign(&height(&plane([&c[i], &c[(i + 1) % n], &off]), &c[k]));
        let inner = left(0, 2);
        inner != Ordering::Equal
            && c.iter().all(|p| height(&flat, p).is_zero())
            && (0..n).all(|i| {
                (0..n)
                    .filter(|k| *k != i && *k != (i + 1) % n)
                    .all(|k| left(i, k) == inner)
            })
    };
    if polygons.iter().all(sound) {
        Ok(())
    } else {
        Err(Refusal::Polygon)
    }
}

/// Returns the pairs of parts of two polygons, each part on one side of the other polygon's plane.
pub(super) fn parts(a: &[Point], b: &[Point]) -> Vec<(Vec<Point>, Vec<Point>)> {
    let (pa, pb) = (plane([&a[0], &a[1], &a[2]]), plane([&b[0], &b[1], &b[2]]));
    let mut out = Vec::new();
    for keep_a in [Ordering::Greater, Ordering::Less] {
        for keep_b in [Ordering::Greater, Ordering::Less] {
            if let (Some(x), Some(y)) = (clip(a, &pb, keep_a), clip(b, &pa, keep_b)) {
                out.push((x, y));
            }
        }
    }
    out
}

/// Returns the part of a polygon on one side of a plane, including its border. Returns `None` if the part has
/// no area.
pub(super) fn clip(corners: &[Point], plane: &Plane, keep: Ordering) -> Option<Vec<Point>> {
    let heights: Vec<IBig> = corners.iter().map(|p| height(plane, p)).collect();
    if !heights.iter().any(|h| sign(h) == keep) {
        return None;
    }
    let n = corners.len();
    let mut out = Vec::new();
    for i in 0..n {
        let j = (i + 1) % n;
        if sign(&heights[i]) != keep.reverse() {
            out.push(corners[i].clone());
        }
        if sign(&(&heights[i] * &heights[j])) == Ordering::Less {
            // The edge meets the plane at |h(i)|·j + |h(j)|·i.
            let weight = |h: &IBig| {
                if sign(h) == Ordering::Less {
                    -h.clone()
                } else {
                    h.clone()
                }
            };
            let (s, t) = (weight(&heights[i]), weight(&heights[j]));
            out.push(reduced(std::array::from_fn(|k| {
                &corners[j][k] * &s + &corners[i][k] * &t
            })));
        }
    }
    Some(out)
}

/// Divides a polygon along the line through two of its points, numbered as in
/// [`Step::Divide`](crate::proof::Step::Divide). Returns `None` if the points do not exist or a part has no
/// area.
pub(super) fn divide(corners: &[Point], from: u16, to: u16) -> Option<[Vec<Point>; 2]> {
    let n = 2 * corners.len();
    let (from, to) = (usize::from(from), usize::from(to));
    if from >= n || to >= n {
        return None;
    }
    // If both points were on one edge, a part would have no area.
    let apart = (to + n - from) % n;
    let edge_apart = |d: usize, at: usize| d > if at.is_multiple_of(2) { 2 } else { 1 };
    if !edge_apart(apart, from) || !edge_apart((n - apart) % n, to) {
        return None;
    }
    let place = |number: usize| {
        let (p, q) = (
            &corners[number / 2],
            &corners[(number / 2 + 1) % corners.len()],
        );
        if number.is_multiple_of(2) {
            return p.clone();
        }
        let mut middle: Point = std::array::from_fn(|k| &p[k] * &q[3] + &q[k] * &p[3]);
        middle[3] = &p[3] * &q[3] * 2;
        // Without the reduction, each division of a divided edge would double the length of the integers.
        reduced(middle)
    };
    let round = |from: usize, to: usize| {
        let mut out = vec![place(from)];
        let mut at = (from + 1) % n;
        while at != to {
            if at.is_multiple_of(2) {
                out.push(place(at));
            }
            at = (at + 1) % n;
        }
        out.push(place(to));
        out
    };
    Some([round(from, to), round(to, from)])
}

/// Returns true if a point lies in a convex flat polygon, including its border.
pub(super) fn within(polygon: &Corners, p: &Point) -> bool {
    let n = polygon.len();
    let flat = plane([&polygon[0], &polygon[1], &polygon[2]]);
    // With a point off the plane, each edge spans a plane that has the polygon on one side.
    let off: Point = std::array::from_fn(|i| {
        if i < 3 {
            &polygon[0][i] + &flat[i] * &polygon[0][3]
        } else {
            polygon[0][3].clone()
        }
    });
    let side = |i: usize, p: &Point| {
        sign(&height(
            &plane([&polygon[i], &polygon[(i + 1) % n], &off]),
            p,
        ))
    };
    let inner = side(0, &polygon[2]);
    height(&flat, p).is_zero() && (0..n).all(|i| side(i, p) != inner.reverse())
}

/// Returns true if a point of a polygon's plane is strictly inside the polygon.
pub(super) fn inside(corners: &[Point], p: &Point) -> bool {
    let flat = plane([&corners[0], &corners[1], &corners[2]]);
    if !height(&flat, p).is_zero() {
        return false;
    }
    // With a point off the plane, each edge spans a plane that has the polygon on one side.
    let off: Point = std::array::from_fn(|i| {
        if i < 3 {
            &p[i] + &flat[i] * &p[3]
        } else {
            p[3].clone()
        }
    });
    let n = corners.len();
    let sides: Vec<Ordering> = (0..n)
        .map(|i| {
            sign(&height(
                &plane([&corners[i], &corners[(i + 1) % n], &off]),
                p,
            ))
        })
        .collect();
    sides[0] != Ordering::Equal && sides.iter().all(|s| *s == sides[0])
}
