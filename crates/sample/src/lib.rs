//! Samplers: which sight lines are cast and which visibility cubes are rendered, until a tile is done.
//!
//! [`tile::run`] turns a tile of the plan, and the packs of the tiles it needs, into samples or sets, with
//! one of two samplers: sight lines ([`lines`]), or visibility cubes (`cubes`) after Nirenstein and Blake,
//! "Hardware Accelerated Visibility Preprocessing using Adaptive Sampling" (2004). Both trace through a
//! [`Backend`](sightline_trace::Backend). This crate does not depend on leases, stores or the network.

pub mod auto;
mod context;
pub mod crew;
mod cubes;
mod error;
pub mod lines;
pub mod tile;

pub use context::{JobContext, LineSampler, TileSampler, Unwatched, ViewRegion, Watcher};
pub use error::TileError;
pub use tile::TileCounters;
