//! The search of a query: beams traverse boxes or cells, nearest first, and triangles cut the beams.
//!
//! A beam stores its cap: the nearest triangle so far that covers all of the beam. The edges of a triangle
//! divide a beam into the part in the triangle and the parts next to the triangle, which keep the cap. The
//! part in the triangle is divided along the line where the planes of triangle and cap meet. The triangle
//! becomes the cap of the part in which it is nearer. The cap hides everything behind its plane in the beam,
//! so a beam ends when all pending boxes, cells and triangles in front of its cap are processed. The order of
//! the work affects the time but not the result. Weiler and Atherton, "Hidden Surface Removal Using Polygon
//! Area Sorting", 1977, cut in the same way and sort first.

use super::areas::area;
use super::beam::{self, BeamSide, reach};
use super::eye::Eye;
use super::hierarchy::BvhNode;
use super::planes::{Facing, Side};
use super::scratch::Scratch;
use super::space::{CappedRing, Space, THROUGH_FACE};
use super::stack::{Beam, NO_HINT, StackEntry};
use super::view::{Mode, VisibleTriangles};
use super::view_limits::ViewLimits;
use crate::surfaces::BLOCKS;

/// The lists of a scene that a search reads.
pub(super) struct SearchedScene<'a> {
    /// The corners of each triangle, as point numbers.
    pub triangles: &'a [[u32; 3]],
    /// The flags of each triangle.
    pub flags: &'a [u8],
    /// The boxes, the root first.
    pub nodes: &'a [BvhNode],
    /// The ids of the triangles, grouped by box.
    pub order: &'a [u32],
    /// The ids of the triangles across the edges of each triangle.
    pub neighbours: &'a [[u32; 3]],
    /// The cells, if the engine is [`Engine::Cells`](super::view::Engine::Cells).
    pub space: Option<Space<'a>>,
}

/// The cost of the steps of a search, and the limit of the total cost at which the search stops.
#[derive(Clone, Copy, Debug)]
pub struct SearchBudget {
    /// The cost of a beam.
    pub beam: f64,
    /// The cost of a box or of a cell.
    pub step: f64,
    /// The limit of the total cost, in the unit of `beam` and `step`.
    pub most: f64,
}

impl SearchBudget {
    /// A budget without a limit.
    pub const ALL: Self = Self {
        beam: 0.0,
        step: 0.0,
        most: f64::INFINITY,
    };

    /// Returns the cost of a search so far.
    pub fn cost(&self, seen: &VisibleTriangles) -> f64 {
        self.beam * seen.beams as f64 + self.step * seen.cells as f64
    }
}

/// The state of a search.
pub(super) struct Search<'a> {
    pub scene: SearchedScene<'a>,
    pub eye: Eye<'a>,
    pub mode: Mode,
    pub limits: ViewLimits,
    /// The faces of target boxes, each as three point numbers. The id of the first face is the number of
    /// triangles. A face is the cap of the first beams, and does not cut beams.
    pub faces: &'a [[u32; 3]],
    pub scratch: &'a mut Scratch,
    /// The solid angle of the ended beams whose cap is a face of a target box, in steradians.
    pub of_faces: f64,
    /// The solid angle of all beams at the start, in steradians.
    pub begun: f64,
}

impl Search<'_> {
    /// Creates the first beams: all directions on all given sides of planes, divided into octants.
    ///
    /// `caps` contains the ids of triangles or faces that cover all these beams, and can be empty.
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
                    BeamSide::Outside => return true,
                    BeamSide::Inside => {}
                    BeamSide::Both => {
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
                beam.pending.push(StackEntry {
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

    /// Processes all beams on the stack. Returns false if the search stopped because its cost reached the
    /// limit of `budget`.
    pub fn run(&mut self, budget: &SearchBudget) -> bool {
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

    /// Processes the pending entries of a beam until the beam ends or is divided.
    fn follow(&mut self, beam: &mut Beam) {
        let mut cap = beam.caps.first().and_then(|t| self.facing(*t));
        if self.scene.space.is_none() && self.begin_boxes(beam, &mut cap) {
            return;
        }
        let mut far = self.sift(beam, cap.as_ref());
        while let Some(entry) = beam.pending.pop() {
            if entry.key > far {
                // All pending boxes are at least this far away.
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
                beam.pending.push(StackEntry {
                    first: entry.first + 1,
                    count: entry.count - 1,
                    ..entry
                });
            }
            let triangle = match self.scene.space {
                Some(_) => entry.first,
                None => self.scene.order[entry.first as usize],
            };
            // The cells list a triangle once for each of its faces.
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

    /// Begins a beam in the hierarchy of boxes. Returns true if the beam ended or was divided.
    fn begin_boxes(&mut self, beam: &mut Beam, cap: &mut Option<Facing>) -> bool {
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.begin_beam(planes, &beam.ring, cap.as_ref());
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

    /// Excludes everything behind the cap by the sieve, and returns an upper bound of the square of the cap's
    /// distance in the beam.
    ///
    /// The bound is infinite without a cap, and for the cell engine, whose keys are not distance bounds.
    fn sift(&mut self, beam: &Beam, cap: Option<&Facing>) -> f64 {
        if self.scene.space.is_some() {
            return f64::INFINITY;
        }
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.begin_beam(planes, &beam.ring, cap);
        cap.map_or(f64::INFINITY, |cap| reach(&beam.ring, cap))
    }

    /// Returns true if the sieve excludes a triangle.
    fn is_sifted(&self, triangle: u32) -> bool {
        self.scene.space.is_none() && {
            let points = self.eye.scene_points(self.points(triangle));
            self.scratch.sieve.behind(points).is_none()
        }
    }

    /// Enters the cell of an entry if a part of the beam may overlap the cell in front of the beam's cap.
    ///
    /// Skips a cell that an enclosing beam has entered, because the cell's triangles are already pending.
    fn enter(&mut self, beam: &mut Beam, cap: Option<&Facing>, entry: &StackEntry) {
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
        let capped = CappedRing {
            ring: &beam.ring,
            cap,
        };
        if entered.holds(cell)
            || !space.is_reached(&self.eye, planes, capped, entry, &mut rings.ways)
        {
            return;
        }
        entered.add(cell);
        seen.cells += 1;
        let flags = self.scene.flags;
        let blocks = |t: u32| flags[t as usize] & BLOCKS != 0;
        let is_entered = |cell: u32| entered.holds(cell);
        space.leave(
            &self.eye,
            planes,
            capped,
            cell,
            blocks,
            is_entered,
            &mut beam.pending,
            &mut rings.ways,
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
        Facing::new(&self.eye, self.points(triangle))
    }

    pub(super) fn flags(&self, triangle: u32) -> u8 {
        // Faces of targets block and are in no visible set.
        self.scene
            .flags
            .get(triangle as usize)
            .copied()
            .unwrap_or(BLOCKS)
    }
}
