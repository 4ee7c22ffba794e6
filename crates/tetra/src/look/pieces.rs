//! The pieces of a patch, in memory that is used again.

use super::beam::{Edge, Ring};
use super::planes::Facing;

/// A triangle of a patch.
pub(super) struct Piece {
    /// The triangle.
    pub triangle: u32,
    /// Its plane.
    pub facing: Facing,
    /// The part of the beam that it covers.
    pub ring: Ring,
}

/// Pieces, and memory for more.
#[derive(Default)]
pub(super) struct Patch {
    kept: Vec<Piece>,
    count: usize,
}

impl Patch {
    /// The pieces.
    pub fn pieces(&self) -> &[Piece] {
        &self.kept[..self.count]
    }

    /// Forgets them.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds a piece.
    pub fn push(&mut self, triangle: u32, facing: Facing, ring: &[Edge]) {
        if self.count == self.kept.len() {
            self.kept.push(Piece { triangle, facing, ring: Ring::new() });
        }
        let piece = &mut self.kept[self.count];
        (piece.triangle, piece.facing) = (triangle, facing);
        piece.ring.clear();
        piece.ring.extend_from_slice(ring);
        self.count += 1;
    }
}
