//! View cells and the plan of a bake.
//!
//! The crate contains the integer lattice of sample positions, the boxes and rectangles on the lattice, the
//! divisions of the view box, and the plan that divides a bake into tiles. The crate does not depend on
//! triangles, samples or the network.
//!
//! # Modules
//!
//! - `lattice`, `rect`, `cell`: [`Lattice`], the integer positions; [`Rect`] and [`CellBox`] on the lattice.
//! - `division`, `kd_tree`: [`Division`], a regular grid, an adaptive tree, or a given [`KdTree`].
//! - `cheapest`: [`CheapestTrees`](cheapest::CheapestTrees), the trees over a fine grid with the least cost
//!   for their size.
//! - `plan`: [`Plan`] and its [`Tile`]s, with the tiles whose samples each tile needs.
//! - `part_mask`, `region`: [`PartMask`] and [`Region`], the parts of cells and of space with viewpoints.
//!
//! # Invariants
//!
//! - Positions are integers until they are rendered, so neighbouring cells agree on every position.
//! - All functions are pure functions of the view box and its division.
//! - A change of the plan changes the bytes of results, and requires a new `ALGORITHM_VERSION`
//!   (`crates/model/src/job/spec.rs`).
//!
//! # Example
//!
//! ```
//! use glam::Vec3;
//! use sightline_viewcells::{Division, Layout, Plan};
//!
//! // A grid of 4 × 1 × 2 cells over a box of 8 × 3 × 4 metres, in blocks of at most four cells.
//! let division = Division::Grid([4, 1, 2]);
//! let lattice = division.lattice(Vec3::ZERO, Vec3::new(8.0, 3.0, 4.0))?;
//! let plan = Plan::new(&division, &lattice, Layout::Blocks(4));
//! assert_eq!(plan.tiles.iter().map(|tile| tile.cells).collect::<Vec<_>>(), [4, 4]);
//! # Ok::<(), sightline_viewcells::DivisionError>(())
//! ```

pub mod cell;
pub mod cheapest;
pub mod division;
pub mod kd_tree;
pub mod lattice;
pub mod part_mask;
pub mod plan;
pub mod rect;
pub mod region;

pub use cell::{CellBox, Split, axis_name};
pub use division::{Division, DivisionError};
pub use kd_tree::{KdTree, MOST_BOXES, PlaneError, TreeError};
pub use lattice::{Lattice, LatticePoint, UNITS_PER_CELL};
pub use part_mask::{PartMask, PartMaskError};
pub use plan::{Layout, MOST_BLOCK_CELLS, Outline, Plan, Tile, TileKind, USUAL_BLOCK_CELLS};
pub use rect::Rect;
pub use region::{Region, RegionError, RegionNode};
pub use sightline_numbers::ids::{CellIndex, TileIndex};
