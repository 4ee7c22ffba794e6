//! The search: beams go through boxes or cells, nearest first, and are cut along the edges of the triangles
//! that they meet.
//!
//! A beam keeps the nearest triangle so far that covers all of it, its cap. A triangle that is met divides
//! the beam into the parts beside it, which go on as they are, and the part in it. That part is divided along
//! the line where the triangle's plane meets the cap's: where the triangle is nearer it becomes the cap. What
//! is behind the cap's plane, in the beam, is hidden, so a beam ends when nothing is left in front of its
//! cap. The order of the work decides how long it takes, never what comes out (Weiler and Atherton, "Hidden
//! Surface Removal Using Polygon Area Sorting", 1977, cut in the same way and sort first).

use super::areas::area;
use super::beam::{self, Place, reach};
use super::eye::Eye;
use super::hierarchy::Node;
use super::planes::{Facing, Side};
use super::scratch::Scratch;
use super::space::{Space, THROUGH_FACE};
use super::stack::{Beam, Entry, NO_HINT};
use super::view::{Mode, Seen};
use super::within::Limits;
use crate::surfaces::BLOCKS;

/// What a search looks at.
pub(super) struct Scene<'a> {
    pub triangles: &'a [[u32; 3]],
    pub flags: &'a [u8],
    pub nodes: &'a [Node],
    pub order: &'a [u32],
    /// What is across the edges of each triangle.
    pub neighbours: &'a [[u32; 3]],
    /// The cells, where they answer.
    pub space: Option<Space<'a>>,
}

/// How much a search may do, by what it counts: where it has done as much, it gives up.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// What a beam costs.
    pub beam: f64,
    /// What a box or a cell costs.
    pub step: f64,
    /// All together cost less than this.
    pub most: f64,
}

impl Budget {
    /// As much as it takes.
    pub const ALL: Self = Self {
        beam: 0.0,
        step: 0.0,
        most: f64::INFINITY,
    };

    /// What a search has cost so far.
    pub fn cost(&self, seen: &Seen) -> f64 {
        self.beam * seen.beams as f64 + self.step * seen.cells as f64
    }
}

/// One search.
pub(super) struct Search<'a> {
    pub scene: Scene<'a>,
    pub eye: Eye<'a>,
    pub mode: Mode,
    pub limits: Limits,
    /// Faces of target boxes, numbered after the triangles. They are caps from the start and are never met.
    pub faces: &'a [[u32; 3]],
    pub scratch: &'a mut Scratch,
    /// Solid angle in which the cap is a face.
    pub of_faces: f64,
    /// Solid angle that was begun with.
    pub begun: f64,
}

