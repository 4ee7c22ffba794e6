//! The pieces of a patch, in reusable memory.

use super::beam::{Edge, Ring};
use super::planes::Facing;

/// A piece of a patch: the part of a beam that one triangle covers.
pub(super) struct Piece {
    /// The id of the triangle.
    pub triangle: u32,
    /// The triangle's plane as seen from the viewpoint.
    pub facing: Facing,
    /// The part of the beam that the triangle covers.
    pub ring: Ring,
}

/// The pieces of a patch, with spare memory for more pieces.
#[derive(Default)]
pub(super) struct Patch {
    kept: Vec<Piece>,
    /// The number of pieces. Further entries of `kept` are spare memory.
    count: usize,
    /// Pairs of the index of a piece, and the id of another triangle with the same three points as the
    /// piece's triangle.
    twins: Vec<(usize, u32)>,
}

impl Patch {
    /// Returns the pieces.
    pub fn pieces(&self) -> &[Piece] {
        &self.kept[..self.count]
    }

    /// Removes all pieces.
    pub fn clear(&mut self) {
        self.count = 0;
        self.twins.clear();
    }

    /// Adds a triangle with the same three points as the triangle of the piece with this index.
    pub fn add_twin(&mut self, piece: usize, triangle: u32) {
        self.twins.push((piece, triangle));
    }

    /// Returns the ids of a piece's triangle and of the triangles with the same three points. `piece` is an
    /// index.
    pub fn triangles_of(&self, piece: usize) -> impl Iterator<Item = u32> {
        let twins = self.twins.iter().filter(move |t| t.0 == piece).map(|t| t.1);
        std::iter::once(self.pieces()[piece].triangle).chain(twins)
    }

    /// Adds a piece: the part `ring` of a beam that the triangle with this id covers.
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
