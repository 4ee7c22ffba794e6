//! Witnesses: segments between two polygons, or from a cell to a triangle, that no triangle obstructs.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;

use super::boxes::face_plane;
use super::geometry::{Plane, Point, cut, exact, height, join, klein, plane, point, sign};
use super::polygon::{check_polygons, inside};
use super::triangles::Triangles;
use super::{Corners, Refusal};
use crate::certificate::{Witness, faces};

/// Checks that the segment from `p` to `q` shows that a polygon of `b` is visible from a polygon of `a`.
///
/// Each end must be strictly inside a polygon. No triangle may have a point on the segment, except a triangle
/// in the plane of such a polygon that touches the end there. Then all segments near this one are
/// unobstructed, too.
///
/// # Errors
/// [`Refusal::Witness`] if the segment is not a witness. [`Refusal::Polygon`] if a polygon is not valid.
pub fn check_witness(
    scene: &[[Vec3; 3]],
    a: &[Corners],
    b: &[Corners],
    p: &Point,
    q: &Point,
) -> Result<(), Refusal> {
    check_polygons(a)?;
    check_polygons(b)?;
    if [p, q].iter().any(|e| sign(&e[3]) != Ordering::Greater) {
        return Err(Refusal::Witness(
            "an end point of the witness does not have w > 0".to_owned(),
        ));
    }
    let refuse = |what: &str| Err(Refusal::Witness(what.to_owned()));
    let Some(from) = a.iter().find(|c| inside(c, p)) else {
        return refuse("the witness does not start inside A");
    };
    let Some(to) = b.iter().find(|c| inside(c, q)) else {
        return refuse("the witness does not end inside B");
    };
    let planes = [from, to].map(|c| plane([&c[0], &c[1], &c[2]]));
    if height(&planes[0], q).is_zero() || height(&planes[1], p).is_zero() {
        return refuse("the witness lies in the plane of A or B");
    }
    let span: [(f64, f64); 3] = std::array::from_fn(|k| {
        let ends = [p, q].map(|e| around(&e[k], &e[3]));
        (ends[0].0.min(ends[1].0), ends[0].1.max(ends[1].1))
    });
    // Comparisons of doubles are exact: a triangle beyond the segment along an axis has no point on it.
    let beyond = |t: &[Vec3; 3]| {
        (0..3).any(|k| {
            t.iter().all(|v| f64::from(v[k]) < span[k].0)
                || t.iter().all(|v| f64::from(v[k]) > span[k].1)
        })
    };
    for (id, t) in scene.iter().enumerate().filter(|(_, t)| !beyond(t)) {
        if meets(t, p, q, [Some(&planes[0]), Some(&planes[1])]) {
            return refuse(&format!("the witness meets triangle {id}"));
        }
    }
    Ok(())
}

/// Checks a witness that a triangle is visible from a cell. Returns the reason if the witness fails.
pub(super) fn check_cell_witness(
    scene: &Triangles<'_>,
    cell: Aabb,
    id: u32,
    witness: &Witness,
) -> Result<(), String> {
    let corners = exact(&scene.all()[id as usize]);
    let own = plane([&corners[0], &corners[1], &corners[2]]);
    let (p, q) = match witness {
        Witness::Floats([p, q]) => {
            let [p, q] = [p, q].map(|e| point(e.as_dvec3().to_array()));
            let sides = [sign(&height(&own, &p)), sign(&height(&own, &q))];
            if sides[0] == Ordering::Equal || sides[0] != sides[1].reverse() {
                return Err("the segment does not cross the plane of the triangle".to_owned());
            }
            let at = cut(&p, &q, &own);
            (p, at)
        }
        Witness::Exact(ends) => (**ends).clone().into(),
    };
    if [&p, &q].iter().any(|e| sign(&e[3]) != Ordering::Greater) {
        return Err("an end point of the segment does not have w > 0".to_owned());
    }
    let outside = |(axis, up)| sign(&height(&face_plane(cell, axis, up), &p)) == Ordering::Greater;
    if faces().any(outside) {
        return Err("the segment does not start in the cell".to_owned());
    }
    if height(&own, &p).is_zero() {
        return Err("the segment lies in the plane of the triangle".to_owned());
    }
    if !inside(&corners, &q) {
        return Err("the segment does not end inside the triangle".to_owned());
    }
    // The face through which the witness leaves the cell, if it starts on a face.
    let leaving = faces()
        .map(|(axis, up)| face_plane(cell, axis, up))
        .find(|f| height(f, &p).is_zero() && sign(&height(f, &q)) == Ordering::Greater);
    let bounds = |e: &Point| -> Aabb {
        let sides: [(f64, f64); 3] = std::array::from_fn(|k| around(&e[k], &e[3]));
        // Rounding from double to single precision moves a number by less than one unit in the last place.
        let low = |x: f64| (x as f32).next_down();
        let high = |x: f64| (x as f32).next_up();
        let [x, y, z] = sides;
        Aabb::new(
            Vec3::new(low(x.0), low(y.0), low(z.0)),
            Vec3::new(high(x.1), high(y.1), high(z.1)),
        )
    };
    for other in scene.tree().along(bounds(&p), bounds(&q)) {
        if meets(
            &scene.all()[other as usize],
            &p,
            &q,
            [leaving.as_ref(), Some(&own)],
        ) {
            return Err(format!("the segment meets triangle {other}"));
        }
    }
    Ok(())
}

