//! The interface of a baked result that [`verify`](super::verify) reads.

use sightline_numbers::Aabb;

/// The bit of a cell's flags that says that its bake failed and all triangles are in its set as undecided.
pub const SET_ASIDE: u32 = 1;
/// The bit of a cell's flags that says that no viewpoint is in the cell, so that its set is empty.
pub const NOT_REACHED: u32 = 2;

/// A baked result with certificates. Cells are numbered from 0, triangles in the order of the scene.
///
/// The feature `pvs` implements it for `sightline_pvs::Pvs`. Errors are messages about the stored data.
pub trait BakedResult: Sync {
    /// The name of the method: `exact` and `verified` results have certificates.
    fn method(&self) -> &str;

    /// The parameters of the bake as JSON; an empty object if there are none.
    fn parameters(&self) -> &str {
        "{}"
    }

    /// The number of cells.
    fn cell_count(&self) -> u32;

    /// The number of triangles of the scene.
    fn triangle_count(&self) -> u32;

    /// Least and greatest corner of a cell, in scene coordinates; `None` if there is no such cell.
    fn cell_bounds(&self, cell: u32) -> Option<Aabb>;

    /// The visibility set of a cell with its undecided triangles, ascending.
    ///
    /// # Errors
    /// A message if the set cannot be decoded.
    fn visible(&self, cell: u32) -> Result<Vec<u32>, String>;

    /// The undecided triangles of a cell, ascending.
    ///
    /// # Errors
    /// A message if the set cannot be decoded.
    fn undecided(&self, cell: u32) -> Result<Vec<u32>, String>;

    /// The bytes of a cell's certificate ([`crate::codec`]), empty for a cell that was set aside; `None` for
    /// a result without certificates.
    ///
    /// # Errors
    /// A message if there is no such cell.
    fn certificate(&self, cell: u32) -> Result<Option<&[u8]>, String>;

    /// The cells that a cell sees, ascending, with the undecided ones; `None` for a result that does not say
    /// which cells see which.
    ///
    /// # Errors
    /// A message if there is no such cell.
    fn seen_cells(&self, _cell: u32) -> Result<Option<Vec<u32>>, String> {
        Ok(None)
    }

    /// The flags of a cell: [`SET_ASIDE`], [`NOT_REACHED`] or 0.
    ///
    /// # Errors
    /// A message if there is no such cell.
    fn flags(&self, _cell: u32) -> Result<u32, String> {
        Ok(0)
    }
}
