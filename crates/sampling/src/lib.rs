//! Aggressive from-region sampling: visibility cubes on a GPU or CPU, error measures, adaptive refinement.
//!
//! The algorithm is that of Nirenstein and Blake, "Hardware Accelerated Visibility Preprocessing using Adaptive
//! Sampling" (2004), and chapter 4 of Nirenstein's thesis (2003). This crate knows nothing of jobs, leases or the
//! network: [`tile::run`] turns a tile of the plan, and the packs of the tiles it needs, into samples or sets.

pub mod auto;
pub mod backend;
pub mod cache;
pub mod codec;
pub mod cube;
pub mod embree;
pub mod gpu;
pub mod lines;
pub mod measure;
pub mod params;
mod reduce;
pub mod refine;
pub mod tile;

pub use backend::{Backend, BackendError, CubeRenderer};
pub use cube::{CubeImage, CubeSpec, SKY, Strata, VisibilitySample, near_distance};
pub use params::{BackendChoice, ErrorMeasure, ParamsError, Sampler, SamplingParams, SupersetChoice};
