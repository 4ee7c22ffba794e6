//! Which polygon of a pair to halve, and where.

use sightline_certificate::proof::Which;

use crate::geometry::polygon::Polygon;

/// The polygon with the longest edge, and where to halve it.
pub fn widest(a: &Polygon, b: &Polygon) -> (Which, [u16; 2]) {
    let (da, ca) = halving(a);
    let (db, cb) = halving(b);
    if da >= db {
        (Which::A, ca)
    } else {
        (Which::B, cb)
    }
}

/// A polygon's longest edge, and the points between which a line across it halves the polygon.
fn halving(p: &Polygon) -> (f64, [u16; 2]) {
    let v = p.rounded();
    let n = v.len();
    let length = |i: usize| (v[(i + 1) % n] - v[i]).length();
    let longest = (0..n)
        .max_by(|i, j| length(*i).total_cmp(&length(*j)).then(j.cmp(i)))
        .unwrap_or(0);
    // The middle of edge i, and the vertex or middle of an edge halfway round from there.
    let from = 2 * longest + 1;
    (
        length(longest),
        [from as u16, ((from + n) % (2 * n)) as u16],
    )
}
