//! Witnesses: segments from inside A to inside B that meet no triangle in between.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::Vec3;

use super::line::{Plane, Point, height, join, klein, plane, point, sign};
use super::{Corners, Refusal};

/// Accepts the segment from `p` to `q` as a witness that one of the polygons `b` is seen from one of `a`.
///
/// The ends must be inside a polygon each, not on its border, and no triangle may have a point on the segment, unless it
/// lies in the plane of that polygon: then all segments nearby meet none either, and they are an open set.
///
/// # Errors
/// [`Refusal::Witness`].
pub fn check_witness(
    scene: &[[Vec3; 3]],
    a: &[Corners],
    b: &[Corners],
    p: &Point,
    q: &Point,
) -> Result<(), Refusal> {
    super::check_polygons(a)?;
    super::check_polygons(b)?;
    if [p, q].iter().any(|e| sign(&e[3]) != Ordering::Greater) {
        return Err(Refusal::Witness("an end of the witness is no point".to_owned()));
    }
    let refuse = |what: &str| Err(Refusal::Witness(what.to_owned()));
    let Some(from) = a.iter().find(|c| inside(c, p)) else {
        return refuse("the witness does not begin inside A");
    };
    let Some(to) = b.iter().find(|c| inside(c, q)) else {
        return refuse("the witness does not end inside B");
    };
    let planes = [from, to].map(|c| plane([&c[0], &c[1], &c[2]]));
    if height(&planes[0], q).is_zero() || height(&planes[1], p).is_zero() {
        return refuse("the witness runs in the plane of a polygon");
    }
    let span: [(f64, f64); 3] = std::array::from_fn(|k| {
        let ends = [p, q].map(|e| around(&e[k], &e[3]));
        (ends[0].0.min(ends[1].0), ends[0].1.max(ends[1].1))
    });
    // Comparing doubles is exact: a triangle wholly beyond the segment along an axis has no point on it.
    let beyond = |t: &[Vec3; 3]| {
        (0..3).any(|k| {
            t.iter().all(|v| f64::from(v[k]) < span[k].0) || t.iter().all(|v| f64::from(v[k]) > span[k].1)
        })
    };
    for (id, t) in scene.iter().enumerate().filter(|(_, t)| !beyond(t)) {
        if meets(t, p, q, [Some(&planes[0]), Some(&planes[1])]) {
            return refuse(&format!("the witness meets triangle {id}"));
        }
    }
    Ok(())
}

/// Doubles with x/w between them, which integers confirm; infinite where none is found nearby. w > 0.
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

/// Whether a point of a polygon's plane is strictly inside it.
pub(super) fn inside(corners: &[Point], p: &Point) -> bool {
    let flat = plane([&corners[0], &corners[1], &corners[2]]);
    if !height(&flat, p).is_zero() {
        return false;
    }
    // A point off the plane makes "left of an edge" the side of a plane through that edge.
    let off: Point = std::array::from_fn(|i| if i < 3 { &p[i] + &flat[i] * &p[3] } else { p[3].clone() });
    let n = corners.len();
    let sides: Vec<Ordering> =
        (0..n).map(|i| sign(&height(&plane([&corners[i], &corners[(i + 1) % n], &off]), p))).collect();
    sides[0] != Ordering::Equal && sides.iter().all(|s| *s == sides[0])
}

/// Whether a triangle with area has a point on the segment; what touches an end and lies in that end's plane does not count.
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
    let in_plane = |f: Option<&Plane>| f.is_some_and(|f| [&a, &b, &c].iter().all(|v| height(f, v).is_zero()));
    let exempt = x == Ordering::Equal && in_plane(planes[0]) || y == Ordering::Equal && in_plane(planes[1]);
    if exempt {
        return false;
    }
    if (x, y) != (Ordering::Equal, Ordering::Equal) {
        return true;
    }
    // In one plane with the segment. Two convex sets there are apart when a line along a side of one separates them.
    let off: Point = std::array::from_fn(|i| if i < 3 { &p[i] + &own[i] * &p[3] } else { p[3].clone() });
    let apart = |from: &Point, to: &Point, these: &[&Point], others: &[&Point]| {
        let along = plane([from, to, &off]);
        let side = |v: &&Point| sign(&height(&along, v));
        let inner = these.iter().map(side).find(|s| *s != Ordering::Equal).unwrap_or(Ordering::Equal);
        // For the segment itself either side will do.
        let keeps_off = |wanted: Ordering| others.iter().all(|v| side(v) == wanted);
        match inner {
            Ordering::Equal => keeps_off(Ordering::Less) || keeps_off(Ordering::Greater),
            inner => keeps_off(inner.reverse()),
        }
    };
    let corners = [&a, &b, &c];
    let separated = apart(p, q, &[p, q], &corners)
        || [(&a, &b), (&b, &c), (&c, &a)].into_iter().any(|(s, t)| apart(s, t, &corners, &[p, q]));
    !separated
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_quotient_lies_between_the_doubles_around_it(x in any::<i64>(), w in 1..i64::MAX, up in 0usize..200) {
            let (x, w) = (IBig::from(x) << up, IBig::from(w) << (up / 2));
            let (low, high) = around(&x, &w);
            prop_assert!(low < high && low.is_finite() && high.is_finite());
            let [[n, _, _, d], [m, _, _, e]] = [low, high].map(|c| point([c, 0.0, 0.0]));
            prop_assert!(n * &w <= &x * d && m * w >= x * e);
        }
    }

    #[test]
    fn what_no_double_is_near_is_bounded_by_nothing() {
        let huge = IBig::ONE << 2000;
        assert_eq!(around(&huge, &IBig::ONE), (f64::NEG_INFINITY, f64::INFINITY));
    }
}
