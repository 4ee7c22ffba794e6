//! Patches: neighbouring triangles that cover a beam together, so that it is not cut along the edges between
//! them.
//!
//! A triangle is clipped by the beam, and so are its neighbours across the edges that are left inside, and
//! theirs. If each such edge has, as seen from the viewpoint, its triangle on one side and the neighbour on
//! the other, the pieces cover all of the beam equally often: neighbours are pairs, so a path that crosses an
//! edge inside of the beam leaves as many pieces as it enters, and any two directions are joined by a path
//! that avoids the points where edges end. The pieces cover the beam once if one direction of a piece is in
//! no other one.

use super::beam::{self, Edge};
use super::neighbours::{NONE, across};
use super::pieces::Patch;
use super::planes::Facing;
use super::rounded::{Rounded, unit};
use super::scratch::Scratch;
use super::search::Search;
use super::stack::Beam;

/// Most pieces of a patch. The sieve has a bit for each.
const MOST: usize = 32;

/// Where a patch ends in a beam: at the edge from `a` to `b` of a triangle's front order.
#[derive(Clone, Copy)]
pub(super) struct End {
    pub triangle: u32,
    pub a: u32,
    pub b: u32,
}

/// The longest end so far, with the square of its length.
type Longest = Option<(f64, End)>;

/// How a patch grew.
pub(super) enum Grown {
    /// It covers the beam once.
    Covers,
    /// It ends inside of the beam, or has too many pieces to go on here.
    Ends(End),
    /// The triangle does not overlap the beam, or the patch may cover it more than once.
    No,
}

impl Search<'_> {
    /// Makes the patch of a triangle in a beam. The planes of its pieces are added.
    pub(super) fn grow(&mut self, beam: &Beam, seed: u32, patch: &mut Patch) -> Grown {
        patch.clear();
        if !self.add_piece(beam, seed, patch) {
            return Grown::No;
        }
        // The longest of the edges at which it ends, and of those at which it is too large.
        let (mut end, mut limit): (Longest, Longest) = (None, None);
        let longest = |best: &mut Longest, length: f64, at: End| {
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
                // What is no side of the beam is an edge of the triangle.
                let Some((a, b)) = self.scratch.planes.edge_of(edge.side) else {
                    continue;
                };
                let length = apart(
                    edge,
                    &piece.ring[if k + 1 == piece.ring.len() { 0 } else { k + 1 }],
                );
                let at = End {
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
                // On the other side of the edge its front order has it from b to a.
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
            Some((_, at)) => Grown::Ends(at),
            None if self.covers_once(patch) => Grown::Covers,
            None => Grown::No,
        }
    }

    /// Adds a triangle's part of a beam to a patch, if there is one.
    fn add_piece(&mut self, beam: &Beam, triangle: u32, patch: &mut Patch) -> bool {
        let points = self.points(triangle);
        let Some(outline) = self.scratch.outlines.of(&self.eye, triangle, points) else {
            return false;
        };
        let Scratch { planes, rings, .. } = &mut *self.scratch;
        let overlaps = outline.clip(planes, &self.eye, &beam.ring, rings);
        if overlaps {
            patch.push(triangle, outline.facing, &rings.inside);
        }
        overlaps
    }

    /// Whether a direction of the first piece is in no other one, for certain.
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

/// Whether a face's front order has an edge.
fn has_edge(facing: &Facing, a: u32, b: u32) -> bool {
    let p = facing.points;
    (0..3).any(|k| p[k] == a && p[(k + 1) % 3] == b)
}

/// The square of how far apart two corners are at distance 1, rounded: it chooses between cuts.
fn apart(a: &Edge, b: &Edge) -> f64 {
    let (u, v) = (unit(a.corner.way.v), unit(b.corner.way.v));
    (0..3).fold(0.0, |sum, k| sum + (u[k] - v[k]) * (u[k] - v[k]))
}
