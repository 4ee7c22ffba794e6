//! The parts of two polygons between which lines run: each part lies on one side of the other polygon's
//! plane.

use std::cmp::Ordering;

use super::polygon::Polygon;

/// A polygon, and the side of the other polygon's plane on which each of its corners lies.
pub type SidedPolygon = (Polygon, Vec<Ordering>);

/// Cuts `a` and `b` along each other's planes and returns the pairs of a part of `a` and a part of `b`.
///
/// The result is empty if both polygons lie in one plane, because the lines in that plane do not form an open
/// set.
pub fn parts(a: &Polygon, b: &Polygon) -> Vec<[SidedPolygon; 2]> {
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