/// Returns two doubles with x/w between them, confirmed in integers. Returns −∞ and ∞ if the function finds
/// no such doubles near x/w. Requires w > 0.
pub(super) fn around(x: &IBig, w: &IBig) -> (f64, f64) {
    let near = x.to_f64().value() / w.to_f64().value();
    let (mut low, mut high) = (near, near);
    for _ in 0..8 {
        (low, high) = (low.next_down(), high.next_up());
        if low.is_finite() && high.is_finite() {
            let [[n, _, _, d], [m, _, _, e]] = [low, high].map(|c| point([c, 0.0, 0.0]));
            if n * w <= x * d && m * w >= x * e {
                return (low, high);
            }
        }
    }
    (f64::NEG_INFINITY, f64::INFINITY)
}

/// Returns true if a triangle with area has a point on the segment. A triangle in one of the `planes` that
/// touches the segment only at that end (first plane: `p`, second plane: `q`) does not count.
pub(super) fn meets(t: &[Vec3; 3], p: &Point, q: &Point, planes: [Option<&Plane>; 2]) -> bool {
    let [a, b, c] = t.map(|v| point(v.as_dvec3().to_array()));
    let own = plane([&a, &b, &c]);
    if own[..3].iter().all(IBig::is_zero) {
        return false;
    }
    let (x, y) = (sign(&height(&own, p)), sign(&height(&own, q)));
    if x == y && x != Ordering::Equal {
        return false;
    }
    let line = join(p, q);
    let sides = [join(&a, &b), join(&b, &c), join(&c, &a)].map(|e| sign(&klein(&line, &e)));
    if sides.contains(&Ordering::Greater) && sides.contains(&Ordering::Less) {
        return false;
    }
    let in_plane =
        |f: Option<&Plane>| f.is_some_and(|f| [&a, &b, &c].iter().all(|v| height(f, v).is_zero()));
    let exempt =
        x == Ordering::Equal && in_plane(planes[0]) || y == Ordering::Equal && in_plane(planes[1]);
    if exempt {
        return false;
    }
    if (x, y) != (Ordering::Equal, Ordering::Equal) {
        return true;
    }
    // The triangle is in one plane with the segment. Two convex sets there are disjoint if and only if a line
    // along a side of one of them separates them.
    let off: Point = std::array::from_fn(|i| {
        if i < 3 {
            &p[i] + &own[i] * &p[3]
        } else {
            p[3].clone()
        }
    });
    let apart = |from: &Point, to: &Point, these: &[&Point], others: &[&Point]| {
        let along = plane([from, to, &off]);
        let side = |v: &&Point| sign(&height(&along, v));
        let inner = these
            .iter()
            .map(side)
            .find(|s| *s != Ordering::Equal)
            .unwrap_or(Ordering::Equal);
        // For the line along the segment itself, either side suffices.
        let keeps_off = |wanted: Ordering| others.iter().all(|v| side(v) == wanted);
        match inner {
            Ordering::Equal => keeps_off(Ordering::Less) || keeps_off(Ordering::Greater),
            inner => keeps_off(inner.reverse()),
        }
    };
    let corners = [&a, &b, &c];
    let separated = apart(p, q, &[p, q], &corners)
        || [(&a, &b), (&b, &c), (&c, &a)]
            .into_iter()
            .any(|(s, t)| apart(s, t, &corners, &[p, q]));
    !separated
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn quotient_lies_between_bounds(x in any::<i64>(), w in 1..i64::MAX, up in 0usize..200) {
            let (x, w) = (IBig::from(x) << up, IBig::from(w) << (up / 2));
            let (low, high) = around(&x, &w);
            prop_assert!(low < high && low.is_finite() && high.is_finite());
            let [[n, _, _, d], [m, _, _, e]] = [low, high].map(|c| point([c, 0.0, 0.0]));
            prop_assert!(n * &w <= &x * d && m * w >= x * e);
        }
    }

    #[test]
    fn quotient_beyond_doubles_has_infinite_bounds() {
        let huge = IBig::ONE << 2000;
        assert_eq!(
            around(&huge, &IBig::ONE),
            (f64::NEG_INFINITY, f64::INFINITY)
        );
    }
}
