//! The choice of the plane that splits a leaf (Teller 1992, section 5.2.1).
//!
//! The best plane is the plane whose triangles cover most of its section with the leaf ("obscuration"). Among
//! planes with equal cover, a plane is better if it cuts few triangles ("cleaving") and leaves about as many
//! on either side. The choice affects the time of the search for walls and the number of leaves, never the
//! correctness of an answer, so its arithmetic is rounded.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use glam::DVec3;

use crate::plane::{Plane, PlaneId};
use crate::tree::{Fragment, Leaf, LeafId, Tree};

/// The maximum number of planes of a leaf that the choice compares: the planes with the largest area of
/// triangles.
const COMPARED: usize = 12;
/// The maximum number of triangles of a leaf, spread evenly, that the choice classifies against each compared
/// plane.
const TRIED: usize = 256;
/// The weight of the fraction of cut triangles, against the covered fraction of a section.
const CLEAVING: f64 = 0.3;

/// The weight of an uneven split, against the covered fraction of a section.
const UNEVEN: f64 = 0.1;
/// The maximum distance of a wall's corner from the plane of one of its triangles.
///
/// The distance is a fraction of the largest magnitude of a coordinate of the tree's box.
///
/// The value is sixteen roundings to single precision, because a plane through rounded corners is farther off
/// elsewhere.
const ROUNDED: f64 = 1.0 / (1 << 20) as f64;

/// A plane that may split a leaf, with its merit, which is at most 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatedPlane {
    /// The plane.
    pub plane: PlaneId,
    /// The covered fraction of the plane's section with the leaf, less penalties for cut triangles and uneven
    /// splits.
    pub merit: f64,
    /// The area of the plane's section with the leaf, as a fraction of the most parallel face of the tree's
    /// box.
    pub section: f64,
}

/// Finds the plane with the highest merit for a leaf, or returns `None` if the leaf has no detail.
///
/// A wall whose corners were rounded has triangles in many planes. All triangles that are in a plane up to
/// rounding count as triangles that cover the plane. If a leaf has been split along one of a wall's planes,
/// the other planes of the wall follow, regardless of the area that each covers.
pub fn best_plane(tree: &Tree, leaf: LeafId) -> Option<RatedPlane> {
    let Leaf { detail, begun, .. } = tree.leaf(leaf);
    let mut areas: BTreeMap<PlaneId, f64> = BTreeMap::new();
    for fragment in detail
        .iter()
        .filter(|f| begun.is_empty() || begun.binary_search(&f.plane).is_ok())
    {
        *areas.entry(fragment.plane).or_default() += fragment.face.area();
    }
    let mut areas: Vec<(PlaneId, f64)> = areas.into_iter().collect();
    areas.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    areas.truncate(if begun.is_empty() { COMPARED } else { 1 });
    let merit = |(plane, _): &(PlaneId, f64)| {
        let exact = tree.planes().plane(*plane);
        let rounded = section_area(tree, leaf, exact);
        // Because of rounding, the computed area of a small section can be 0.
        let size = if rounded > 0.0 {
            rounded
        } else {
            tree.section(leaf, *plane)?.area()
        };
        let section = size / face_of_box(tree, exact.axis());
        if !begun.is_empty() {
            return Some(RatedPlane {
                plane: *plane,
                merit: 1.0,
                section,
            });
        }
        let near = near(tree);
        let area: f64 = detail
            .iter()
            .filter(|f| is_near(f, exact, near))
            .map(|f| f.face.area())
            .sum();
        let covered = (area / size).min(1.0);
        let (cut, uneven) = balance(detail, *plane, exact);
        let merit = covered - CLEAVING * cut - UNEVEN * uneven;
        let merit = if merit.is_finite() { merit } else { -1.0 };
        Some(RatedPlane {
            plane: *plane,
            merit,
            section,
        })
    };
    let better = |best: Option<RatedPlane>, c: RatedPlane| match best {
        Some(best) if c.merit.total_cmp(&best.merit) != Ordering::Greater => Some(best),
        _ => Some(c),
    };
    areas.iter().filter_map(merit).fold(None, better)
}

