//! Patches: neighbouring triangles that together cover a beam.
//!
//! A patch avoids cuts of the beam along the edges between the triangles.
//!
//! The search clips a triangle by the beam, then the neighbours across the triangle's remaining edges inside
//! the beam, and so on. The pieces cover all directions of the beam equally often if, as seen from the
//! viewpoint, each such edge has its triangle on one side and the neighbour on the other side. Neighbours are
//! pairs, so a path of directions that crosses an edge inside the beam leaves as many pieces as it enters. A
//! path that avoids the end points of edges joins any two directions. The pieces cover the beam once if one
//! direction of a piece is in no other piece.

use super::beam::{self, Edge};
use super::neighbours::{NONE, across};
use super::pieces::Patch;
use super::planes::Facing;
use super::rounded::{Rounded, unit};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::Beam;

/// Maximum number of pieces of a patch. The sieve stores one bit for each piece.
const MOST: usize = 32;

/// The edge at which a patch ends in a beam.
///
/// The edge goes from `a` to `b` in the front order of the triangle ([`Facing::points`]).
#[derive(Clone, Copy)]
pub(super) struct PatchEnd {
    /// The id of the patch's triangle at the edge.
    pub triangle: u32,
    /// The number of the point at the start of the edge.
    pub a: u32,
    /// The number of the point at the end of the edge.
    pub b: u32,
}

/// The longest edge so far at which the patch ends, with the square of the edge's length at distance 1 from
/// the viewpoint.
type Longest = Option<(f64, PatchEnd)>;

/// The result of growing a patch.
pub(super) enum PatchGrowth {
    /// The patch covers the beam once.
    Covers,
    /// The patch ends inside the beam, or has too many pieces to continue at this edge.
    Ends(PatchEnd),
    /// No patch: the triangle does not overlap the beam, or the patch may cover the beam more than once.
    No,
}

impl Search<'_> {
    /// Grows a patch in a beam from the triangle with the id `seed`, and adds the planes of its pieces.
    pub(super) fn grow(&mut self, beam: &Beam, seed: u32, patch: &mut Patch) -> PatchGrowth {
        patch.clear();
        if !self.add_piece(beam, seed, patch) {
            return PatchGrowth::No;
        }
        // `end` is the longest edge at which the surface ends. `limit` is the longest edge at which the patch
        // has too many pieces to continue.
        let (mut end, mut limit): (Longest, Longest) = (None, None);
        let longest = |best: &mut Longest, length: f64, at: PatchEnd| {
            if best.is_none_or(|b| b.0 < length) {
                *best = Some((length, at));
            }
        };
        let mut number = 0;
        while number < patch.pieces().len() && end.is_none() {
            for k in 0..patch.pieces()[number].ring.len() {
                let piece = &patch.pieces()[number];
                let edge = &piece.ring[k];
                if beam.ring.iter().any(|e| e.side == edge.side) {
                    continue;
                }
                // A side that is not a side of the beam is an edge of the triangle.
                let Some((a, b)) = self.scratch.planes.edge_of(edge.side) else {
                    continue;
                };
                let length = apart(
                    edge,
                    &piece.ring[if k + 1 == piece.ring.len() { 0 } else { k + 1 }],
                );
                let at = PatchEnd {
                    triangle: piece.triangle,
                    a,
                    b,
                };
                let other = across(
                    self.scene.neighbours,
                    self.scene.triangles,
                    piece.triangle,
                    a,
                    b,
                );
                // A neighbour on the other side of the edge has the edge from b to a in its front order.
                let known = patch
                    .pieces()
                    .iter()
                    .find(|p| p.triangle == other)
                    .map(|p| p.facing);
                let facing = known.or_else(|| {
                    if other == NONE {
                        None
                    } else {
                        self.facing(other)
                    }
                });
                if !facing.is_some_and(|facing| has_edge(&facing, b, a)) {
                    longest(&mut end, length, at);
                } else if known.is_none()
                    && (patch.pieces().len() == MOST || !self.add_piece(beam, other, patch))
                {
                    longest(&mut limit, length, at);
                }
            }
            number += 1;
        }
        match end.or(limit) {
            Some((_, at)) => PatchGrowth::Ends(at),
            None if self.covers_once(patch) => PatchGrowth::Covers,
            None => PatchGrowth::No,
        }
    }

    /// Adds the part of a beam that a triangle covers to a patch as a piece. Returns false if the triangle
    /// does not overlap the beam.
    fn add_piece(&mut self, beam: &Beam, triangle: u32, patch: &mut Patch) -> bool {
        let points = self.points(triangle);
        let Some(outline) = self
            .scratch
            .outlines
            .find_outline(&self.eye, triangle, points)
        else {
            return false;
        };
        let Scratch { planes, rings, .. } = &mut *self.scratch;
        let overlaps = outline.clip(planes, &self.eye, &beam.ring, rings);
        if overlaps {
            patch.push(triangle, outline.facing, &rings.inside);
        }
        overlaps
    }

    /// Returns true if a direction of the first piece is certainly in no other piece.
    fn covers_once(&self, patch: &Patch) -> bool {
        let planes = &self.scratch.planes;
        let Some((first, others)) = patch.pieces().split_first() else {
            return false;
        };
        if others.is_empty() {
            return true;
        }
        let Some(way) = beam::middle(planes, &first.ring) else {
            return false;
        };
        let way = Rounded::exact(way);
        let is_out = |e: &Edge| way.dot(&planes.normal(e.side)).sign() == Some(-1);
        others.iter().all(|piece| piece.ring.iter().any(is_out))
    }
}

/// Returns true if the front order of a face contains the edge from `a` to `b`.
fn has_edge(facing: &Facing, a: u32, b: u32) -> bool {
    let p = facing.points;
    (0..3).any(|k| p[k] == a && p[(k + 1) % 3] == b)
}

/// Returns the square of the distance between two corners at distance 1 from the viewpoint, rounded.
///
/// The value selects the edge of a cut and does not affect the visible set.
fn apart(a: &Edge, b: &Edge) -> f64 {
    let (u, v) = (unit(a.corner.way.v), unit(b.corner.way.v));
    (0..3).fold(0.0, |sum, k| sum + (u[k] - v[k]) * (u[k] - v[k]))
}
