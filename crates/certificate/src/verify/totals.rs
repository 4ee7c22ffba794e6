//! The counts of a verification.

use std::ops::AddAssign;

use sightline_numbers::Aabb;

use crate::certificate::{HiddenGroup, Target};

/// Claims of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Claims in the result.
    pub all: u64,
    /// Claims that were checked; fewer than `all` for a sample.
    pub checked: u64,
}

/// Pairs of cell and hidden triangle, by the kind of their group's target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hidden {
    /// Hidden by the closed surface that the triangle belongs to.
    pub by_surface: u64,
    /// Hidden together with a box.
    pub in_boxes: u64,
    /// Hidden alone or together with a polygon.
    pub alone: u64,
}

impl Hidden {
    /// Adds the triangles of a group.
    pub(super) fn add(&mut self, group: &HiddenGroup) {
        let count = match &group.target {
            Target::Surfaces => &mut self.by_surface,
            Target::Box(_) => &mut self.in_boxes,
            Target::Triangle | Target::Half | Target::Polygon(_) => &mut self.alone,
        };
        *count += group.triangles.len() as u64;
    }

    /// All hidden pairs.
    pub fn sum(&self) -> u64 {
        self.by_surface + self.in_boxes + self.alone
    }
}

/// Everything that a verification counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Pairs with a witness.
    pub witnesses: Count,
    /// Groups of hidden triangles, each with its proofs.
    pub certificates: Count,
    /// Pairs whose triangle meets the cell.
    pub meeting: Count,
    /// Pairs that are hidden.
    pub hidden: Hidden,
    /// Pairs that are undecided.
    pub undecided: u64,
    /// Boxes around other cells that are hidden from a cell.
    pub apart: Count,
    /// Pairs of cells that do not see each other.
    pub cells_apart: u64,
    /// Cells without viewpoints; nothing is claimed about triangles seen from them.
    pub cells_unreached: u64,
    /// Bytes of the certificates in the result.
    pub bytes: u64,
}

impl AddAssign for Count {
    fn add_assign(&mut self, o: Self) {
        self.all += o.all;
        self.checked += o.checked;
    }
}

impl AddAssign for Totals {
    fn add_assign(&mut self, o: Self) {
        self.witnesses += o.witnesses;
        self.certificates += o.certificates;
        self.meeting += o.meeting;
        self.hidden.by_surface += o.hidden.by_surface;
        self.hidden.in_boxes += o.hidden.in_boxes;
        self.hidden.alone += o.hidden.alone;
        self.undecided += o.undecided;
        self.apart += o.apart;
        self.cells_apart += o.cells_apart;
        self.cells_unreached += o.cells_unreached;
        self.bytes += o.bytes;
    }
}

/// The counts of one cell.
#[derive(Default)]
pub(super) struct CellTotals {
    pub totals: Totals,
    /// Groups of a cell group that pairs of a sample rely on: the cell that stores each, and its index there.
    pub group_claims: Vec<(u32, usize)>,
    /// The boxes that are hidden from the cell.
    pub apart: Vec<Aabb>,
}
