//! The table of a block: its cells, and the rows (triangles or items) that were credited to each cell.

use glam::Vec3;
use rayon::prelude::*;
use sightline_model::CellStats;
use sightline_numbers::Aabb;
use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::grid::{CellGrid, Crossed, Slot};
use sightline_trace::rows::Rows;
use sightline_trace::sequence::{Hashed, spread3};
use sightline_viewcells::part_mask::PARTS;

use super::items::SeenItems;
use crate::context::ViewRegion;

/// The number of points that are tried as a viewpoint before any point of the region is used. If the region
/// fills less than one in this number of the marked parts, its viewpoints are not spread evenly.
const TRIES: usize = 200;

/// A view cell of the block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// The coordinates of the cell in the block's grid.
    pub(super) at: [u32; 3],
    /// The position of the cell's bit in each row of the table.
    pub(super) slot: Slot,
    /// The minimum corner of the cell, in world space.
    pub(super) lo: Vec3,
    pub(super) size: Vec3,
    /// The number of the cell in the whole division, which selects the cell's random numbers.
    pub(super) number: u64,
    /// The marks of the parts with viewpoints ([`sightline_viewcells::PartMask`]); all 64 bits are 1 if every
    /// part contains viewpoints.
    pub(super) parts: u64,
}

impl Cell {
    /// Returns a viewpoint at fractions of the cell's size.
    ///
    /// If only some parts of the cell contain viewpoints, the first fraction also selects one of these parts.
    /// This keeps the points of a sequence evenly spread.
    pub(super) fn point(&self, f: impl Into<Vec3>) -> [f32; 3] {
        let mut f: Vec3 = f.into();
        if self.parts != u64::MAX {
            let place = f.x * self.parts.count_ones() as f32;
            let mut rest = self.parts;
            // Rounding may result in the number of parts itself.
            for _ in 0..(place as u32).min(self.parts.count_ones().saturating_sub(1)) {
                rest &= rest - 1;
            }
            let part = rest.trailing_zeros();
            let at = Vec3::new(
                (part % PARTS) as f32,
                (part / PARTS % PARTS) as f32,
                (part / PARTS / PARTS) as f32,
            );
            f = (at + Vec3::new(place.fract(), f.y, f.z)) / PARTS as f32;
        }
        (self.lo + self.size * f).to_array()
    }

    /// Returns a viewpoint near fractions of the cell's size.
    ///
    /// If viewpoints are restricted to a region, this is the first point in the region of a spread sequence
    /// that starts there, or any point of the region in the cell.
    pub(super) fn origin(&self, region: Option<&dyn ViewRegion>, f: impl Into<Vec3>) -> [f32; 3] {
        let f: Vec3 = f.into();
        let Some(region) = region else {
            return self.point(f);
        };
        let tries = (1..).map(|number| self.point(spread3(number, f.to_array())));
        self.first_inside(region, std::iter::once(self.point(f)).chain(tries))
            .unwrap_or_else(|| self.point(f))
    }

    /// Returns a random viewpoint, uniform over the viewpoints, unless the region fills only a small fraction
    /// of the marked parts ([`TRIES`]).
    pub(super) fn random_origin(
        &self,
        region: Option<&dyn ViewRegion>,
        random: &mut Hashed,
    ) -> [f32; 3] {
        let first = self.point(random.point());
        let Some(region) = region else { return first };
        let tries =
            std::iter::once(first).chain(std::iter::repeat_with(|| self.point(random.point())));
        self.first_inside(region, tries).unwrap_or(first)
    }

    /// Returns the first of at most [`TRIES`] points that is in the region, otherwise any point of the region
    /// in the cell, or `None` if the cell contains no such point.
    fn first_inside(
        &self,
        region: &dyn ViewRegion,
        points: impl Iterator<Item = [f32; 3]>,
    ) -> Option<[f32; 3]> {
        points
            .take(TRIES)
            .find(|p| region.hold(Vec3::from(*p)))
            .or_else(|| {
                let own = Aabb::new(self.lo, self.lo + self.size);
                region.any_in(own).map(|p| p.to_array())
            })
    }

    /// Returns true if viewpoints are everywhere in the cell.
    pub(super) fn is_whole(&self) -> bool {
        self.parts == u64::MAX
    }
}

/// The cells of a block, and the rows that were credited to each cell.
pub(super) struct CellTable<'a> {
    pub(super) grid: CellGrid,
    /// The rows that were credited to each cell.
    pub(super) bits: SeenBits,
    /// The items that each cell sees; empty unless rows are finer than items.
    pub(super) items: SeenItems,
    /// The cells in the order of [`CellGrid::each`].
    pub(super) cells: Vec<Cell>,
    /// The statistics of each of `cells`.
    pub(super) stats: Vec<CellStats>,
    /// The row of each triangle; empty if the row is the triangle's id. The table has its own reference
    /// because every line reads it.
    rows: &'a [u32],
    /// A bit for each cell with viewpoints, in the layout of a row; empty if all cells have viewpoints.
    reached: Vec<u64>,
}

