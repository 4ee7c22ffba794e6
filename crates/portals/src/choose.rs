//! Which plane splits a leaf (Teller 1992, section 5.2.1).
//!
//! The plane whose triangles cover most of its section with the leaf ("obscuration") comes first; among
//! planes that cover as much, one that cuts few triangles ("cleaving") and leaves about as many on either
//! side. The choice decides how fast an enclosure is found and how many leaves it has, never whether an
//! answer is right, so its arithmetic is rounded.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use glam::DVec3;

use crate::plane::{Plane, PlaneId};
use crate::tree::{Fragment, LeafId, Tree};

/// Planes of a leaf that are compared, those with the largest area of triangles.
const COMPARED: usize = 12;
/// Triangles that are put on a side of each of these planes, evenly over the leaf.
const TRIED: usize = 256;
/// How much a cut triangle and an uneven split count against a covered section.
const CLEAVING: f64 = 0.3;
const UNEVEN: f64 = 0.1;

/// A plane for a leaf, and how good it is: at most 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The plane.
    pub plane: PlaneId,
    /// The covered part of its section with the leaf, less what it cuts.
    pub merit: f64,
    /// The area of the section as a fraction of the face of the tree's box that is most parallel to it.
    pub section: f64,
}

/// The best plane for a leaf with detail.
pub fn best_plane(tree: &Tree, leaf: LeafId) -> Option<Choice> {
    let detail = &tree.leaf(leaf).detail;
    let mut areas: BTreeMap<PlaneId, f64> = BTreeMap::new();
    for fragment in detail {
        *areas.entry(fragment.plane).or_default() += fragment.face.area();
    }
    let mut areas: Vec<(PlaneId, f64)> = areas.into_iter().collect();
    areas.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    areas.truncate(COMPARED);
    let merit = |(plane, area): &(PlaneId, f64)| {
        let section = tree.section(leaf, *plane)?;
        let size = section.area();
        let covered = (area / size).min(1.0);
        let exact = tree.planes().plane(*plane);
        let (cut, uneven) = balance(detail, *plane, exact);
        let merit = covered - CLEAVING * cut - UNEVEN * uneven;
        let merit = if merit.is_finite() { merit } else { -1.0 };
        Some(Choice { plane: *plane, merit, section: size / face_of_box(tree, exact.axis()) })
    };
    let better = |best: Option<Choice>, c: Choice| match best {
        Some(best) if c.merit.total_cmp(&best.merit) != Ordering::Greater => Some(best),
        _ => Some(c),
    };
    areas.iter().filter_map(merit).fold(None, better)
}

/// Twice the area of the face of the tree's box across an axis.
fn face_of_box(tree: &Tree, axis: usize) -> f64 {
    let size = tree.bounds().max.as_dvec3() - tree.bounds().min.as_dvec3();
    2.0 * size[(axis + 1) % 3] * size[(axis + 2) % 3]
}

/// The fraction of the triangles that a plane cuts, and of those by which its sides differ.
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
        // Rounding makes corners in the plane look cut; a thousandth of the triangle is no cut.
        let slack = 1e-3 * (max - min);
        all += 1.0;
        match (min < -slack, max > slack) {
            (true, true) => cut += 1.0,
            (_, true) => above += 1.0,
            _ => below += 1.0,
        }
    }
    if all > 0.0 { (cut / all, (below - above).abs() / all) } else { (0.0, 0.0) }
}
