//! Aggressive from-region sampling: sight lines and visibility cubes on a GPU or CPU.
//!
//! [`tile::run`] turns a tile of the plan, and the packs of the tiles it needs, into samples or sets, with
//! one of two samplers: sight lines ([`lines`]), or visibility cubes ([`cubes`]) after Nirenstein and Blake,
//! "Hardware Accelerated Visibility Preprocessing using Adaptive Sampling" (2004). Both trace through a
//! [`Backend`]: Embree or wgpu. This crate knows nothing of leases, stores or the network.

pub mod auto;
pub mod backend;
pub mod context;
pub mod cube;
pub mod cubes;
pub mod embree;
pub mod error;
pub mod gpu;
pub mod lines;
pub mod packet;
pub mod prepared;
mod reduce;
pub mod sequence;
pub mod surface;
pub mod tile;

pub use backend::{Backend, CubeRenderer};
pub use context::{JobContext, TileError, Watcher};
pub use cube::{CubeImage, CubeSpec, SKY, Strata, near_distance};
pub use error::BackendError;
pub use prepared::PreparedScene;
pub use sightline_model::VisibilitySample;
pub use tile::TileCounters;
