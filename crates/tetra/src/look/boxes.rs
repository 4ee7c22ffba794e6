//! How a beam goes through the hierarchy of boxes: which ones wait, and in which order.

use super::areas::unit;
use super::beam::Edge;
use super::hierarchy::Node;
use super::planes::Facing;
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, Entry};

/// A part by which bounds on distances are moved: far more than their few roundings.
const BOUND: f64 = 1e-12;

/// A box is opened for a beam and all its parts if the square of its diagonal is as many times that of the
/// beam's radius at its distance. From 0.25 to 16 it hardly matters (`docs/experiments/look.md`).
const LARGE: f64 = 2.0;

impl Search<'_> {
    /// Leaves out the boxes that a beam does not go into, once for all of its parts, and opens those that are
    /// large beside it.
    pub(super) fn refine(&mut self, beam: &mut Beam) {
        let x = self.eye.x;
        let least = LARGE * radius(&beam.ring);
        let Scratch { sieve, refined, boxes, seen, .. } = &mut *self.scratch;
        refined.clear();
        for entry in beam.pending.iter().rev() {
            if entry.count > 0 {
                refined.push(*entry);
                continue;
            }
            boxes.clear();
            boxes.push(entry.first);
            while let Some(number) = boxes.pop() {
                let node = &self.scene.nodes[number as usize];
                if sieve.stops(node.low, node.high) || self.limits.beyond(x, node.low, node.high) {
                    continue;
                }
                let key = near(node, x);
                if node.count == 0 && size(node) >= least * key {
                    seen.cells += 1;
                    let [a, b] = [node.first, node.first + 1];
                    let [near_a, near_b] = [a, b].map(|n| near(&self.scene.nodes[n as usize], x));
                    // The nearer one is taken first.
                    boxes.extend(if near_b < near_a { [a, b] } else { [b, a] });
                } else {
                    refined.push(Entry { key, first: number, count: 0 });
                }
            }
        }
        beam.pending.clear();
        let mut least = f64::INFINITY;
        for entry in refined.iter().rev() {
            least = least.min(entry.key);
            beam.pending.push(Entry { key: least, ..*entry });
        }
    }

    /// Goes into a box: what of it the sieve does not leave out waits from now on.
    pub(super) fn open(&mut self, beam: &mut Beam, number: u32) {
        let node = &self.scene.nodes[number as usize];
        let x = self.eye.x;
        self.scratch.seen.cells += 1;
        let below = beam.pending.last().map_or(f64::INFINITY, |entry| entry.key);
        if node.count > 0 {
            beam.pending.push(Entry { key: below.min(near(node, x)), first: node.first, count: node.count });
            return;
        }
        let mut inside = [(0.0, 0); 2];
        let mut count = 0;
        for number in [node.first, node.first + 1] {
            let node = &self.scene.nodes[number as usize];
            if !self.scratch.sieve.stops(node.low, node.high) && !self.limits.beyond(x, node.low, node.high) {
                inside[count] = (near(node, x), number);
                count += 1;
            }
        }
        if count == 2 && inside[0].0 < inside[1].0 {
            inside.reverse();
        }
        let mut least = below;
        for (key, first) in &inside[..count] {
            least = least.min(*key);
            beam.pending.push(Entry { key: least, first: *first, count: 0 });
        }
    }
}

/// The square of how far away a face is at most in a beam, with what rounding may add.
pub(super) fn reach(ring: &[Edge], face: &Facing) -> f64 {
    // The part of the plane in the beam is convex, so a corner is its farthest place.
    ring.iter().fold(0.0, |most: f64, edge| {
        let way = &edge.corner.way;
        let along = face.normal.dot(way);
        let least = along.value - along.error;
        if least <= 0.0 {
            return f64::INFINITY;
        }
        let size = way.v.iter().fold(0.0, |sum, c| sum + (c.abs() + way.error) * (c.abs() + way.error));
        let times = (face.height.value + face.height.error) / least;
        most.max(times * times * size * (1.0 + BOUND))
    })
}

/// The square of how far away a box is at least, but for a few roundings of one part in 2⁵³ each.
pub(super) fn near(node: &Node, x: [f64; 3]) -> f64 {
    let sum = (0..3).fold(0.0, |sum, k| {
        let d = (f64::from(node.low[k]) - x[k]).max(x[k] - f64::from(node.high[k])).max(0.0);
        sum + d * d
    });
    sum * (1.0 - BOUND)
}

/// The square of a box's diagonal, rounded.
fn size(node: &Node) -> f64 {
    (0..3).fold(0.0, |sum, k| {
        let d = f64::from(node.high[k]) - f64::from(node.low[k]);
        sum + d * d
    })
}

/// The square of the radius of a beam around the middle of its corners, at distance 1, rounded.
fn radius(ring: &[Edge]) -> f64 {
    let middle = unit(middle(ring));
    ring.iter().fold(0.0f64, |most, e| {
        let way = unit(e.corner.way.v);
        most.max((0..3).fold(0.0, |sum, k| sum + (way[k] - middle[k]) * (way[k] - middle[k])))
    })
}

/// A direction near the middle of a ring, rounded, of any length.
pub(super) fn middle(ring: &[Edge]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for edge in ring {
        let way = unit(edge.corner.way.v);
        (0..3).for_each(|k| sum[k] += way[k]);
    }
    sum
}
