//! Aggressive from-region sampling: visibility cubes on a GPU or CPU, error measures, adaptive refinement.

pub mod backend;
pub mod cube;
pub mod gpu;

pub use backend::{Backend, BackendError, CubeRenderer};
pub use cube::{CubeImage, CubeSpec, SKY, Strata, VisibilitySample};
