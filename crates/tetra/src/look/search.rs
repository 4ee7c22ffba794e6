//! The search: beams go through boxes or cells, nearest first, and are cut along the edges of the triangles
//! that they meet.
//!
//! A beam keeps the nearest triangle so far that covers all of it, its cap. A triangle that is met divides
//! the beam into the parts beside it, which go on as they are, and the part in it. That part is divided along
//! the line where the triangle's plane meets the cap's: where the triangle is nearer it becomes the cap. What
//! is behind the cap's plane, in the beam, is hidden, so a beam ends when nothing is left in front of its
//! cap. The order of the work decides how long it takes, never what comes out (Weiler and Atherton, "Hidden
//! Surface Removal Using Polygon Area Sorting", 1977, cut in the same way and sort first).

use crate::surfaces::BLOCKS;

use super::areas::area;
use super::beam::{self, Place};
use super::eye::Eye;
use super::hierarchy::Node;
use super::planes::{Facing, Planes, Side};
use super::rounded::U;
use super::scratch::Scratch;
use super::space::{Space, THROUGH_FACE};
use super::stack::{Beam, Entry};
use super::view::Mode;
use super::within::Limits;

/// A part by which bounds on distances are moved: far more than their few roundings.
const BOUND: f64 = 1e-12;

/// What a search looks at.
pub(super) struct Scene<'a> {
    pub triangles: &'a [[u32; 3]],
    pub flags: &'a [u8],
    pub nodes: &'a [Node],
    pub order: &'a [u32],
    /// The cells, where they answer.
    pub space: Option<Space<'a>>,
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
            let Scratch { planes, stack, beam, rings, entered, .. } = &mut *self.scratch;
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
            if self.scene.space.is_some() {
                beam.pending.extend_from_slice(&rings.start);
            } else if !self.scene.nodes.is_empty() {
                beam.pending.push(Entry { key: 0.0, first: 0, count: 0 });
            }
            self.begun += area(&rings.inside);
            stack.push(beam, &rings.inside, caps, false, (planes.list.len(), entered.len()));
        }
    }

    /// Ends all beams.
    pub fn run(&mut self) {
        let mut beam = std::mem::take(&mut self.scratch.beam);
        while let Some((planes, entered)) = self.scratch.stack.pop(&mut beam) {
            self.scratch.planes.list.truncate(planes);
            self.scratch.entered.truncate(entered);
            self.follow(&mut beam);
        }
        self.scratch.beam = beam;
    }

    /// Follows a beam until it ends or is divided.
    fn follow(&mut self, beam: &mut Beam) {
        let mut cap = beam.caps.first().and_then(|t| self.facing(*t));
        let mut reach = self.reach(beam, cap.as_ref());
        while let Some(entry) = beam.pending.pop() {
            if entry.key > reach {
                // All boxes that wait are at least as far away.
                break;
            }
            if matches!(entry.count, 0 | THROUGH_FACE) {
                match self.scene.space {
                    Some(_) => self.enter(beam, cap.as_ref(), &entry),
                    None => self.open(beam, cap.as_ref(), entry.first),
                }
                continue;
            }
            if entry.count > 1 {
                beam.pending.push(Entry { first: entry.first + 1, count: entry.count - 1, ..entry });
            }
            let triangle = match self.scene.space {
                Some(_) => entry.first,
                None => self.scene.order[entry.first as usize],
            };
            // The cells name a triangle once for each of its faces.
            if beam.caps.contains(&triangle) || beam.met.contains(&triangle) {
                continue;
            }
            let before = cap.map(|cap| cap.points);
            if self.meet(beam, &mut cap, triangle) {
                return;
            }
            if cap.map(|cap| cap.points) != before {
                reach = self.reach(beam, cap.as_ref());
            }
        }
        self.end(beam, cap.as_ref());
    }

    /// The square of how far away the cap is at most in a beam, with what rounding may add; infinite without
    /// a cap, and where cells answer, whose keys are no bounds.
    fn reach(&self, beam: &Beam, cap: Option<&Facing>) -> f64 {
        let Some(cap) = cap.filter(|_| self.scene.space.is_none()) else { return f64::INFINITY };
        // The part of the plane in the beam is convex, so a corner is its farthest place.
        beam.ring.iter().fold(0.0, |most: f64, edge| {
            let way = &edge.corner.way;
            let along = cap.normal.dot(way);
            let least = along.value - along.error;
            if least <= 0.0 {
                return f64::INFINITY;
            }
            let size = way.v.iter().fold(0.0, |sum, c| sum + (c.abs() + way.error) * (c.abs() + way.error));
            let times = (cap.height.value + cap.height.error) / least;
            most.max(times * times * size * (1.0 + BOUND))
        })
    }

    /// Goes into a box, if some of the beam does in front of its cap.
    fn open(&mut self, beam: &mut Beam, cap: Option<&Facing>, number: u32) {
        let node = &self.scene.nodes[number as usize];
        let x = self.eye.x;
        if beam::misses(&self.scratch.planes, &beam.ring, x, node.low, node.high)
            || cap.is_some_and(|cap| behind(cap, x, node))
            || self.limits.beyond(x, node.low, node.high)
        {
            return;
        }
        self.scratch.seen.cells += 1;
        let below = beam.pending.last().map_or(f64::INFINITY, |entry| entry.key);
        if node.count > 0 {
            beam.pending.push(Entry { key: below.min(near(node, x)), first: node.first, count: node.count });
            return;
        }
        let [a, b] = [node.first, node.first + 1].map(|n| (near(&self.scene.nodes[n as usize], x), n));
        let (first, second) = if b.0 < a.0 { (b, a) } else { (a, b) };
        let key = below.min(second.0);
        beam.pending.push(Entry { key, first: second.1, count: 0 });
        beam.pending.push(Entry { key: key.min(first.0), first: first.1, count: 0 });
    }

    /// Goes into a cell, if some of the beam does in front of its cap, and if no beam that this one is a part
    /// of has been there: what that found waits already.
    fn enter(&mut self, beam: &mut Beam, cap: Option<&Facing>, entry: &Entry) {
        let Some(space) = &self.scene.space else { return };
        let Scratch { planes, entered, seen, rings, .. } = &mut *self.scratch;
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
        space.leave(&self.eye, planes, (&beam.ring, cap), cell, (blocks, is_entered), lists);
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
        self.scene.flags.get(triangle as usize).copied().unwrap_or(BLOCKS)
    }
}

