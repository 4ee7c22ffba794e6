//! How a beam without a cap is decided: by a patch that covers it and has nothing in front of it, or by
//! cutting it in two.
//!
//! The patch begins with a guess. Where it ends inside of the beam, the beam is cut along the edge at which
//! it does: most often a surface ends there or turns away, and something else is seen beyond. If it covers
//! the beam, all that waits is compared with it. Where a triangle is in front of it, what is seen there first
//! begins the next patch; a triangle that goes through it cuts the beam along the line where both meet; one
//! with the points of a piece is seen with it, and another one in its plane is left to [`super::meeting`].
//! What is behind a patch that covers the beam is forgotten for all parts of the beam.

use super::beam::{self, Place, reach};
use super::beside::Edges;
use super::meeting::keep;
use super::outline::{Order, order};
use super::patch::{End, Grown};
use super::pieces::Patch;
use super::planes::{Facing, Side};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, NO_HINT};
use crate::surfaces::BLOCKS;

/// Patches that are tried in front of one another before the beam is cut along a triangle's edges. Surfaces
/// that do not cross have an order, so this is seldom reached.
const TRIES: usize = 16;

impl Search<'_> {
    /// Decides a beam that has no cap and may be cut. Says whether it ended or was divided; else it has a cap
    /// now.
    pub(super) fn see(&mut self, beam: &mut Beam, cap: &mut Option<Facing>) -> bool {
        let mut patch = std::mem::take(&mut self.scratch.patch);
        let done = self.see_with(beam, cap, &mut patch);
        self.scratch.patch = patch;
        done
    }

    fn see_with(&mut self, beam: &mut Beam, cap: &mut Option<Facing>, patch: &mut Patch) -> bool {
        let (made, met) = (self.scratch.planes.list.len(), beam.met.len());
        let mut seed = if beam.hint == NO_HINT {
            self.guess(beam, None)
        } else {
            Some(beam.hint)
        };
        // A triangle that overlaps the beam for certain, which a guess in doubles may not.
        let mut sure = None;
        patch.clear();
        for _ in 0..TRIES {
            if let Some(triangle) = seed {
                match self.grow(beam, triangle, patch) {
                    Grown::Covers => {}
                    Grown::Ends(end) => return self.cut_at(beam, end, made, met),
                    Grown::No if sure.is_some() && sure != seed => {
                        seed = sure;
                        self.scratch.planes.list.truncate(made);
                        continue;
                    }
                    Grown::No => break,
                }
            }
            let far = far(patch);
            let Some((triangle, order)) = self.in_front(beam, patch, far) else {
                self.end_patch(beam, patch);
                return true;
            };
            self.forget(beam, far);
            (sure, seed) = (Some(triangle), Some(triangle));
            if matches!(order, Order::Nearer) {
                // Something else may be in front of it there.
                let way = beam::center(&self.scratch.rings.inside);
                let is_new = |t: &u32| patch.pieces().iter().all(|p| p.triangle != *t);
                seed = self.guess_along(beam, None, way).filter(is_new).or(seed);
            }
            self.scratch.planes.list.truncate(made);
            beam.met.truncate(met);
            match order {
                Order::Crosses(plane) => {
                    let side = self.scratch.planes.add(plane);
                    beam.hint = triangle;
                    self.halve(beam, side);
                    return true;
                }
                Order::Nearer => {}
                Order::Level | Order::Hidden => break,
            }
        }
        self.scratch.planes.list.truncate(made);
        beam.met.truncate(met);
        sure.or(seed)
            .is_some_and(|triangle| self.meet(beam, cap, triangle))
    }

    /// Decides a beam that has no cap and is cut no more, if a patch covers it. Says whether it did.
    pub(super) fn see_whole(&mut self, beam: &mut Beam) -> bool {
        let made = self.scratch.planes.list.len();
        let Some(seed) = self.guess(beam, None) else {
            return false;
        };
        let mut patch = std::mem::take(&mut self.scratch.patch);
        let covered = matches!(self.grow(beam, seed, &mut patch), Grown::Covers);
        if covered {
            // All that may be in front of it counts as seen.
            let far = far(&patch);
            self.in_front(beam, &mut patch, far);
            self.end_patch(beam, &patch);
        }
        self.scratch.planes.list.truncate(made);
        self.scratch.patch = patch;
        covered
    }

    /// Cuts a beam where a patch ends.
    fn cut_at(&mut self, beam: &mut Beam, end: End, made: usize, met: usize) -> bool {
        self.scratch.planes.list.truncate(made);
        beam.met.truncate(met);
        let side = self.scratch.planes.add_edge(&self.eye, end.a, end.b);
        beam.hint = end.triangle;
        self.halve(beam, side);
        true
    }

    /// A triangle of those that wait of which some is in front of a patch, and blocks; `far` is the square of
    /// how far away the patch is at most. See-through ones are kept in `beam.met`, and all if the beam is cut
    /// no more.
    fn in_front(&mut self, beam: &mut Beam, patch: &mut Patch, far: f64) -> Option<(u32, Order)> {
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.of(planes, &beam.ring, None);
        patch
            .pieces()
            .iter()
            .for_each(|piece| sieve.patch(&piece.facing));
        let mut open = std::mem::take(&mut self.scratch.boxes);
        let mut found = None;
        for at in (0..beam.pending.len()).rev() {
            let entry = beam.pending[at];
            if entry.key > far || found.is_some() {
                break;
            }
            if entry.count > 0 {
                found = self.leaf_in_front(beam, patch, entry.first, entry.count);
                continue;
            }
            open.clear();
            open.push(entry.first);
            while let Some(number) = open.pop() {
                let node = &self.scene.nodes[number as usize];
                if node.near(self.eye.x) > far
                    || self.scratch.sieve.stops(node.low, node.high)
                    || self.limits.beyond(self.eye.x, node.low, node.high)
                {
                    continue;
                }
                self.scratch.seen.cells += 1;
                if node.count == 0 {
                    open.extend([node.first, node.first + 1]);
                    continue;
                }
                found = self.leaf_in_front(beam, patch, node.first, node.count);
                if found.is_some() {
                    break;
                }
            }
        }
        self.scratch.boxes = open;
        found
    }

    fn leaf_in_front(
        &mut self,
        beam: &mut Beam,
        patch: &mut Patch,
        first: u32,
        count: u32,
    ) -> Option<(u32, Order)> {
        for k in first..first + count {
            let triangle = self.scene.order[k as usize];
            let points = self.points(triangle);
            let Some(behind) = self.scratch.sieve.behind(self.eye.scene_points(points)) else {
                continue;
            };
            if patch.pieces().iter().any(|p| p.triangle == triangle) || beam.met.contains(&triangle)
            {
                continue;
            }
            let edges = Edges::of(&self.eye, points);
            if edges
                .as_ref()
                .is_some_and(|edges| edges.are_beside(&beam.ring))
            {
                continue;
            }
            let Some(outline) = self.scratch.outlines.of(&self.eye, triangle, points) else {
                continue;
            };
            let Scratch { planes, rings, .. } = &mut *self.scratch;
            if outline.is_beside(planes, &self.eye, &beam.ring) {
                continue;
            }
            let blocks = self.scene.flags[triangle as usize] & BLOCKS != 0;
            let (mut place, mut twin) = (Order::Hidden, None);
            if patch.pieces().is_empty() {
                let made = planes.list.len();
                if outline.clip(planes, &self.eye, &beam.ring, rings) {
                    place = Order::Nearer;
                }
                planes.list.truncate(made);
            }
            for (n, piece) in patch
                .pieces()
                .iter()
                .enumerate()
                .filter(|(n, _)| behind >> n & 1 == 0)
            {
                if blocks && piece.facing.has_points_of(&outline.facing) {
                    twin = Some(n);
                    continue;
                }
                if edges
                    .as_ref()
                    .is_some_and(|edges| edges.are_beside(&piece.ring))
                {
                    continue;
                }
                place = order(
                    planes,
                    &self.eye,
                    (&piece.ring, &piece.facing),
                    &outline,
                    rings,
                );
                if !matches!(place, Order::Hidden) {
                    break;
                }
            }
            match (place, twin) {
                (Order::Hidden, Some(piece)) => patch.add_twin(piece, triangle),
                (Order::Hidden, None) => {}
                _ if beam.whole || !blocks => beam.met.push(triangle),
                (place, _) => return Some((triangle, place)),
            }
        }
        None
    }

    /// Leaves out what the patch in the sieve hides, for all parts of the beam, which it covers.
    fn forget(&mut self, beam: &mut Beam, far: f64) {
        let (nodes, sieve) = (self.scene.nodes, &self.scratch.sieve);
        beam.pending.retain(|entry| {
            entry.count > 0
                || entry.key <= far && {
                    let node = &nodes[entry.first as usize];
                    !sieve.hides(node.low, node.high)
                }
        });
    }

    /// Ends a beam in which nothing is in front of a patch that covers it, or in which nothing is.
    fn end_patch(&mut self, beam: &mut Beam, patch: &Patch) {
        if patch.pieces().is_empty() {
            self.end(beam, None);
            return;
        }
        let beams = self.scratch.seen.beams + 1;
        for (n, piece) in patch.pieces().iter().enumerate() {
            beam.ring.clear();
            beam.ring.extend_from_slice(&piece.ring);
            beam.caps.clear();
            beam.caps.extend(patch.triangles_of(n));
            self.end(beam, Some(&piece.facing));
        }
        self.scratch.seen.beams = beams;
    }

    /// Divides a beam along a plane that it has directions on both sides of. The inner part keeps the hint.
    fn halve(&mut self, beam: &mut Beam, side: Side) {
        let Scratch {
            planes,
            stack,
            rings,
            seen,
            entered,
            ..
        } = &mut *self.scratch;
        let place = beam::place(planes, &self.eye, &beam.ring, side, &mut rings.signs);
        debug_assert_eq!(
            place,
            Place::Both,
            "an edge or a line inside of a beam has directions on both sides"
        );
        beam::cut(
            planes,
            &self.eye,
            &beam.ring,
            side,
            &rings.signs,
            &mut rings.next,
            &mut rings.far,
        );
        let made = (planes.list.len(), entered.len());
        let hint = beam.hint;
        for (ring, hint) in [(&rings.far, NO_HINT), (&rings.next, hint)] {
            if let Some(whole) = keep(self.mode, planes, ring, &self.limits, seen) {
                beam.hint = hint;
                stack.push(beam, ring, &beam.caps, whole, made);
            }
        }
    }
}

/// The square of how far away a patch is at most; infinite if it has no pieces.
fn far(patch: &Patch) -> f64 {
    match patch.pieces() {
        [] => f64::INFINITY,
        pieces => pieces
            .iter()
            .fold(0.0, |far: f64, p| far.max(reach(&p.ring, &p.facing))),
    }
}
