//! Queries from a view cell: a query decides whether any polygon of a list is visible from any viewpoint in a
//! box.
//!
//! Every segment that leaves the box crosses one of its faces, so a query starts at each face towards the
//! target. [`crate::cells::decide()`] decides a whole cell with such queries.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_certificate::proof::Proof;
use sightline_numbers::Aabb;

use crate::cells::sources::Sources;
use crate::geometry::polygon::Polygon;
use crate::geometry::{Cell, PointOrigin};
use crate::occluders::Occluders;
use crate::search::{QueryCost, QueryLimits, UndecidedReason, Verdict, sightlines_until};

/// The answer to a query about a triangle or a box from a cell.
#[derive(Clone, Debug)]
pub enum FromCellAnswer {
    /// A target is visible along this segment, which starts in the cell and ends in the target.
    Visible(Box<[PointOrigin; 2]>),
    /// All targets are hidden from the viewpoints in the cell.
    ///
    /// The proofs are in the order of [`sightline_certificate::HiddenGroup::proofs`].
    Hidden(Vec<Proof>),
    /// The query ended undecided, for this reason.
    Undecided(UndecidedReason),
}

/// Queries whether any of the targets is visible from the viewpoints in the cell.
///
/// No target may meet the part of the cell that contains viewpoints. If `hidden` is a side, `targets` must
/// contain a single target that is already known to be hidden from that side of its plane. The function then
/// queries only the rest of the cell's surface. The answer is undecided if a query reaches a limit or `stop`
/// returns true. The function calls `stop` before every region, and adds the cost of the queries to `cost`.
pub fn from_cell(
    scene: &Occluders,
    sources: &Sources<'_>,
    targets: &[Polygon],
    hidden: Option<Ordering>,
    limits: &QueryLimits,
    stop: &dyn Fn() -> bool,
    cost: &mut QueryCost,
) -> FromCellAnswer {
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
            // For a face wholly on the hidden side, `from` is empty and the query returns an empty proof, so
            // that the proofs keep their order.
            let (verdict, took) = sightlines_until(scene, &from, &[outer], limits, stop);
            *cost += took;
            match verdict {
                Verdict::Visible(ends) => return FromCellAnswer::Visible(ends),
                Verdict::Hidden(proof) => proofs.push(proof),
                Verdict::Undecided(UndecidedReason::Stopped) => {
                    return FromCellAnswer::Undecided(UndecidedReason::Stopped);
                }
                Verdict::Undecided(reason) => open = Some(reason),
            }
        }
    }
    match open {
        Some(reason) => FromCellAnswer::Undecided(reason),
        None => FromCellAnswer::Hidden(proofs),
    }
}

/// Returns the part of `target` on the outer side of the face `face` of a box, or `None` if no such part
/// exists.
///
/// The face lies at the coordinate `at` of `axis`. The outer side is the side of larger coordinates if `up`
/// is true, and the side of smaller coordinates otherwise.
fn outer_part(target: &Polygon, face: &Polygon, axis: usize, up: bool, at: f64) -> Option<Polygon> {
    let inner = |p: &DVec3| if up { p[axis] < at } else { p[axis] > at };
    if !target.rounded().iter().any(inner) {
        return Some(target.clone());
    }
    let sides = face.sides(target);
    // The outer side of the face's plane is the side to which the axis points, or the opposite side.
    let normal = face.plane();
    let along = crate::geometry::predicates::sign(&normal[axis]);
    let keep = if up { along } else { along.reverse() };
    target.part(&normal, &sides, keep)
}

/// Returns the faces of a box through which lines from the cell can enter, except faces without area.
///
/// The box and the cell must not touch.
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
