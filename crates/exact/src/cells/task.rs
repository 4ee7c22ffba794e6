//! The task of deciding one view cell, and the result of the task.

use sightline_certificate::CellCertificate;

use crate::cells::exact_scene::ExactScene;
use crate::cells::sources::ExactViewRegion;
use crate::cells::statistics::QueryStatistics;
use crate::geometry::Cell;
use crate::search::QueryLimits;

/// The task of deciding one cell.
pub struct CellTask<'a> {
    /// The prepared scene.
    pub scene: &'a ExactScene,
    /// The cell.
    pub cell: Cell,
    /// The part of space that contains viewpoints; `None` for all space.
    pub region: Option<&'a dyn ExactViewRegion>,
    /// The triangles that sampling has shown, in ascending order. The search returns such a triangle as
    /// visible only if the triangle meets the cell or the search finds a witness.
    pub seen: &'a [u32],
    /// The triangles hidden from the box of the cell group, in ascending order. None of these triangles meets
    /// the cell.
    pub above: &'a [u32],
    /// All triangles that may be visible, in ascending order, if another method has proved all other
    /// triangles hidden.
    ///
    /// The certificate contains no proofs about the other triangles.
    pub listed: Option<&'a [u32]>,
    /// The limits of a single query.
    pub limits: QueryLimits,
    /// The seed of the rays.
    pub seed: u64,
    /// True if the result contains the witnesses and proofs.
    pub keep: bool,
    /// The stop callback, called before every region of every query. If it returns true, the search ends with
    /// the results so far.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// The progress callback, called after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// The decisions about one cell.
#[derive(Debug, Default, PartialEq)]
pub struct CellDecisions {
    /// The triangles that have a witness or that meet the cell, in ascending order.
    pub visible: Vec<u32>,
    /// The triangles that have no witness and that are not proved hidden, in ascending order.
    pub undecided: Vec<u32>,
    /// The witnesses and proofs if [`CellTask::keep`] is true, otherwise empty.
    pub certificate: CellCertificate,
    /// The work done for the cell.
    pub statistics: QueryStatistics,
}
