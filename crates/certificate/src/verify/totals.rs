//! The counts of a verification.

use std::ops::AddAssign;

use sightline_numbers::Aabb;

use crate::certificate::{HiddenGroup, Target};

/// The number of claims of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// The number of claims in the result.
    pub all: u64,
    /// The number of claims that were checked, which is lower than `all` for a sample.
    pub checked: u64,
}

/// The number of pairs of cell and hidden triangle, by the kind of their group's target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hidden {
    /// The number of pairs whose triangle is hidden by the closed surface that it belongs to.
    pub by_surface: u64,
    /// The number of pairs whose triangle is hidden together with a box.
    pub in_boxes: u64,
    /// The number of pairs whose triangle is hidden individually or together with a polygon.
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

    /// Returns the number of all hidden pairs.
    pub fn sum(&self) -> u64 {
        self.by_surface + self.in_boxes + self.alone
    }
}

/// All counts of a verification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// The claims that a triangle is visible along a witness.
    pub witnesses: Count,
    /// The claims that a group of triangles is hidden.
    pub certificates: Count,
    /// The claims that a triangle meets the cell.
    pub meeting: Count,
    /// The pairs whose triangle is hidden from the cell.
    pub hidden: Hidden,
    /// The number of pairs of cell and undecided triangle.
    pub undecided: u64,
    /// The claims that a box around other cells is hidden from a cell.
    pub apart: Count,
    /// The number of pairs of cells that do not see each other.
    pub cells_apart: u64,
    /// The number of cells without viewpoints, which make no claims about triangles.
    pub cells_unreached: u64,
    /// The size of the certificates in the result, in bytes.
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
    /// The hidden groups of a cell group's certificate that pairs of a sample rely on. Each entry is the cell
    /// that stores the certificate, and the index of the hidden group in the certificate.
    pub group_claims: Vec<(u32, usize)>,
    /// The boxes that are hidden from the cell.
    pub apart: Vec<Aabb>,
}
