//! The choice of the polygon of a pair that is halved, and of the line that halves it.

use sightline_certificate::proof::QueryPolygon;

use crate::geometry::polygon::Polygon;

/// Chooses the polygon with the longest edge. The function also returns the two border points between which a
/// line halves that polygon, numbered as in [`Polygon::divided`].
pub fn widest(a: &Polygon, b: &Polygon) -> (QueryPolygon, [u16; 2]) {
    let (da, ca) = halving(a);
    let (db, cb) = halving(b);
    if da >= db {
        (QueryPolygon::A, ca)
    } else {
        (QueryPolygon::B, cb)
    }
}

/// Computes the length of a polygon's longest edge, and two border points for halving, numbered as in
/// [`Polygon::divided`].
///
/// A line between these points crosses the edge and halves the polygon.
fn halving(p: &Polygon) -> (f64, [u16; 2]) {
    let v = p.rounded();
    let n = v.len();
    let length = |i: usize| (v[(i + 1) % n] - v[i]).length();
    let longest = (0..n)
        .max_by(|i, j| length(*i).total_cmp(&length(*j)).then(j.cmp(i)))
        .unwrap_or(0);
    // The first point is the middle of edge i; the second is the vertex or the middle of an edge halfway
    // around.
    let from = 2 * longest + 1;
    (
        length(longest),
        [from as u16, ((from + n) % (2 * n)) as u16],
    )
}
