//! The check of tile outputs and their assembly into a result.
//!
//! [`check()`] compares the output of a tile with the plan of the job. When all outputs exist, [`write()`]
//! joins them to a `.pvs` file, and [`openness::write`] joins the outputs of a job of ambient occlusion. A
//! tile that cannot be computed gets a [`placeholder()`]. Users of the crate implement [`Outputs`], the
//! access to stored outputs.
//!
//! # Modules
//!
//! - `check`, `placeholder`: the check of an output, and the output of a tile that was set aside.
//! - `assembly`, `result`: the parts of a result ([`Assembly`]), and the writer.
//! - `fine_sets`, `cells_by_cost`: the costs of boxes of a fine grid, and the result of cells by cost.
//! - `columns`, `pairs`, `info`, `summary`: statistics, cell-to-cell visibility, the description of the bake,
//!   and the facts about the scene ([`SceneSummary`]).
//! - `openness`: results of ambient occlusion.
//!
//! # Invariants
//!
//! - The bytes depend only on the job and the outputs. A result does not contain the worker, the machine or
//!   the time of a bake; the records of tiles contain times.
//! - A check cannot decide whether a set is right. To test that, a coordinator can lease a tile to other
//!   workers again.
//! - The memory of an assembly holds the coded sets and one tile at a time. Certificates go from file to
//!   file, so they can exceed the memory. The disk holds the tiles, the certificates a second time, and the
//!   result.
//! - The crate depends on no tracer, no store and no network.

mod assembly;
mod cells_by_cost;
pub mod check;
mod columns;
mod fine_sets;
mod info;
pub mod openness;
mod pairs;
mod placeholder;
mod result;
mod summary;

pub use assembly::Assembly;
pub use cells_by_cost::{ChosenCells, write_cells_by_cost};
pub use check::{OutputError, check};
pub use fine_sets::{
    BoxCosts, CellDivision, FineSets, FineSetsError, UnionCost, fine_planes, leaves,
};
pub use placeholder::{expected_nodes, placeholder};
pub use result::{AssembleError, items, write};
pub use summary::SceneSummary;

use sightline_viewcells::TileIndex;

/// The state of a tile's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputState {
    /// The tile has no output yet.
    Open,
    /// A worker has computed the output.
    Done,
    /// The tile failed too often and was set aside; its output is a placeholder.
    SetAside,
}

/// The outputs of a job's tiles.
pub trait Outputs {
    /// The error of reading an output.
    type Error;

    /// Returns the state of a tile's output.
    fn state(&self, tile: TileIndex) -> OutputState;

    /// Reads the output of a tile that is done or set aside.
    ///
    /// # Errors
    /// [`Self::Error`] if the output cannot be read.
    fn read(&self, tile: TileIndex) -> Result<Vec<u8>, Self::Error>;
}
