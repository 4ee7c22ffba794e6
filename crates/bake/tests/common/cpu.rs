//! The backend of tests that trace.

use std::sync::Arc;

use sightline_model::{JobSpec, Visibility};
use sightline_scene::Scene;
use sightline_trace::{BackendError, CubeSpec, embree::CpuBackend};

/// Returns the cubes of a job, or the default cubes if it renders none.
fn cubes(spec: &JobSpec) -> CubeSpec {
    let sampling = spec.visibility().and_then(Visibility::sampling);
    sampling.map_or_else(
        || CubeSpec::new(&sightline_model::CubeParams::default()),
        |sampling| CubeSpec::of(&sampling.sampler),
    )
}

/// Returns Embree; `None` without it, which under `CI` is a failure.
pub fn cpu(scene: &Arc<Scene>, spec: &JobSpec) -> Option<CpuBackend> {
    match CpuBackend::new(Arc::clone(scene), cubes(spec)) {
        Ok(backend) => Some(backend),
        Err(BackendError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run: {why}");
            None
        }
        Err(e) => panic!("{e}"),
    }
}
