//! Tracers: sight lines and visibility cubes of a scene on a GPU or CPU.
//!
//! A [`Backend`] (Embree or wgpu) traces lines in packets and renders cubes of item buffers. [`sight`] passes
//! see-through and masked triangles, [`layers`] does the same for cubes. [`lines`] has the table of a block
//! of view cells, which a device can fill with whole rounds of lines.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use glam::Vec3;
//! use sightline_trace::{Backend as _, CubeSpec, Strata, embree::CpuBackend};
//!
//! // The triangles visible from one point, by a visibility cube of six item buffers with 256² pixels.
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let spec = CubeSpec { resolution: 256, strata: Strata::One, keep_pixels: false };
//! let backend = CpuBackend::new(scene, spec)?;
//! let samples = backend.prepare(None)?.samples(&[Vec3::new(1.5, 2.0, -3.0)])?;
//! println!("{:?}", samples[0].ids);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backend;
pub mod cube;
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

pub use backend::{Backend, CubeRenderer, LineSet};
pub use cube::{CubeImage, CubeSpec, SKY, Strata, near_distance};
pub use error::BackendError;
pub use prepared::{CubeScene, LineScene, PreparedScene, Traced};
pub use sightline_model::VisibilitySample;
