//! Aggressive from-region sampling: sight lines and visibility cubes on a GPU or CPU.
//!
//! [`tile::run`] turns a tile of the plan, and the packs of the tiles it needs, into samples or sets, with
//! one of two samplers: sight lines ([`lines`]), or visibility cubes (`cubes`) after Nirenstein and Blake,
//! "Hardware Accelerated Visibility Preprocessing using Adaptive Sampling" (2004). Both trace through a
//! [`Backend`]: Embree or wgpu. This crate knows nothing of leases, stores or the network.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use glam::Vec3;
//! use sightline_sampling::{Backend as _, CubeSpec, Strata, embree::CpuBackend};
//!
//! // The triangles visible from one point, by a visibility cube of six item buffers with 256² pixels.
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let spec = CubeSpec { resolution: 256, strata: Strata::One, keep_pixels: false };
//! let backend = CpuBackend::new(scene, spec)?;
//! let samples = backend.prepare(None)?.samples(&[Vec3::new(1.5, 2.0, -3.0)])?;
//! println!("{:?}", samples[0].ids);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod auto;
mod backend;
mod context;
pub mod crew;
pub mod cube;
mod cubes;
pub mod embree;
mod error;
pub mod gpu;
pub mod layers;
pub mod lines;
pub mod packet;
mod prepared;
mod reduce;
pub mod rows;
pub mod sequence;
pub mod sight;
pub mod surface;
pub mod tile;

pub use backend::{Backend, CubeRenderer, LineSet};
pub use context::{JobContext, LineSampler, Places, TileSampler, Unwatched, Watcher};
pub use cube::{CubeImage, CubeSpec, SKY, Strata, near_distance};
pub use error::{BackendError, TileError};
pub use prepared::{PreparedScene, Traced};
pub use sightline_model::VisibilitySample;
pub use tile::TileCounters;
