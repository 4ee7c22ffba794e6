//! Queries from a view cell: whether any of some polygons is seen from any point of a box.
//!
//! Every segment that leaves the box crosses one of its faces, so a query starts at each face that faces the
//! target. [`crate::cells::decide()`] decides a whole cell with such queries.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};

use crate::geometry::polygon::Polygon;
use crate::geometry::{Cell, Source};
use crate::occluders::Occluders;
use crate::search::{Cost, Limits, Reason, Verdict, sightlines_until};
use sightline_certificate::certificate::faces;
use sightline_certificate::proof::Proof;

/// The answer to a query about a triangle or a box from a cell.
#[derive(Clone, Debug)]
pub enum Found {
    /// Seen, along this segment from the cell.
    Visible(Box<[Source; 2]>),
    /// Hidden from each of the cell's faces, with the proofs in the order of
    /// [`sightline_certificate::HiddenGroup::proofs`].
    Hidden(Vec<Proof>),
    /// Undecided, with the reason.
    Undecided(Reason),
}

/// Whether any of the targets is seen from the cell. No target may meet the cell. With `hidden`, a single
/// target is known to be hidden from that side of its plane, and only the rest of the cell's surface is
/// queried. Undecided at the limits, and when `stop`, called before every region, returns true.
pub fn from_cell(
    scene: &Occluders,
    cell: Cell,
    (targets, hidden): (&[Polygon], Option<Ordering>),
    (limits, stop): (&Limits, &dyn Fn() -> bool),
    cost: &mut Cost,
) -> Found {
    let [min, max] = cell.corners();
    let mut proofs = Vec::new();
    let mut open = None;
    for (axis, up) in faces() {
        let at = f64::from(if up { max[axis] } else { min[axis] });
        // Lines that leave through this face reach only targets beyond its plane.
        let beyond: Vec<Polygon> = targets
            .iter()
            .filter(|t| t.rounded().iter().any(|p| if up { p[axis] > at } else { p[axis] < at }))
            .cloned()
            .collect();
        let face = face(min, max, axis, up);
        for target in beyond {
            let from = match hidden {
                None => Some(face.clone()),
                Some(side) => face.part(&target.plane(), &target.sides(&face), side.reverse()),
            };
            let Some(outer) = outer_part(&target, &face, axis, up, at) else { continue };
            // A face wholly on the hidden side gets an empty proof, so that the proofs keep their order.
            let (verdict, took) = sightlines_until(scene, (from.as_slice(), &[outer]), limits, stop);
            *cost += took;
            match verdict {
                Verdict::Visible(ends) => return Found::Visible(ends),
                Verdict::Hidden(proof) => proofs.push(proof),
                Verdict::Undecided(Reason::Stopped) => return Found::Undecided(Reason::Stopped),
                Verdict::Undecided(reason) => open = Some(reason),
            }
        }
    }
    match open {
        Some(reason) => Found::Undecided(reason),
        None => Found::Hidden(proofs),
    }
}

/// The part of a polygon on the outer side of a box's face.
fn outer_part(target: &Polygon, face: &Polygon, axis: usize, up: bool, at: f64) -> Option<Polygon> {
    let inner = |p: &DVec3| if up { p[axis] < at } else { p[axis] > at };
    if !target.rounded().iter().any(inner) {
        return Some(target.clone());
    }
    let sides = face.sides(target);
    // The outer side of the face's plane: the side to which the axis points, or the opposite side.
    let normal = face.plane();
    let along = crate::geometry::predicates::sign(&normal[axis]);
    let keep = if up { along } else { along.reverse() };
    target.part(&normal, &sides, keep)
}

/// One face of a box.
fn face(min: Vec3, max: Vec3, axis: usize, up: bool) -> Polygon {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let (lo, hi) = (min.as_dvec3(), max.as_dvec3());
    let corner = |s: bool, t: bool| {
        let mut p = lo;
        p[axis] = if up { hi[axis] } else { lo[axis] };
        p[u] = if s { hi[u] } else { lo[u] };
        p[v] = if t { hi[v] } else { lo[v] };
        p
    };
    Polygon::rectangle([corner(false, false), corner(true, false), corner(true, true), corner(false, true)])
}

/// The faces of a box through which lines from the cell can enter, except faces without area. Box and cell
/// must not touch.
pub fn faces_towards(min: Vec3, max: Vec3, cell: Cell) -> Vec<Polygon> {
    let [lo, hi] = cell.corners();
    let mut out = Vec::with_capacity(3);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if max[u] <= min[u] || max[v] <= min[v] {
            continue;
        }
        if lo[axis] < min[axis] {
            out.push(face(min, max, axis, false));
        }
        if hi[axis] > max[axis] {
            out.push(face(min, max, axis, true));
        }
    }
    out
}
