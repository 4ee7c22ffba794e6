//! Query statistics: the work done for one cell, as counts that results store as columns.

use crate::search::QueryCost;

/// The work done for one cell. All counts are the same on every run that is not stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueryStatistics {
    /// The number of rays cast for witnesses.
    ///
    /// The first cell of a group also counts the rays, queries, boxes and cost of its group.
    pub rays: u64,
    /// The number of queried boxes, polygons and triangles.
    pub queries: u64,
    /// The number of boxes proved hidden as a whole.
    pub boxes: u64,
    /// The number of triangles that the closed surface that contains them hides.
    ///
    /// The number excludes triangles hidden from the box of the cell group.
    pub enclosed: u64,
    /// The number of triangles proved hidden.
    ///
    /// The number includes triangles in hidden boxes, triangles hidden by surfaces, and triangles hidden from
    /// the box of the cell group.
    pub hidden: u64,
    /// The number of triangles hidden from the box of the cell group.
    pub above: u64,
    /// The number of visible triangles that sampling had not shown.
    pub missed: u64,
    /// The number of hidden triangles that sampling had shown, because a ray passed through a seam.
    pub refuted: u64,
    /// The number of undecided triangles by reason: stopped, too many regions, too much memory, halved too
    /// often.
    pub open: [u64; 4],
    /// The summed cost of the queries.
    pub cost: QueryCost,
}

impl QueryStatistics {
    /// Adds the rays, queries, boxes and cost of the group whose first cell is this cell.
    pub fn add_asked(&mut self, o: &Self) {
        self.rays += o.rays;
        self.queries += o.queries;
        self.boxes += o.boxes;
        self.cost += o.cost;
    }
}
