//! Which cells see which, at run time: moving things are culled by the cells they are in, and a server
//! decides which client may know of which.

use super::Pvs;
use crate::CellPairs;
use crate::error::PvsError;
use crate::layout::Section;
use crate::tree::Node;

impl Pvs {
    /// Which cells see which; `None` when the file does not say. The first call decodes them, which takes
    /// cells² / 8 bytes of memory.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] for a file that was tampered with, [`PvsError::Memory`].
    pub fn cell_pairs(&self) -> Result<Option<&CellPairs>, PvsError> {
        if let Some(pairs) = self.pairs.get() {
            return Ok(pairs.as_ref());
        }
        let section = self.part(Section::CellPairs);
        let decoded = match self.layout.has(Section::CellPairs) {
            true => Some(CellPairs::decode(section, self.layout.cells)?),
            false => None,
        };
        Ok(self.pairs.get_or_init(|| decoded).as_ref())
    }

    /// Whether a point of cell `a` and a point of cell `b` may see each other: a segment between them was
    /// free, or it is undecided whether there is one. Every cell sees itself. Nothing is known of two cells
    /// without viewpoints, so they count as seeing each other.
    ///
    /// # Errors
    /// [`PvsError::NoCell`], [`PvsError::NoPairs`], and as [`Self::cell_pairs`].
    pub fn sees(&self, a: u32, b: u32) -> Result<bool, PvsError> {
        self.leaf(a)?;
        self.leaf(b)?;
        let unknown = !self.is_reached(a)? && !self.is_reached(b)?;
        Ok(self.pairs()?.visible.has(a, b) || unknown)
    }

    /// Whether a point of a cell and a point of the box from `min` to `max` (world space) may see each
    /// other, by the cells that the box meets. Nothing is known of places outside the view box, so a box
    /// that reaches beyond it counts as seen, and so does one with a coordinate that is not a number, and
    /// everything from a cell without viewpoints.
    ///
    /// # Errors
    /// As [`Self::sees`].
    pub fn sees_box(&self, cell: u32, min: [f32; 3], max: [f32; 3]) -> Result<bool, PvsError> {
        self.leaf(cell)?;
        let visible = &self.pairs()?.visible;
        if !self.is_reached(cell)? {
            return Ok(true);
        }
        let [lo, hi] = self.tree.view_box();
        if !(0..3).all(|a| lo[a] <= min[a] && min[a] <= max[a] && max[a] <= hi[a]) {
            return Ok(true);
        }
        // The cells below a node follow one another, so a node that the box covers is asked about at once.
        let mut open = [(0u32, lo, hi); crate::MAX_DEPTH + 1];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (node, lo, hi) = open[count];
            let [first, end] = self.tree.cells_below(node);
            if !visible.has_any(cell, first, end) {
                continue;
            }
            let covered = (0..3).all(|a| min[a] <= lo[a] && hi[a] <= max[a]);
            let (Node::Split { axis, at }, Some(upper), false) = (
                self.tree.nodes()[node as usize],
                self.tree.upper(node),
                covered,
            ) else {
                return Ok(true);
            };
            let a = usize::from(axis);
            let (mut below, mut above) = (hi, lo);
            (below[a], above[a]) = (at, at);
            // Each level adds one node at most, and the tree has at most that many levels.
            if max[a] >= at {
                open[count] = (upper, above, hi);
                count += 1;
            }
            if min[a] <= at {
                open[count] = (node + 1, lo, below);
                count += 1;
            }
        }
        Ok(false)
    }

    /// Bytes of the relations in the file; 0 when it has none.
    pub fn pair_bytes(&self) -> u64 {
        self.part(Section::CellPairs).len() as u64
    }

    fn pairs(&self) -> Result<&CellPairs, PvsError> {
        self.cell_pairs()?.ok_or(PvsError::NoPairs)
    }
}
