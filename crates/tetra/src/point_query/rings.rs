//! Temporary rings and lists, in reusable memory.

use super::beam::Ring;
use super::rounded::Rounded;
use super::stack::StackEntry;

/// Temporary rings and lists of a query.
#[derive(Default)]
pub(super) struct Rings {
    /// The signs of a ring's corners relative to a plane.
    pub signs: Vec<i32>,
    /// The part of a beam that is being clipped.
    pub inside: Ring,
    /// The part of a cut ring on the inner side of the plane.
    pub next: Ring,
    /// The part of a cut ring on the outer side of the plane.
    pub far: Ring,
    /// The directions to the vertices of a face.
    pub ways: Vec<Rounded>,
    /// The entries of the cells that contain the viewpoint.
    pub start: Vec<StackEntry>,
    /// The parts of a beam outside of a triangle. Usually fewer than three are used.
    pub out: [Ring; 3],
}
