//! Query statistics: the work done for one cell, as numbers that results store.

use crate::search::Cost;

/// The work done for one cell. All counts are the same on every run that is not stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueryStatistics {
    /// Rays cast for witnesses. The first cell of a group also counts the rays, queries, boxes and cost of
    /// its group.
    pub rays: u64,
    /// Boxes and triangles queried.
    pub queries: u64,
    /// Boxes proved hidden as a whole.
    pub boxes: u64,
    /// Triangles hidden by the closed surface they are part of, except those hidden from the box of the cell
    /// group.
    pub enclosed: u64,
    /// Triangles proved hidden, including those in hidden boxes, those hidden by surfaces and those hidden
    /// from the box of the cell group.
    pub hidden: u64,
    /// Triangles hidden from the box of the cell group.
    pub above: u64,
    /// Triangles that sampling had not shown and that are visible.
    pub missed: u64,
    /// Triangles that sampling had shown and that are hidden: seen through a seam.
    pub refuted: u64,
    /// Undecided triangles by reason: stopped, too many regions, too much memory, halved too often.
    pub open: [u64; 4],
    /// The summed cost of the queries.
    pub cost: Cost,
}

impl QueryStatistics {
    /// Adds the work done for the group that this cell is the first of.
    pub fn add_asked(&mut self, o: &Self) {
        self.rays += o.rays;
        self.queries += o.queries;
        self.boxes += o.boxes;
        self.cost += o.cost;
    }
}
