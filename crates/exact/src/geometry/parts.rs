//! The parts of two polygons between which lines run: each part lies on one side of the other polygon's
//! plane.

use std::cmp::Ordering;

use super::polygon::Polygon;

/// A polygon, and on which side of the other polygon's plane each of its corners is.
pub type Part = (Polygon, Vec<Ordering>);

/// The pairs of parts of `a` and `b`. Empty when both lie in one plane: the lines in that plane are no open
/// set.
pub fn parts(a: &Polygon, b: &Polygon) -> Vec<[Part; 2]> {
    let (of_a, of_b) = (b.sides(a), a.sides(b));
    let mut out = Vec::new();
    for side_a in [Ordering::Greater, Ordering::Less] {
        for side_b in [Ordering::Greater, Ordering::Less] {
            let cut = |p: &Polygon, other: &Polygon, sides: &[Ordering], keep: Ordering| {
                if sides.contains(&keep.reverse()) && sides.contains(&keep) {
                    let part = p.part(&other.plane(), sides, keep)?;
                    let sides = other.sides(&part);
                    Some((part, sides))
                } else {
                    sides.contains(&keep).then(|| (p.clone(), sides.to_vec()))
                }
            };
            if let (Some(x), Some(y)) = (cut(a, b, &of_a, side_a), cut(b, a, &of_b, side_b)) {
                out.push([x, y]);
            }
        }
    }
    out
}