/// Computes twice the rounded area of the section of a plane with a leaf.
fn section_area(tree: &Tree, leaf: LeafId, plane: &Plane) -> f64 {
    let ([lo, hi], axis) = (
        [tree.bounds().min, tree.bounds().max].map(|p| p.as_dvec3()),
        plane.axis(),
    );
    let (n, level) = (plane.normal(), plane.rounded()[3]);
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |at_u: f64, at_v: f64| {
        let mut p = DVec3::ZERO;
        (p[u], p[v]) = (at_u, at_v);
        p[axis] = (level - n[u] * at_u - n[v] * at_v) / n[axis];
        p
    };
    let mut polygon = vec![
        corner(lo[u], lo[v]),
        corner(hi[u], lo[v]),
        corner(hi[u], hi[v]),
        corner(lo[u], hi[v]),
    ];
    let mut cut = Vec::new();
    keep(&mut polygon, &mut cut, |p| p[axis] - lo[axis]);
    keep(&mut polygon, &mut cut, |p| hi[axis] - p[axis]);
    for (wall, side) in &tree.leaf(leaf).walls {
        let (wall, up) = (
            tree.planes().plane(*wall),
            if side.is_gt() { 1.0 } else { -1.0 },
        );
        let (n, level) = (wall.normal(), wall.rounded()[3]);
        keep(&mut polygon, &mut cut, |p| (n.dot(*p) - level) * up);
    }
    let first = polygon.first().copied().unwrap_or_default();
    polygon
        .windows(2)
        .map(|w| (w[0] - first).cross(w[1] - first))
        .sum::<DVec3>()
        .length()
}

/// Cuts off the part of a convex polygon where `height` is negative. `cut` is a reusable buffer.
fn keep(polygon: &mut Vec<DVec3>, cut: &mut Vec<DVec3>, height: impl Fn(&DVec3) -> f64) {
    cut.clear();
    let n = polygon.len();
    for i in 0..n {
        let (p, q) = (polygon[i], polygon[(i + 1) % n]);
        let (at_p, at_q) = (height(&p), height(&q));
        if at_p >= 0.0 {
            cut.push(p);
        }
        if (at_p >= 0.0) != (at_q >= 0.0) {
            cut.push(p + (q - p) * (at_p / (at_p - at_q)));
        }
    }
    std::mem::swap(polygon, cut);
}

/// Splits a leaf along a wall and returns the upper half, as [`Tree::split`] does for a plane.
///
/// Other triangles of the wall are in the plane only up to rounding. The halves record the planes of these
/// triangles in [`Leaf::begun`], and later splits use them first. The record includes all triangles in the
/// thin leaves between such planes, also the ends of other walls, which close these leaves off.
///
/// # Panics
/// If the plane does not divide the leaf.
pub fn split_wall(tree: &mut Tree, leaf: LeafId, plane: PlaneId) -> LeafId {
    let (exact, near) = (tree.planes().plane(plane), near(tree));
    let Leaf { detail, begun, .. } = tree.leaf(leaf);
    let of_wall = detail
        .iter()
        .filter(|f| f.plane != plane && is_near(f, exact, near))
        .map(|f| f.plane);
    let mut planes: Vec<PlaneId> = of_wall.chain(begun.iter().copied()).collect();
    planes.sort_unstable();
    planes.dedup();
    let upper = tree.split(leaf, plane);
    [leaf, upper]
        .into_iter()
        .for_each(|half| tree.set_begun(half, &planes));
    upper
}

/// Returns the maximum distance of a wall's corners from the wall's plane.
fn near(tree: &Tree) -> f64 {
    ROUNDED
        * f64::from(
            tree.bounds()
                .min
                .abs()
                .max(tree.bounds().max.abs())
                .max_element(),
        )
}

/// Returns true if a fragment is in a plane up to rounding.
fn is_near(fragment: &Fragment, plane: &Plane, near: f64) -> bool {
    fragment
        .face
        .corners()
        .iter()
        .all(|c| plane.distance(*c).abs() <= near)
}

/// Returns twice the area of a face of the tree's box perpendicular to `axis`. Polygon areas have the same
/// factor.
fn face_of_box(tree: &Tree, axis: usize) -> f64 {
    let size = tree.bounds().max.as_dvec3() - tree.bounds().min.as_dvec3();
    2.0 * size[(axis + 1) % 3] * size[(axis + 2) % 3]
}

/// Computes the fraction of the triangles that a plane cuts, and the difference between the numbers of
/// triangles on its two sides, as a fraction of all triangles. The function inspects at most [`TRIED`]
/// triangles.
fn balance(detail: &[Fragment], id: PlaneId, plane: &Plane) -> (f64, f64) {
    let step = detail.len().div_ceil(TRIED).max(1);
    let (mut below, mut above, mut cut, mut all) = (0.0f64, 0.0f64, 0.0, 0.0);
    for fragment in detail.iter().step_by(step).filter(|f| f.plane != id) {
        let far = |p: &DVec3| plane.distance(*p);
        let (min, max) = fragment
            .face
            .corners()
            .iter()
            .map(far)
            .fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(d), b.max(d)));
        // Because of rounding, corners in the plane can seem to be off the plane. Ignore up to a thousandth
        // of the triangle's extent.
        let slack = 1e-3 * (max - min);
        all += 1.0;
        match (min < -slack, max > slack) {
            (true, true) => cut += 1.0,
            (_, true) => above += 1.0,
            _ => below += 1.0,
        }
    }
    if all > 0.0 {
        (cut / all, (below - above).abs() / all)
    } else {
        (0.0, 0.0)
    }
}
