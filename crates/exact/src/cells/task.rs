//! The task of deciding one view cell, and its result.

use sightline_certificate::CellCertificate;

use crate::cells::exact_scene::ExactScene;
use crate::cells::sources::ExactViewRegion;
use crate::cells::statistics::QueryStatistics;
use crate::geometry::Cell;
use crate::search::Limits;

/// The task of deciding one cell.
pub struct Task<'a> {
    /// The prepared scene.
    pub scene: &'a ExactScene,
    /// The cell.
    pub cell: Cell,
    /// Where in space viewpoints are; `None` for everywhere.
    pub places: Option<&'a dyn ExactViewRegion>,
    /// Triangles that sampling has shown, ascending. Each is checked.
    pub seen: &'a [u32],
    /// Triangles hidden from the box of the cell group, ascending. None of them meets the cell.
    pub above: &'a [u32],
    /// All triangles that may be seen, ascending, if something has proved the others hidden. There is no
    /// certificate about these.
    pub listed: Option<&'a [u32]>,
    /// The limits of a single query.
    pub limits: Limits,
    /// Seed of the rays.
    pub seed: u64,
    /// Whether to keep witnesses and proofs.
    pub keep: bool,
    /// Called before every region of every query: whether to stop with the results so far.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// The decisions about one cell.
#[derive(Debug, Default, PartialEq)]
pub struct Decided {
    /// Triangles seen or meeting the cell, ascending.
    pub visible: Vec<u32>,
    /// Triangles neither seen nor proved hidden, ascending.
    pub undecided: Vec<u32>,
    /// Witnesses and proofs, if they are kept.
    pub certificate: CellCertificate,
    /// The work done.
    pub statistics: QueryStatistics,
}
