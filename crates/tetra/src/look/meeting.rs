//! What happens where a beam meets a triangle: it is divided along the triangle's edges, and along the line
//! where the triangle comes in front of the cap.

use super::beam::{self, Edge, Place};
use super::planes::{Facing, Planes, Side};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, NO_HINT};
use super::view::{Mode, Seen};
use super::within::Limits;
use crate::surfaces::BLOCKS;

impl Search<'_> {
    /// Meets a triangle. Says whether the beam was divided, and its parts are on the stack.
    pub(super) fn meet(
        &mut self,
        beam: &mut Beam,
        cap: &mut Option<Facing>,
        triangle: u32,
    ) -> bool {
        let points = self.points(triangle);
        let eye = &self.eye;
        // In its plane: an edge of it is all that could be seen.
        let Some(facing) = Facing::of(eye, points) else {
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
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Inside => {}
                Place::Both => {
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
        // The part in the triangle, and the parts beside it.
        rings.inside.clear();
        rings.inside.extend_from_slice(&beam.ring);
        let mut parts = 0;
        for (side, cuts) in sides {
            if !cuts {
                continue;
            }
            match beam::place(planes, eye, &rings.inside, side, &mut rings.signs) {
                Place::Inside => {}
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Both => {
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
                Place::Outside => {
                    planes.list.truncate(made);
                    return false;
                }
                Place::Inside => level = rings.signs.iter().all(|s| *s == 0),
                Place::Both => {
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
        let keep =
            |ring: &[Edge], seen: &mut Seen| keep(self.mode, planes, ring, &self.limits, seen);
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

    /// A beam that is not cut meets a triangle that overlaps it.
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
            (_, Place::Outside) => {}
            (true, Place::Inside) if level => beam.caps.push(triangle),
            (true, Place::Inside) => {
                // All of an earlier cap is behind this one.
                beam.caps.clear();
                beam.caps.push(triangle);
                *cap = Some(*facing);
            }
            _ => beam.met.push(triangle),
        }
    }

    /// Where a beam is on the nearer side of a face, seen from its cap, and whether both are in one plane.
    pub(super) fn against(
        &mut self,
        beam: &Beam,
        cap: Option<&Facing>,
        facing: &Facing,
    ) -> (Place, bool) {
        let Some(cap) = cap else {
            return (Place::Inside, false);
        };
        if cap.has_points_of(facing) {
            return (Place::Inside, true);
        }
        let Scratch { planes, rings, .. } = &mut *self.scratch;
        let made = planes.list.len();
        let side = planes.add(cap.meet(facing));
        let place = beam::place(planes, &self.eye, &beam.ring, side, &mut rings.signs);
        planes.list.truncate(made);
        (place, rings.signs.iter().all(|s| *s == 0))
    }
}

/// Whether a part of a beam is to be followed, and whether it is cut any further. What is dropped is counted.
pub(super) fn keep(
    mode: Mode,
    planes: &Planes,
    ring: &[Edge],
    limits: &Limits,
    seen: &mut Seen,
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
