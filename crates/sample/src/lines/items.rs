//! The items that each cell sees, if the table has a row for each triangle and items are clusters or objects.
//!
//! Items are gathered at each barrier, so that decisions about items read the state of the last barrier.

use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::grid::Slot;
use sightline_trace::rows::Rows;

/// A bit for each item and cell; empty if a row of the table is an item.
#[derive(Default)]
pub(super) struct SeenItems {
    words: usize,
    bits: Vec<u64>,
}

impl SeenItems {
    /// Gathers the items of all triangles that `seen` contains as of the last barrier.
    pub(super) fn gather(&mut self, rows: &Rows, seen: &SeenBits) {
        if rows.are_finer() {
            self.words = seen.words();
            self.bits.resize(rows.members().len() * self.words, 0);
            // Bits of the table are never removed, so the bits of the last barrier remain valid.
            seen.gather(rows.members(), &mut self.bits);
        }
    }

    /// Returns the bits of all items, or `None` if a row of the table is an item.
    pub(super) fn table(&self) -> Option<&[u64]> {
        Some(self.bits.as_slice()).filter(|bits| !bits.is_empty())
    }

    /// Returns the cells that see an item, as bits.
    pub(super) fn row(&self, item: u32) -> &[u64] {
        &self.bits[item as usize * self.words..][..self.words]
    }

    /// Returns true if an item is seen from a cell.
    pub(super) fn seen(&self, item: u32, slot: Slot) -> bool {
        self.row(item)[slot.word as usize] >> slot.bit & 1 == 1
    }
}
