//! Rings and lists that are made on the way, in memory that is used again.

use super::beam::Ring;
use super::rounded::Rounded;
use super::stack::Entry;

/// Rings that are made on the way.
#[derive(Default)]
pub(super) struct Rings {
    pub signs: Vec<i32>,
    pub inside: Ring,
    pub next: Ring,
    pub far: Ring,
    /// The ways to the vertices of a face.
    pub ways: Vec<Rounded>,
    /// The cells that hold the viewpoint.
    pub start: Vec<Entry>,
    /// Parts outside of a triangle; most often fewer than three are in use.
    pub out: [Ring; 3],
}
