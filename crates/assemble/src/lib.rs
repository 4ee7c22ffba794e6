//! The outputs of a job's tiles, checked and joined to a result.
//!
//! A tile's output is checked against its job's plan ([`check()`]). When all are there, [`write`] joins them to a
//! `.pvs` file, and [`openness::write`] those of a job of ambient occlusion. A tile that cannot be computed gets a
//! [`placeholder()`]. The bytes depend on the job and the outputs alone. The crate knows no tracer, no store and
//! no network: whoever has the outputs implements [`Outputs`].

pub mod check;
mod columns;
mod info;
pub mod openness;
mod pairs;
mod placeholder;
mod result;
mod summary;

pub use check::{OutputError, check};
pub use placeholder::{expected_nodes, placeholder};
pub use result::{AssembleError, Assembly, items, write};
pub use summary::SceneSummary;

/// The state of a tile's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputState {
    /// There is none yet.
    Open,
    /// It was computed.
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
