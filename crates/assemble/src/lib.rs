//! The outputs of a job's tiles, checked and joined to a result.
//!
//! A tile's output is checked against its job's plan ([`check()`]). When all exist, [`write()`] joins them to
//! a `.pvs` file, and [`openness::write`] joins the outputs of a job of ambient occlusion. A tile that cannot
//! be computed gets a [`placeholder()`]. The bytes depend only on the job and the outputs. The crate depends
//! on no tracer, no store and no network: its users implement [`Outputs`].

mod assembly;
pub mod check;
mod columns;
mod info;
pub mod openness;
mod pairs;
mod placeholder;
mod result;
mod summary;

pub use assembly::Assembly;
pub use check::{OutputError, check};
pub use placeholder::{expected_nodes, placeholder};
pub use result::{AssembleError, items, write};
pub use summary::SceneSummary;

/// The state of a tile's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputState {
    /// There is none yet.
    Open,
    /// A worker has computed it.
    Done,
    /// The tile was given up; a placeholder is its output.
    SetAside,
}

/// The outputs of a job's tiles.
pub trait Outputs {
    /// The error of reading one.
    type Error;

    /// Returns the state of a tile's output.
    fn state(&self, tile: u32) -> OutputState;

    /// Reads the output of a tile that is done or set aside.
    ///
    /// # Errors
    /// The implementation's own.
    fn read(&self, tile: u32) -> Result<Vec<u8>, Self::Error>;
}
