//! A view cell and what is asked from it: whether any of some polygons is seen from anywhere in a box.
//!
//! Every segment that leaves the box crosses one of its faces, so the faces are asked, and of those the ones turned to
//! the target. How a whole cell is decided with such queries is in [`crate::decide`].

use std::cmp::Ordering;

use glam::{DVec3, Vec3};

use crate::evidence::faces;
use crate::frame::Source;
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::proof::Proof;
use crate::query::{Cost, Limits, Reason, Verdict, sightlines_until};

/// What is known of a triangle or box after a query.
#[derive(Clone, Debug)]
pub enum Found {
    /// Seen, along this segment from the cell.
    Visible(Box<[Source; 2]>),
    /// Hidden from each of the cell's faces, with the proofs in the order of [`crate::evidence::Hidden::proofs`].
    Hidden(Vec<Proof>),
    /// Neither.
    Undecided(Reason),
}

/// A view cell: a box in world space.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    min: Vec3,
    max: Vec3,
}

impl Cell {
    /// The box between two corners; none if it is empty, flat or not finite: a face without area is seen through by no open set of
    /// lines.
    pub fn new(min: Vec3, max: Vec3) -> Option<Self> {
        (min.cmplt(max).all() && min.is_finite() && max.is_finite()).then_some(Self { min, max })
    }

    /// Least and greatest corner.
    pub fn corners(&self) -> [Vec3; 2] {
        [self.min, self.max]
    }

    /// All eight corners.
    pub fn all_corners(&self) -> [Vec3; 8] {
        let ends = self.corners();
        std::array::from_fn(|k| Vec3::new(ends[k & 1].x, ends[k >> 1 & 1].y, ends[k >> 2].z))
    }

    /// Whether a closed box has a point in common with the closed cell.
    pub fn touches(&self, [min, max]: [Vec3; 2]) -> bool {
        min.cmple(self.max).all() && max.cmpge(self.min).all()
    }

    /// How large a box looks from the cell: its surface over the square of its distance, to compare with others.
    pub fn size_of(&self, min: Vec3, max: Vec3) -> f64 {
        let [lo, hi, min, max] = [self.min, self.max, min, max].map(|v| v.as_dvec3());
        let d = max - min;
        let apart = (min - hi).max(lo - max).max(DVec3::ZERO);
        // Half the cell's size, so that nothing is infinitely large.
        let near = apart.length_squared() + 0.25 * (hi - lo).length_squared();
        (d.x * d.y + d.y * d.z + d.z * d.x) / near
    }
}

/// Whether any of the targets, which do not meet the cell, is seen from it; from what is not on the side `hidden` of the plane of
/// a single one, if they are known to be hidden from there. Undecided beyond the limits, and where `stop`,
/// asked before every region, says so.
pub fn from_cell(
    scene: &Occluders,
    cell: Cell,
    (targets, hidden): (&[Polygon], Option<Ordering>),
    (limits, stop): (&Limits, &dyn Fn() -> bool),
    cost: &mut Cost,
) -> Found {
    let mut proofs = Vec::new();
    let mut open = None;
    for (axis, up) in faces() {
        let at = f64::from(if up { cell.max[axis] } else { cell.min[axis] });
        // Lines that leave through this face go to what is beyond it.
        let beyond: Vec<Polygon> = targets
            .iter()
            .filter(|t| t.rounded().iter().any(|p| if up { p[axis] > at } else { p[axis] < at }))
            .cloned()
            .collect();
        let face = face(cell.min, cell.max, axis, up);
        for target in beyond {
            let from = match hidden {
                None => Some(face.clone()),
                Some(side) => face.part(&target.plane(), &target.sides(&face), side.reverse()),
            };
            let Some(outer) = outer_part(&target, &face, axis, up, at) else { continue };
            // A face that is wholly on the hidden side has a proof of nothing, so that proofs are numbered alike.
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

/// What of a polygon is on the outer side of a face of a box.
fn outer_part(target: &Polygon, face: &Polygon, axis: usize, up: bool, at: f64) -> Option<Polygon> {
    let inner = |p: &DVec3| if up { p[axis] < at } else { p[axis] > at };
    if !target.rounded().iter().any(inner) {
        return Some(target.clone());
    }
    let sides = face.sides(target);
    // The side of the face's plane the axis points to, or away from.
    let normal = face.plane();
    let along = crate::predicates::sign(&normal[axis]);
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

/// The faces of a box that lines from the cell can enter by, without those that have no area. The two do not touch.
pub fn faces_towards(min: Vec3, max: Vec3, cell: Cell) -> Vec<Polygon> {
    let mut out = Vec::with_capacity(3);
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if max[u] <= min[u] || max[v] <= min[v] {
            continue;
        }
        if cell.min[axis] < min[axis] {
            out.push(face(min, max, axis, false));
        }
        if cell.max[axis] > max[axis] {
            out.push(face(min, max, axis, true));
        }
    }
    out
}
