//! The division of a beam by a triangle.
//!
//! The beam is divided along the triangle's edges, and along the line where the planes of the triangle and
//! the cap meet.

use super::beam::{self, BeamSide, Edge};
use super::planes::{Facing, Planes, Side};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, NO_HINT};
use super::view::{Mode, VisibleTriangles};
use super::view_limits::ViewLimits;
use crate::surfaces::BLOCKS;

impl Search<'_> {
    /// Processes a pending triangle of a beam. Returns true if the beam was divided and its parts are on the
    /// stack.
    pub(super) fn meet(
        &mut self,
        beam: &mut Beam,
        cap: &mut Option<Facing>,
        triangle: u32,
    ) -> bool {
        let points = self.points(triangle);
        let eye = &self.eye;
        // If the viewpoint is in the triangle's plane, the triangle covers no open set of directions.
        let Some(facing) = Facing::new(eye, points) else {
            return false;
        };
        let Scratch {
            planes,
            stack,
            rings,
            seen,
            entered,
            ..
        } = &mut *self.scratch;
        let ways = facing.points.map(|p| eye.to(p));
        let beside = |edge: &Edge| {
            let n = planes.normal(edge.side);
            ways.iter().all(|w| n.dot(w).sign() == Some(-1))
        };
        if beam.ring.iter().any(beside) {
            return false;
        }
        if cap.is_some_and(|cap| cap.hides(&ways)) {
            return false;
        }
        let made = planes.list.len();
        let [a, b, c] = facing.points;
        let mut covered = true;
        let mut sides = [(Side::new(0, false), false); 3];
        for ((side, cuts), (a, b)) in sides.iter_mut().zip([(a, b), (b, c), (c, a)]) {
            *side = planes.add_edge(eye, a, b);
            match beam::place(planes, eye, &beam.ring, *side, &mut rings.signs) {
                BeamSide::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                BeamSide::Inside => {}
                BeamSide::Both => {
                    covered = false;
                    *cuts = true;
                }
            }
        }
        if self.scene.flags[triangle as usize] & BLOCKS == 0 {
            planes.list.truncate(made);
            beam.met.push(triangle);
            return false;
        }
        if beam.whole {
            planes.list.truncate(made);
            self.meet_whole(beam, cap, triangle, &facing, covered);
            return false;
        }
        // The part in the triangle, and the parts outside of each edge.
        rings.inside.clear();
        rings.inside.extend_from_slice(&beam.ring);
        let mut parts = 0;
        for (side, cuts) in sides {
            if !cuts {
                continue;
            }
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                BeamSide::Inside => {}
                BeamSide::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                BeamSide::Both => {
                    let out = &mut rings.out[parts];
                    beam::cut(
                        planes,
                        eye,
                        &rings.inside,
                        side,
                        &rings.signs,
                        &mut rings.next,
                        out,
                    );
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                    parts += 1;
                }
            }
        }
        let mut far = false;
        let mut level = cap.is_some_and(|cap| cap.has_points_of(&facing));
        if let Some(cap) = cap.filter(|cap| !cap.has_points_of(&facing)) {
            let side = planes.add(cap.meet(&facing));
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                BeamSide::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                BeamSide::Inside => level = rings.signs.iter().all(|s| *s == 0),
                BeamSide::Both => {
                    let signs = &rings.signs;
                    beam::cut(
                        planes,
                        eye,
                        &rings.inside,
                        side,
                        signs,
                        &mut rings.next,
                        &mut rings.far,
                    );
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                    far = true;
                }
            }
        }
        if parts == 0 && !far {
            if level {
                beam.caps.push(triangle);
            } else {
                beam.caps.clear();
                beam.caps.push(triangle);
                *cap = Some(facing);
            }
            return false;
        }
        let made = (planes.list.len(), entered.len());
        beam.hint = NO_HINT;
        let keep = |ring: &[Edge], seen: &mut VisibleTriangles| {
            keep(self.mode, planes, ring, &self.limits, seen)
        };
        for out in &rings.out[..parts] {
            if let Some(whole) = keep(out, seen) {
                stack.push(beam, out, &beam.caps, whole, made);
            }
        }
        if far && let Some(whole) = keep(&rings.far, seen) {
            stack.push(beam, &rings.far, &beam.caps, whole, made);
        }
        if let Some(whole) = keep(&rings.inside, seen) {
            if level {
                beam.caps.push(triangle);
            } else {
                beam.caps.clear();
                beam.caps.push(triangle);
            }
            stack.push(beam, &rings.inside, &beam.caps, whole, made);
        }
        true
    }

    /// Processes a triangle that may overlap a beam which is not cut any further. `covered` is true if the
    /// triangle covers the whole beam.
    fn meet_whole(
        &mut self,
        beam: &mut Beam,
        cap: &mut Option<Facing>,
        triangle: u32,
        facing: &Facing,
        covered: bool,
    ) {
        let (place, level) = self.against(beam, cap.as_ref(), facing);
        match (covered, place) {
            (_, BeamSide::Outside) => {}
            (true, BeamSide::Inside) if level => beam.caps.push(triangle),
            (true, BeamSide::Inside) => {
                // The previous cap is completely behind this triangle.
                beam.caps.clear();
                beam.caps.push(triangle);
                *cap = Some(*facing);
            }
            _ => beam.met.push(triangle),
        }
    }

    /// Compares the planes of a face and of a beam's cap.
    ///
    /// Returns `Inside` if the face is nearer in the whole beam or if the beam has no cap, `Outside` if the
    /// face is not nearer in any part of the beam, and otherwise `Both`. The flag is true if cap and face are
    /// in one plane; the position is then `Inside`.
    pub(super) fn against(
        &mut self,
        beam: &Beam,
        cap: Option<&Facing>,
        facing: &Facing,
    ) -> (BeamSide, bool) {
        let Some(cap) = cap else {
            return (BeamSide::Inside, false);
        };
        if cap.has_points_of(facing) {
            return (BeamSide::Inside, true);
        }
        let Scratch { planes, rings, .. } = &mut *self.scratch;
        let made = planes.list.len();
        let side = planes.add(cap.meet(facing));
        let place = beam::place(planes, &self.eye, &beam.ring, side, &mut rings.signs);
        planes.list.truncate(made);
        (place, rings.signs.iter().all(|s| *s == 0))
    }
}

/// Decides about a part of a beam by the mode. Returns `None` if the search drops the part, true if the
/// search does not cut the part any further, and false otherwise.
///
/// Adds the solid angle of a dropped part to `seen.dropped`.
pub(super) fn keep(
    mode: Mode,
    planes: &Planes,
    ring: &[Edge],
    limits: &ViewLimits,
    seen: &mut VisibleTriangles,
) -> Option<bool> {
    match mode {
        Mode::Exact => Some(false),
        Mode::Aggressive(angle) => {
            if beam::widths(planes, ring).0 >= libm::sin(angle.min(std::f64::consts::FRAC_PI_2)) {
                return Some(false);
            }
            seen.dropped += limits.areas(ring, None).0.unwrap_or_default();
            None
        }
        Mode::Conservative(angle) => Some(
            beam::widths(planes, ring).1 < 2.0 * libm::sin(angle.min(std::f64::consts::PI) / 2.0),
        ),
    }
}
