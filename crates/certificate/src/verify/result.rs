//! The interface of a baked result that [`verify`](super::verify) reads.

use sightline_numbers::Aabb;

/// The flag of a cell whose bake failed. All triangles are in its set as undecided.
pub const SET_ASIDE: u32 = 1;
/// The flag of a cell without viewpoints. The set of the cell is empty.
pub const NOT_REACHED: u32 = 2;

/// A baked result with certificates. Cells are numbered from 0, and triangles are in the order of the scene.
///
/// The feature `pvs` implements this trait for `sightline_pvs::Pvs`. Errors are messages about the stored
/// data.
pub trait BakedResult: Sync {
    /// Returns the name of the method. Results of the methods `exact` and `verified` have certificates.
    fn method(&self) -> &str;

    /// Returns the parameters of the bake as JSON, or an empty object without parameters.
    fn parameters(&self) -> &str {
        "{}"
    }

    /// Returns the number of cells.
    fn cell_count(&self) -> u32;

    /// Returns the number of triangles of the scene.
    fn triangle_count(&self) -> u32;

    /// Returns the lowest and highest corner of a cell in scene coordinates, or `None` if the cell does not
    /// exist.
    fn cell_bounds(&self, cell: u32) -> Option<Aabb>;

    /// Returns the visibility set of a cell including its undecided triangles, ascending.
    ///
    /// # Errors
    /// A message if the set cannot be decoded.
    fn visible(&self, cell: u32) -> Result<Vec<u32>, String>;

    /// Returns the undecided triangles of a cell, ascending.
    ///
    /// # Errors
    /// A message if the set cannot be decoded.
    fn undecided(&self, cell: u32) -> Result<Vec<u32>, String>;

    /// Returns the bytes of a cell's certificate ([`crate::codec`]), which are empty for a cell that was set
    /// aside. Returns `None` for a result without certificates.
    ///
    /// # Errors
    /// A message if the cell does not exist.
    fn certificate(&self, cell: u32) -> Result<Option<&[u8]>, String>;

    /// Returns the cells that a cell sees, ascending, including the cells for which this is undecided.
    /// Returns `None` for a result without cell-to-cell relations.
    ///
    /// # Errors
    /// A message if the cell does not exist.
    fn seen_cells(&self, _cell: u32) -> Result<Option<Vec<u32>>, String> {
        Ok(None)
    }

    /// Returns the flags of a cell: [`SET_ASIDE`], [`NOT_REACHED`] or 0.
    ///
    /// # Errors
    /// A message if the cell does not exist.
    fn flags(&self, _cell: u32) -> Result<u32, String> {
        Ok(0)
    }
}