impl<'a> CellTable<'a> {
    /// Creates a table without credits.
    ///
    /// `number` returns a number of a cell that no other cell of the job has. `parts` returns the parts of a
    /// cell that contain viewpoints.
    pub(super) fn new(
        rows: &'a Rows,
        grid: CellGrid,
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
    ) -> Self {
        let cells: Vec<Cell> = grid
            .each()
            .map(|at| {
                let (lo, size) = grid.cell_box(at);
                Cell {
                    at,
                    slot: grid.slot(at),
                    lo,
                    size,
                    number: number(at),
                    parts: parts(at),
                }
            })
            .collect();
        let mut reached = Vec::new();
        if cells.iter().any(|c| c.parts == 0) {
            reached.resize(grid.words(), 0u64);
            let with = cells.iter().filter(|c| c.parts != 0);
            with.for_each(|c| reached[c.slot.word as usize] |= 1 << c.slot.bit);
        }
        Self {
            bits: SeenBits::new(rows.count(), grid.words()),
            grid,
            items: SeenItems::default(),
            stats: vec![CellStats::default(); cells.len()],
            cells,
            rows: rows.of_triangles(),
            reached,
        }
    }

    /// Returns true if a cell has a viewpoint. `cell` is the cell's index in `cells`.
    pub(super) fn is_reached(&self, cell: usize) -> bool {
        self.cells[cell].parts != 0
    }

    /// Returns a bit for each cell with viewpoints, in the layout of a row of the table. The list is empty if
    /// all cells have viewpoints.
    pub(super) fn reached(&self) -> &[u64] {
        &self.reached
    }

    /// Returns the indices in `cells` of the cells with viewpoints.
    pub(super) fn active(&self) -> Vec<usize> {
        (0..self.cells.len())
            .filter(|c| self.is_reached(*c))
            .collect()
    }

    /// Returns the number of pairs of one of `cells` and an item that it saw by the last barrier.
    pub(super) fn seen_items(&self, cells: &[usize]) -> u64 {
        let mut wanted = vec![0u64; self.bits.words()];
        for cell in cells {
            let slot = self.cells[*cell].slot;
            wanted[slot.word as usize] |= 1 << slot.bit;
        }
        let table = self.items.table().unwrap_or(self.bits.table());
        let rows = table.par_chunks(wanted.len()).with_min_len(1024);
        let count = |row: &[u64]| {
            let seen = row.iter().zip(&wanted).map(|(r, w)| (r & w).count_ones());
            u64::from(seen.sum::<u32>())
        };
        rows.map(count).sum()
    }

    /// Returns the index of a triangle's row in the table.
    #[inline]
    pub(super) fn row(&self, triangle: u32) -> u32 {
        if self.rows.is_empty() {
            triangle
        } else {
            self.rows[triangle as usize]
        }
    }

    /// Publishes all credits since the last barrier.
    pub(super) fn publish(&mut self, rows: &Rows) {
        self.bits.publish();
        self.items.gather(rows, &self.bits);
    }

    /// Returns true if a triangle's row was credited to a cell at the last barrier.
    pub(super) fn seen(&self, triangle: u32, slot: Slot) -> bool {
        self.bits.seen(self.row(triangle), slot)
    }

    /// Credits cells with a triangle's row. The caller has removed the cells without viewpoints.
    pub(super) fn credit(&self, triangle: u32, crossed: &[(u32, u64)]) {
        self.bits.credit(self.row(triangle), crossed);
    }

    /// Credits a cell with a triangle's row if the cell has viewpoints.
    pub(super) fn credit_one(&self, triangle: u32, slot: Slot) {
        if self.has_viewpoints(slot) {
            self.credit(triangle, &[(slot.word, 1 << slot.bit)]);
        }
    }

    /// Returns true if a cell has viewpoints.
    pub(super) fn has_viewpoints(&self, slot: Slot) -> bool {
        self.reached.is_empty() || self.reached[slot.word as usize] >> slot.bit & 1 == 1
    }

    /// Removes the cells without viewpoints from the crossed cells.
    pub(super) fn only_reached(&self, crossed: &mut Crossed) {
        if !self.reached.is_empty() {
            crossed
                .iter_mut()
                .for_each(|(word, bits)| *bits &= self.reached[*word as usize]);
        }
    }
}