impl Search<'_> {
    /// Begins with all directions on the inner side of some planes, and with a cap or none.
    pub fn begin(&mut self, sides: &[Side], caps: &[u32]) {
        if let Some(space) = &self.scene.space {
            let Scratch { rings, hint, .. } = &mut *self.scratch;
            space.start(&self.eye, hint, &mut rings.start);
        }
        for signs in 0..8 {
            let Scratch {
                planes,
                stack,
                beam,
                rings,
                entered,
                ..
            } = &mut *self.scratch;
            beam::octant(planes, &self.eye, signs, &mut rings.inside);
            let missed = sides.iter().any(|side| {
                match beam::place(planes, &self.eye, &rings.inside, *side, &mut rings.signs) {
                    Place::Outside => return true,
                    Place::Inside => {}
                    Place::Both => {
                        let signs = &rings.signs;
                        beam::cut(
                            planes,
                            &self.eye,
                            &rings.inside,
                            *side,
                            signs,
                            &mut rings.next,
                            &mut rings.far,
                        );
                        std::mem::swap(&mut rings.inside, &mut rings.next);
                    }
                }
                false
            });
            if missed {
                continue;
            }
            beam.pending.clear();
            beam.met.clear();
            beam.hint = NO_HINT;
            if self.scene.space.is_some() {
                beam.pending.extend_from_slice(&rings.start);
            } else if !self.scene.nodes.is_empty() {
                beam.pending.push(Entry {
                    key: 0.0,
                    first: 0,
                    count: 0,
                });
            }
            self.begun += area(&rings.inside);
            stack.push(
                beam,
                &rings.inside,
                caps,
                false,
                (planes.list.len(), entered.len()),
            );
        }
    }

    /// Ends all beams; says whether the budget was enough for that.
    pub fn run(&mut self, budget: &Budget) -> bool {
        let mut beam = std::mem::take(&mut self.scratch.beam);
        let mut is_enough = true;
        while let Some((planes, entered)) = self.scratch.stack.pop(&mut beam) {
            self.scratch.planes.list.truncate(planes);
            self.scratch.entered.truncate(entered);
            self.follow(&mut beam);
            is_enough = budget.cost(&self.scratch.seen) < budget.most;
            if !is_enough {
                break;
            }
        }
        self.scratch.beam = beam;
        is_enough
    }

    /// Follows a beam until it ends or is divided.
    fn follow(&mut self, beam: &mut Beam) {
        let mut cap = beam.caps.first().and_then(|t| self.facing(*t));
        if self.scene.space.is_none() && self.begin_boxes(beam, &mut cap) {
            return;
        }
        let mut far = self.sift(beam, cap.as_ref());
        while let Some(entry) = beam.pending.pop() {
            if entry.key > far {
                // All boxes that wait are at least as far away.
                break;
            }
            if matches!(entry.count, 0 | THROUGH_FACE) {
                match self.scene.space {
                    Some(_) => self.enter(beam, cap.as_ref(), &entry),
                    None => self.open(beam, entry.first),
                }
                continue;
            }
            if entry.count > 1 {
                beam.pending.push(Entry {
                    first: entry.first + 1,
                    count: entry.count - 1,
                    ..entry
                });
            }
            let triangle = match self.scene.space {
                Some(_) => entry.first,
                None => self.scene.order[entry.first as usize],
            };
            // The cells name a triangle once for each of its faces.
            if beam.caps.contains(&triangle)
                || beam.met.contains(&triangle)
                || self.is_sifted(triangle)
            {
                continue;
            }
            let before = cap.map(|cap| cap.points);
            if self.meet(beam, &mut cap, triangle) {
                return;
            }
            if cap.map(|cap| cap.points) != before {
                far = self.sift(beam, cap.as_ref());
            }
        }
        self.end(beam, cap.as_ref());
    }

    /// Begins a beam among boxes; says whether it ended or was divided.
    fn begin_boxes(&mut self, beam: &mut Beam, cap: &mut Option<Facing>) -> bool {
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.of(planes, &beam.ring, cap.as_ref());
        self.refine(beam);
        if beam.caps.is_empty() {
            return if beam.whole {
                self.see_whole(beam)
            } else {
                self.see(beam, cap)
            };
        }
        if beam.whole {
            return false;
        }
        match self.guess(beam, cap.as_ref()) {
            Some(triangle) if !beam.caps.contains(&triangle) => self.meet(beam, cap, triangle),
            _ => false,
        }
    }

    /// The square of how far away the cap is at most in a beam: infinite without a cap, and where cells
    /// answer, whose keys are no bounds. The sieve leaves out what is behind the cap from now on.
    fn sift(&mut self, beam: &Beam, cap: Option<&Facing>) -> f64 {
        if self.scene.space.is_some() {
            return f64::INFINITY;
        }
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.of(planes, &beam.ring, cap);
        cap.map_or(f64::INFINITY, |cap| reach(&beam.ring, cap))
    }

    /// Whether the sieve leaves out a triangle.
    fn is_sifted(&self, triangle: u32) -> bool {
        self.scene.space.is_none() && {
            let points = self.eye.scene_points(self.points(triangle));
            self.scratch.sieve.behind(points).is_none()
        }
    }

    /// Goes into a cell, if some of the beam does in front of its cap, and if no beam that this one is a part
    /// of has been there: what that found waits already.
    fn enter(&mut self, beam: &mut Beam, cap: Option<&Facing>, entry: &Entry) {
        let Some(space) = &self.scene.space else {
            return;
        };
        let Scratch {
            planes,
            entered,
            seen,
            rings,
            ..
        } = &mut *self.scratch;
        let cell = space.cell_of(entry);
        if entered.holds(cell)
            || !space.is_reached(&self.eye, planes, (&beam.ring, cap), entry, &mut rings.ways)
        {
            return;
        }
        entered.add(cell);
        seen.cells += 1;
        let flags = self.scene.flags;
        let blocks = |t: u32| flags[t as usize] & BLOCKS != 0;
        let is_entered = |cell: u32| entered.holds(cell);
        let lists = (&mut beam.pending, &mut rings.ways);
        space.leave(
            &self.eye,
            planes,
            (&beam.ring, cap),
            cell,
            (blocks, is_entered),
            lists,
        );
    }

    pub(super) fn points(&self, triangle: u32) -> [u32; 3] {
        let t = triangle as usize;
        match self.scene.triangles.get(t) {
            Some(points) => *points,
            None => self.faces[t - self.scene.triangles.len()],
        }
    }

    pub(super) fn facing(&self, triangle: u32) -> Option<Facing> {
        Facing::of(&self.eye, self.points(triangle))
    }

    pub(super) fn flags(&self, triangle: u32) -> u8 {
        // Faces of targets block, and are in no set.
        self.scene
            .flags
            .get(triangle as usize)
            .copied()
            .unwrap_or(BLOCKS)
    }
}
