//! The end of a beam: the count of its visible triangles and solid angles.

use super::beam::{self, BeamSide};
use super::outline::Outline;
use super::planes::Facing;
use super::scratch::Scratch;
use super::search::Search;
use super::stack::Beam;
use crate::surfaces::{BLOCKS, SHOWS};

impl Search<'_> {
    /// Ends a beam: marks the triangles that are visible in the beam, and adds the beam's solid angle to the
    /// result.
    pub(super) fn end(&mut self, beam: &mut Beam, cap: Option<&Facing>) {
        self.scratch.seen.beams += 1;
        let (whole, near) = self.limits.areas(&beam.ring, cap);
        if beam
            .caps
            .iter()
            .any(|t| *t as usize >= self.scene.triangles.len())
        {
            self.of_faces += near.unwrap_or_default();
            return;
        }
        let Some(whole) = whole else { return };
        let mut undecided = false;
        for k in 0..beam.met.len() {
            let triangle = beam.met[k];
            undecided |= self.end_met(beam, cap, triangle) && self.flags(triangle) & BLOCKS != 0;
        }
        let Scratch {
            planes,
            tally,
            seen,
            ..
        } = &mut *self.scratch;
        let shows = |t: &&u32| self.scene.flags[**t as usize] & SHOWS != 0;
        if let Some(near) = near {
            for t in beam.caps.iter().filter(shows) {
                tally.see(*t);
                if !undecided {
                    let way =
                        || beam::middle(planes, &beam.ring).filter(|w| self.limits.hold(*w, cap));
                    tally.witness(*t, near, way);
                }
            }
        }
        let owner = beam.caps.iter().filter(shows).min();
        if undecided {
            seen.dropped += whole;
            return;
        }
        seen.sky += (whole - near.unwrap_or_default()).max(0.0);
        match (owner, near) {
            (Some(t), Some(near)) => tally.add(*t, near),
            (None, Some(near)) => seen.unseen += near,
            (_, None) => {}
        }
    }

    /// Returns true if a triangle of `beam.met` is visible in the beam, and marks the triangle.
    ///
    /// The triangle is visible if a part of the triangle in the beam is in front of the cap.
    fn end_met(&mut self, beam: &Beam, cap: Option<&Facing>, triangle: u32) -> bool {
        let shows = self.flags(triangle) & SHOWS != 0;
        let Some(facing) = self.facing(triangle) else {
            return false;
        };
        if beam.whole {
            let outline = Outline::new(&self.eye, self.points(triangle));
            let planes = &mut self.scratch.planes;
            let is_beside = outline.is_some_and(|o| o.is_beside(planes, &self.eye, &beam.ring));
            let seen = !is_beside && self.against(beam, cap, &facing).0 != BeamSide::Outside;
            if seen && shows {
                self.scratch.tally.see(triangle);
            }
            return seen;
        }
        let Scratch {
            planes,
            rings,
            tally,
            ..
        } = &mut *self.scratch;
        let made = planes.list.len();
        rings.inside.clear();
        rings.inside.extend_from_slice(&beam.ring);
        let [a, b, c] = facing.points;
        let mut seen = true;
        let edges = [Some((a, b)), Some((b, c)), Some((c, a)), None];
        for edge in edges {
            let side = match (edge, cap) {
                (Some((a, b)), _) => planes.add_edge(&self.eye, a, b),
                (None, Some(cap)) if !cap.has_points_of(&facing) => planes.add(cap.meet(&facing)),
                (None, _) => continue,
            };
            match beam::place(planes, &self.eye, &rings.inside, side, &mut rings.signs) {
                BeamSide::Inside => {}
                BeamSide::Outside => {
                    seen = false;
                    break;
                }
                BeamSide::Both => {
                    let signs = &rings.signs;
                    beam::cut(
                        planes,
                        &self.eye,
                        &rings.inside,
                        side,
                        signs,
                        &mut rings.next,
                        &mut rings.far,
                    );
                    std::mem::swap(&mut rings.inside, &mut rings.next);
                }
            }
        }
        if seen {
            let near = self.limits.areas(&rings.inside, Some(&facing)).1;
            seen = near.is_some();
            if let (Some(near), true) = (near, shows) {
                tally.see(triangle);
                let limits = &self.limits;
                let way = || {
                    beam::middle(planes, &rings.inside).filter(|w| limits.hold(*w, Some(&facing)))
                };
                tally.witness(triangle, near, way);
            }
        }
        planes.list.truncate(made);
        seen
    }
}
