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
    /// Triangles with the points of a piece, and the piece's place.
    twins: Vec<(usize, u32)>,
}

impl Patch {
    /// The pieces.
    pub fn pieces(&self) -> &[Piece] {
        &self.kept[..self.count]
    }

    /// Forgets them.
    pub fn clear(&mut self) {
        self.count = 0;
        self.twins.clear();
    }

    /// Adds a triangle with the same three points as a piece.
    pub fn add_twin(&mut self, piece: usize, triangle: u32) {
        self.twins.push((piece, triangle));
    }

    /// The triangles that cover a piece with the same three points: its own, and its twins.
    pub fn triangles_of(&self, piece: usize) -> impl Iterator<Item = u32> {
        let twins = self.twins.iter().filter(move |t| t.0 == piece).map(|t| t.1);
        std::iter::once(self.pieces()[piece].triangle).chain(twins)
    }

    /// Adds a piece.
    pub fn push(&mut self, triangle: u32, facing: Facing, ring: &[Edge]) {
        if self.count == self.kept.len() {
            self.kept.push(Piece {
                triangle,
                facing,
                ring: Ring::new(),
            });
        }
        let piece = &mut self.kept[self.count];
        (piece.triangle, piece.facing) = (triangle, facing);
        piece.ring.clear();
        piece.ring.extend_from_slice(ring);
        self.count += 1;
    }
}