/// The square of how far away a box is at least, but for a few roundings of one part in 2⁵³ each.
fn near(node: &Node, x: [f64; 3]) -> f64 {
    let sum = (0..3).fold(0.0, |sum, k| {
        let d = (f64::from(node.low[k]) - x[k]).max(x[k] - f64::from(node.high[k])).max(0.0);
        sum + d * d
    });
    sum * (1.0 - BOUND)
}

/// Leaves out the boxes that a beam does not go into, once for all of its parts, and brings the keys of the
/// others up to date.
pub(super) fn prune(nodes: &[Node], planes: &Planes, x: [f64; 3], beam: &mut Beam, cap: Option<&Facing>) {
    let Beam { ring, pending, .. } = beam;
    let mut least = f64::INFINITY;
    pending.retain_mut(|entry| {
        if entry.count == 0 {
            let node = &nodes[entry.first as usize];
            if beam::misses(planes, ring, x, node.low, node.high)
                || cap.is_some_and(|cap| behind(cap, x, node))
            {
                return false;
            }
            least = least.min(near(node, x));
        } else {
            least = least.min(entry.key);
        }
        entry.key = least;
        true
    });
}

/// Whether all of a box is behind a face's plane for certain.
fn behind(cap: &Facing, x: [f64; 3], node: &Node) -> bool {
    let n = &cap.normal;
    let mut least = 0.0;
    let mut reach = 0.0f64;
    for (k, x) in x.into_iter().enumerate() {
        let (low, high) = (f64::from(node.low[k]) - x, f64::from(node.high[k]) - x);
        least += (n.v[k] * low).min(n.v[k] * high);
        reach = reach.max(low.abs()).max(high.abs());
    }
    let slack = reach * (3.0 * n.error + 16.0 * U * n.size()) + cap.height.error;
    least > cap.height.value + slack + 4.0 * U * cap.height.value
}
