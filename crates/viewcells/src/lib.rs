//! View cells: the integer lattice of sample positions, the boxes and rectangles on it, the kd-tree's splitting
//! rule, and the plan that cuts a bake into tiles.
//!
//! Everything here is a pure function of the view box and the division asked for. It knows nothing of
//! triangles, samples or the network.

pub mod cell;
pub mod division;
pub mod lattice;
pub mod plan;
pub mod rect;

pub use cell::{CellBox, Split};
pub use division::{Division, DivisionError, axis_name};
pub use lattice::{Lattice, LatticePoint, UNITS_PER_CELL};
pub use plan::{Layout, MOST_BLOCK_CELLS, Outline, Plan, Tile, TileKind};
pub use rect::Rect;
