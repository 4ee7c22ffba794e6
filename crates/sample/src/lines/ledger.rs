//! What lines were cast for and what they found: for those who want to improve the sampler. A sampler without
//! a ledger keeps nothing of this, and with one it finds the same.

use std::time::Duration;

use sightline_model::LineKind;

/// A try at a candidate.
#[derive(Clone, Copy, Debug)]
pub struct Try {
    /// The cell, by its place in [`sightline_trace::lines::grid::CellGrid::each`].
    pub cell: usize,
    /// The triangle.
    pub triangle: u32,
    /// The part of the sphere that it would cover.
    pub part: f32,
    /// How many tries of this round came before.
    pub time: u32,
    /// Through how many of the cell's faces the next cell sees it.
    pub faces: u32,
    /// How many of the triangles beside it the cell sees.
    pub beside: u32,
    /// Whether the line met it.
    pub found: bool,
}

/// Who keeps account.
pub trait Ledger: Sync {
    /// Whether it wants [`Self::tried`], which takes time at each try.
    fn wants_tries(&self) -> bool;

    /// Lines of a kind were cast from a cell: rays, triangles that they were the first to show, and the time
    /// that they took. The round of uniform and flood lines is the cell's own, counted over all searches.
    fn spent(&self, round: u32, kind: LineKind, rays: u64, finds: u64, time: Duration);

    /// A candidate was aimed at.
    fn tried(&self, round: u32, of: Try);
}
