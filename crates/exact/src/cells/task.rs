//! What is decided about one view cell: the task and its result.

use crate::cells::exact_scene::ExactScene;
use crate::cells::statistics::QueryStatistics;
use crate::evidence::Evidence;
use crate::geometry::Cell;
use crate::search::Limits;

/// How a cell is to be decided.
pub struct Task<'a> {
    /// What blocks.
    pub scene: &'a ExactScene,
    /// The cell.
    pub cell: Cell,
    /// Triangles sampling has shown, ascending: guesses, each of which is checked.
    pub seen: &'a [u32],
    /// Triangles that are hidden from a box around the cell, ascending: none of them meets the cell.
    pub above: &'a [u32],
    /// When a single query gives up.
    pub limits: Limits,
    /// Seed of the rays.
    pub seed: u64,
    /// Whether to keep witnesses and proofs.
    pub keep: bool,
    /// Asked before every region of every query whether to stop with what there is.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Told after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// What was decided about a cell.
#[derive(Debug, Default, PartialEq)]
pub struct Decided {
    /// Triangles seen or meeting the cell, ascending.
    pub visible: Vec<u32>,
    /// Triangles neither seen nor proved hidden, ascending.
    pub undecided: Vec<u32>,
    /// Witnesses and proofs, if they are kept.
    pub evidence: Evidence,
    /// What it took.
    pub statistics: QueryStatistics,
}
