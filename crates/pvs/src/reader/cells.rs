//! Cell-to-cell visibility at run time. Engines cull moving objects by the cells that contain them, and
//! servers use the relation to hide clients from each other.

use super::Pvs;
use crate::CellPairs;
use crate::error::PvsError;
use crate::layout::Section;
use crate::tree::Node;

impl Pvs {
    /// Returns the cell-to-cell relations, or `None` if the file has none. The first call decodes the
    /// relations, which needs cells² / 8 bytes of memory per relation.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the relations are malformed although the checksums match.
    /// [`PvsError::Memory`] if memory is insufficient.
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

    /// Returns true if a point of cell `a` and a point of cell `b` may see each other. This is the case if an
    /// unobstructed segment between such points was found, or if the existence of such a segment is
    /// undecided. Every cell sees itself. The file contains no relation for two cells without viewpoints, so
    /// two such cells count as seeing each other.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if a cell does not exist. [`PvsError::NoPairs`] if the file has no relations.
    /// Also the errors of [`Self::cell_pairs`].
    pub fn sees(&self, a: u32, b: u32) -> Result<bool, PvsError> {
        self.leaf(a)?;
        self.leaf(b)?;
        let unknown = !self.is_reached(a)? && !self.is_reached(b)?;
        Ok(self.pairs()?.visible.has(a, b) || unknown)
    }

    /// Returns true if a point of a cell and a point of a box may see each other. The box extends from `min`
    /// to `max` in world space, and the function tests the cells that the box meets. Boxes that reach beyond
    /// the view box count as visible, because the file has no relations outside the view box. A box with a
    /// coordinate that is not a number counts as visible, too. From a cell without viewpoints, every box is
    /// visible.
    ///
    /// # Errors
    /// The errors of [`Self::sees`].
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
        // The cells below a node have consecutive numbers, so one test suffices for a node that the box
        // covers.
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
            // Each level adds at most one node, so the depth of the tree bounds the stack.
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

    /// Returns the size of the relations in the file in bytes, or 0 if the file has none.
    pub fn pair_bytes(&self) -> u64 {
        self.part(Section::CellPairs).len() as u64
    }

    fn pairs(&self) -> Result<&CellPairs, PvsError> {
        self.cell_pairs()?.ok_or(PvsError::NoPairs)
    }
}
