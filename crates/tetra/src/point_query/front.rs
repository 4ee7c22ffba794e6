//! The processing of beams without a cap: by a patch that covers the beam, or by a cut.
//!
//! The patch begins with a guessed triangle. If the patch ends inside the beam, the search cuts the beam
//! along the edge at which the patch ends. Usually a surface ends or turns away at this edge, and another
//! surface is visible beyond the edge. If the patch covers the beam, the search compares all pending
//! triangles with the patch. If a part of a triangle is in front of the patch, the first visible triangle in
//! this part begins the next patch. A triangle that crosses the patch cuts the beam along the line where both
//! meet. A triangle with the points of a piece is visible with the piece. [`super::beam_division`] handles
//! any other triangle in the plane of a piece. The search removes pending boxes behind a patch that covers
//! the beam, for all parts of the beam.

use super::beam::{self, BeamSide, reach};
use super::beam_division::keep;
use super::edge_tests::Edges;
use super::outline::{Order, order};
use super::patch::{PatchEnd, PatchGrowth};
use super::pieces::Patch;
use super::planes::{Facing, Side};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::{Beam, NO_HINT};
use crate::surfaces::BLOCKS;

/// Maximum number of patches that the search tests before it cuts the beam along a triangle's edges.
///
/// Surfaces that do not cross have an order, so this limit is seldom reached.
const TRIES: usize = 16;

impl Search<'_> {
    /// Processes a beam that has no cap and may be cut.
    ///
    /// Returns true if the beam ended or was divided. Otherwise the beam has a cap now, unless the guessed
    /// triangle does not overlap the beam.
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
        // `sure` is a triangle that certainly overlaps the beam. A triangle that was guessed in doubles may
        // not overlap the beam.
        let mut sure = None;
        patch.clear();
        for _ in 0..TRIES {
            if let Some(triangle) = seed {
                match self.grow(beam, triangle, patch) {
                    PatchGrowth::Covers => {}
                    PatchGrowth::Ends(end) => return self.cut_at(beam, end, made, met),
                    PatchGrowth::No if sure.is_some() && sure != seed => {
                        seed = sure;
                        self.scratch.planes.list.truncate(made);
                        continue;
                    }
                    PatchGrowth::No => break,
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
                // Another triangle may be in front of this triangle in this direction.
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

    /// Processes a beam that has no cap and is not cut any further.
    ///
    /// Returns true if a patch covered the beam, so that the beam ended.
    pub(super) fn see_whole(&mut self, beam: &mut Beam) -> bool {
        let made = self.scratch.planes.list.len();
        let Some(seed) = self.guess(beam, None) else {
            return false;
        };
        let mut patch = std::mem::take(&mut self.scratch.patch);
        let covered = matches!(self.grow(beam, seed, &mut patch), PatchGrowth::Covers);
        if covered {
            // All triangles that may be in front of the patch count as visible.
            let far = far(&patch);
            self.in_front(beam, &mut patch, far);
            self.end_patch(beam, &patch);
        }
        self.scratch.planes.list.truncate(made);
        self.scratch.patch = patch;
        covered
    }

    /// Cuts a beam along the edge at which a patch ends. Removes the planes after the first `made` planes and
    /// the entries of `beam.met` after the first `met` entries. Returns true.
    fn cut_at(&mut self, beam: &mut Beam, end: PatchEnd, made: usize, met: usize) -> bool {
        self.scratch.planes.list.truncate(made);
        beam.met.truncate(met);
        let side = self.scratch.planes.add_edge(&self.eye, end.a, end.b);
        beam.hint = end.triangle;
        self.halve(beam, side);
        true
    }

    /// Finds a pending triangle that blocks and has a part in front of a patch. Returns its id and position.
    ///
    /// `far` is an upper bound of the squared distance of the patch. The function adds triangles in front of
    /// the patch that do not block to `beam.met`; if the beam is not cut any further, it adds all triangles
    /// in front.
    fn in_front(&mut self, beam: &mut Beam, patch: &mut Patch, far: f64) -> Option<(u32, Order)> {
        let Scratch { sieve, planes, .. } = &mut *self.scratch;
        sieve.begin_beam(planes, &beam.ring, None);
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
            let edges = Edges::new(&self.eye, points);
            if edges
                .as_ref()
                .is_some_and(|edges| edges.are_beside(&beam.ring))
            {
                continue;
            }
            let Some(outline) = self
                .scratch
                .outlines
                .find_outline(&self.eye, triangle, points)
            else {
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
                    &piece.ring,
                    &piece.facing,
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

    /// Removes the pending boxes that the patch in the sieve hides, so that the parts of the beam do not test
    /// these boxes. The patch must cover the beam.
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

    /// Ends a beam whose patch is in front of all other triangles, or a beam without any triangle.
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

    /// Divides a beam along a plane that has directions of the beam on both sides. Only the part on the inner
    /// side keeps the beam's hint.
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
            BeamSide::Both,
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

/// Returns an upper bound of the squared distance of a patch from the viewpoint.
///
/// The bound is infinite if the patch has no pieces.
fn far(patch: &Patch) -> f64 {
    match patch.pieces() {
        [] => f64::INFINITY,
        pieces => pieces
            .iter()
            .fold(0.0, |far: f64, p| far.max(reach(&p.ring, &p.facing))),
    }
}
