//! The backend of tests that trace.

use std::sync::Arc;

use sightline_model::JobSpec;
use sightline_sampling::{BackendError, CubeSpec, embree::CpuBackend};
use sightline_scene::Scene;

/// Embree; `None` without it, which under `CI` is a failure.
pub fn cpu(scene: &Arc<Scene>, spec: &JobSpec) -> Option<CpuBackend> {
    match CpuBackend::new(Arc::clone(scene), CubeSpec::of(&spec.sampling)) {
        Ok(backend) => Some(backend),
        Err(BackendError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run: {why}");
            None
        }
        Err(e) => panic!("{e}"),
    }
}
