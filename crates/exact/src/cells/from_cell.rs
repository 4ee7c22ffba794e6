//! Queries from a view cell: whether any of some polygons is seen from any point of a box.
//!
//! Every segment that leaves the box crosses one of its faces, so a query starts at each face that faces the
//! target. [`crate::cells::decide()`] decides a whole cell with such queries.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_certificate::proof::Proof;
use sightline_numbers::Aabb;

use crate::cells::sources::Sources;
use crate::geometry::polygon::Polygon;
use crate::geometry::{Cell, Source};
use crate::occluders::Occluders;
use crate::search::{Cost, Limits, Reason, Verdict, sightlines_until};

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

/// Whether any of the targets is seen from where viewpoints are in the cell, where none may meet it. With
/// `hidden`, a single target is known to be hidden from that side of its plane, and only the rest of the
/// cell's surface is queried. Undecided at the limits, and when `stop`, called before every region, returns
/// true.
pub fn from_cell(
    scene: &Occluders,
    sources: &Sources<'_>,
    (targets, hidden): (&[Polygon], Option<Ordering>),
    (limits, stop): (&Limits, &dyn Fn() -> bool),
    cost: &mut Cost,
) -> Found {
    let bounds @ Aabb { min, max } = sources.cell().bounds();
    let mut proofs = Vec::new();
    let mut open = None;
    for ((axis, up), parts) in sources.faces() {
        if parts.is_empty() {
            continue;
        }
        let at = f64::from(if up { max[axis] } else { min[axis] });
        // Lines that leave through this face reach only targets beyond its plane.
        let beyond: Vec<Polygon> = targets
            .iter()
            .filter(|t| {
                t.rounded()
                    .iter()
                    .any(|p| if up { p[axis] > at } else { p[axis] < at })
            })
            .cloned()
            .collect();
        let face = Polygon::face_of(bounds, axis, up);
        for target in beyond {
            let from = match hidden {
                None => parts.to_vec(),
                Some(side) => {
                    let plane = target.plane();
                    let beyond = |p: &Polygon| p.part(&plane, &target.sides(p), side.reverse());
                    parts.iter().filter_map(beyond).collect()
                }
            };
            let Some(outer) = outer_part(&target, &face, axis, up, at) else {
                continue;
            };
            // A face wholly on the hidden side gets an empty proof, so that the proofs keep their order.
            let (verdict, took) = sightlines_until(scene, (&from, &[outer]), limits, stop);
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

/// The faces of a box through which lines from the cell can enter, except faces without area. Box and cell
/// must not touch.
pub fn faces_towards(min: Vec3, max: Vec3, cell: Cell) -> Vec<Polygon> {
    let [lo, hi] = cell.corners();
    let bounds = Aabb { min, max };
    let mut out = Vec::with_capacity(3);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if max[u] <= min[u] || max[v] <= min[v] {
            continue;
        }
        if lo[axis] < min[axis] {
            out.push(Polygon::face_of(bounds, axis, false));
        }
        if hi[axis] > max[axis] {
            out.push(Polygon::face_of(bounds, axis, true));
        }
    }
    out
}
