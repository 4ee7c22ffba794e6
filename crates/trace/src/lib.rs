//! Tracers: sight lines and visibility cubes of a scene on a GPU or CPU.
//!
//! A [`Tracer`] traces lines in packets and renders cubes of item buffers. This crate's tracer for processors
//! (`cpu`), wgpu (`gpu`) and Embree (`embree`) implement it. The interface in `tracer.rs` states everything
//! that a tracer must do. This crate does not choose lines; `crates/sample` does.
//!
//! # Modules
//!
//! - `tracer`, `packet`, `cube`: the interfaces of tracers, packets of sixteen lines, and cubes
//!   ([`CubeImage`]).
//! - `cpu`, `gpu`, `embree`: the three tracers. The documentation of `cpu` states the rule that determines
//!   its hits. `gpu/rounds` casts whole rounds of lines on the device. Embree is loaded at run time, for
//!   comparisons.
//! - `bvh`: the binary hierarchy from which the tracers `cpu` and `gpu` build theirs.
//! - `sight`, `layers`: lines and cubes that pass see-through and masked triangles.
//! - `lines`, `rows`: the table of a block of cells, with a row per triangle or item, and its device
//!   interface.
//! - `prepared`, `surface`, `sequence`, `reduce`: facts about a scene that are computed once
//!   ([`PreparedScene`]), neighbourhoods of triangles, low-discrepancy numbers, and samples of cube images.
//!
//! # Invariants
//!
//! - The answers of a tracer are a function of the scene, the query and the numerics profile. Among equal
//!   hits, the triangle that comes first in an order fixed by the scene counts.
//! - Facts about a scene are computed outside of rayon's pool, because a thread of the pool could wait for
//!   itself. [`PreparedScene`] panics on a thread of the pool.
//!
//! # Limits
//!
//! - Rounds do not run on the device for jobs with a region of viewpoints, for scenes with triangles that are
//!   not all opaque, and for the sampler `guided`. There the host chooses the lines that the device traces
//!   (`docs/decisions/0012-rounds-on-the-device.md`).
//! - The GPU tracer uses its own hierarchy, not the ray queries of a driver: no adapter that was available
//!   for measurements has these queries.
//!
//! # Example
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use glam::Vec3;
//! use sightline_trace::{Tracer as _, CubeSpec, Strata, cpu::CpuBackend};
//!
//! // The triangles visible from one point, by a visibility cube of six item buffers with 256² pixels.
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let spec = CubeSpec { resolution: 256, strata: Strata::One, keep_pixels: false };
//! let backend = CpuBackend::new(scene, spec)?;
//! let samples = backend.prepare(None)?.samples(&[Vec3::new(1.5, 2.0, -3.0)])?;
//! println!("{:?}", samples[0].ids);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bvh;
pub mod cpu;
pub mod cube;
#[cfg(not(target_family = "wasm"))]
pub mod embree;
mod error;
#[cfg(not(target_family = "wasm"))]
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
mod tracer;
mod width;

pub use cube::{CubeImage, CubeSpec, SKY, Strata, near_distance};
pub use error::TracerError;
pub use prepared::{CubeScene, LineScene, PreparedScene, Traced};
pub use sightline_model::VisibilitySample;
pub use tracer::{CubeRenderer, LineSet, Tracer};
pub use width::TooNarrow;
