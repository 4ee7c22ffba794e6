//! The traversal of the hierarchy of boxes by a beam: the beam's pending boxes, the nearest box last.

use super::beam;
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, StackEntry};

/// Threshold at which a box is opened for a beam and all its parts.
///
/// The square of the box's diagonal must be at least this constant times the square of the beam's radius at
/// the box's distance. Values from 0.25 to 16 hardly change the time (`docs/experiments/look.md`).
const LARGE: f64 = 2.0;

impl Search<'_> {
    /// Removes the pending boxes that a beam does not enter, so that its parts do not test these boxes again.
    ///
    /// Also opens the boxes that are large compared with the beam.
    pub(super) fn refine(&mut self, beam: &mut Beam) {
        let x = self.eye.x;
        let least = LARGE * beam::radius(&beam.ring);
        let Scratch {
            sieve,
            refined,
            boxes,
            seen,
            ..
        } = &mut *self.scratch;
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
                let key = node.near(x);
                if node.count == 0 && node.size() >= least * key {
                    seen.cells += 1;
                    let [a, b] = [node.first, node.first + 1];
                    let [near_a, near_b] = [a, b].map(|n| self.scene.nodes[n as usize].near(x));
                    // `boxes` is a stack, so the nearer box is pushed last and visited first.
                    boxes.extend(if near_b < near_a { [a, b] } else { [b, a] });
                } else {
                    refined.push(StackEntry {
                        key,
                        first: number,
                        count: 0,
                    });
                }
            }
        }
        beam.pending.clear();
        let mut least = f64::INFINITY;
        for entry in refined.iter().rev() {
            least = least.min(entry.key);
            beam.pending.push(StackEntry {
                key: least,
                ..*entry
            });
        }
    }

    /// Opens the box with this number: adds its child boxes or triangles to the pending entries of a beam,
    /// except boxes that the sieve or the view's distance excludes.
    pub(super) fn open(&mut self, beam: &mut Beam, number: u32) {
        let node = &self.scene.nodes[number as usize];
        let x = self.eye.x;
        self.scratch.seen.cells += 1;
        let below = beam.pending.last().map_or(f64::INFINITY, |entry| entry.key);
        if node.count > 0 {
            beam.pending.push(StackEntry {
                key: below.min(node.near(x)),
                first: node.first,
                count: node.count,
            });
            return;
        }
        let mut inside = [(0.0, 0); 2];
        let mut count = 0;
        for number in [node.first, node.first + 1] {
            let node = &self.scene.nodes[number as usize];
            if !self.scratch.sieve.stops(node.low, node.high)
                && !self.limits.beyond(x, node.low, node.high)
            {
                inside[count] = (node.near(x), number);
                count += 1;
            }
        }
        if count == 2 && inside[0].0 < inside[1].0 {
            inside.reverse();
        }
        let mut least = below;
        for (key, first) in &inside[..count] {
            least = least.min(*key);
            beam.pending.push(StackEntry {
                key: least,
                first: *first,
                count: 0,
            });
        }
    }
}
