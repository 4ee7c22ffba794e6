//! The backend of tests that trace rays.

use std::sync::Arc;

use sightline_model::{JobSpec, Visibility};
use sightline_scene::Scene;
use sightline_trace::{CubeSpec, cpu::CpuBackend};

/// Returns the cubes of a job, or the default cubes if it renders none.
fn cubes(spec: &JobSpec) -> CubeSpec {
    let sampling = spec.visibility().and_then(Visibility::sampling);
    sampling.map_or_else(
        || CubeSpec::new(&sightline_model::CubeParams::default()),
        |sampling| CubeSpec::from_sampler(&sampling.sampler),
    )
}

/// Returns the cpu backend for a job.
pub fn cpu(scene: &Arc<Scene>, spec: &JobSpec) -> CpuBackend {
    CpuBackend::new(Arc::clone(scene), cubes(spec)).unwrap()
}
