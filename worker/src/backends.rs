//! The sampling backends of this machine, by numerics profile.

use std::sync::Arc;

use sightline_scene::Scene;
use sightline_trace::embree::CpuBackend;
use sightline_trace::gpu::{self, AdapterChoice, GpuBackend};
use sightline_trace::{Backend, BackendError, CubeSpec};

/// Which backends a worker may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TracerSelection {
    /// All backends of this machine.
    Auto,
    /// As `Auto`, but where Embree works and no GPU is present, software rasterisers are not started: a
    /// coordinator does not bind a job to one if a worker has Embree.
    Fast,
    /// wgpu only.
    Gpu,
    /// Embree only.
    Cpu,
}

/// The profiles of the backends that work on this machine, and the reasons why the others do not.
pub struct Backends {
    cpu: Result<String, String>,
    gpu: Result<String, String>,
    adapter: AdapterChoice,
    /// Whether the gpu backend is a software rasteriser.
    software: bool,
    /// Whether no software rasteriser was looked for.
    skipped_software: bool,
}

impl Backends {
    /// Tries the backends of `choice` on this machine.
    pub fn probe(choice: TracerSelection, adapter: AdapterChoice) -> Self {
        let not_asked = || Err("not asked for".to_owned());
        let say = |r: Result<String, BackendError>| r.map_err(|e| e.to_string());
        let cpu = if choice == TracerSelection::Gpu {
            not_asked()
        } else {
            say(CpuBackend::probe())
        };
        // Starting a software driver takes longer than a small bake.
        let skipped_software =
            choice == TracerSelection::Fast && cpu.is_ok() && !gpu::device_present();
        let gpu = if choice == TracerSelection::Cpu || skipped_software {
            not_asked()
        } else {
            say(gpu::probe(&adapter))
        };
        let software = gpu.is_ok()
            && gpu::adapters()
                .iter()
                .any(|a| a.software && gpu.as_ref() == Ok(&a.profile));
        Self {
            software,
            skipped_software,
            gpu,
            cpu,
            adapter,
        }
    }

    /// Profiles of the backends that work, cpu first.
    pub fn profiles(&self) -> Vec<String> {
        [&self.cpu, &self.gpu]
            .into_iter()
            .filter_map(|r| r.as_ref().ok().cloned())
            .collect()
    }

    /// Whether no software rasteriser was looked for, because no job would be bound to one.
    pub fn skipped_software(&self) -> bool {
        self.skipped_software
    }

    /// Whether `profile` belongs to a software rasteriser.
    pub fn is_software(&self, profile: &str) -> bool {
        self.software && self.gpu.as_deref() == Ok(profile)
    }

    /// One line for users for each requested backend that does not work.
    pub fn missing(&self) -> Vec<String> {
        let line = |name: &str, r: &Result<String, String>| {
            r.as_ref()
                .err()
                .filter(|e| *e != "not asked for")
                .map(|e| format!("{name} backend: {e}"))
        };
        [line("cpu", &self.cpu), line("gpu", &self.gpu)]
            .into_iter()
            .flatten()
            .collect()
    }

    /// Opens the backend with the numerics profile `profile` for a scene.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] when this machine does not have the profile; otherwise the error of the
    /// backend.
    pub fn open(
        &self,
        profile: &str,
        scene: Arc<Scene>,
        spec: CubeSpec,
    ) -> Result<Arc<dyn Backend>, BackendError> {
        if self.cpu.as_deref() == Ok(profile) {
            Ok(Arc::new(CpuBackend::new(scene, spec)?))
        } else if self.gpu.as_deref() == Ok(profile) {
            let backend = GpuBackend::new(scene, spec, self.adapter.clone())?;
            // Another adapter may have been opened in the place of one that has failed since.
            if backend.profile() != profile {
                return Err(BackendError::Unavailable(format!(
                    "the adapter with the numerics profile {profile} can no longer be opened; restart the \
                     worker"
                )));
            }
            Ok(Arc::new(backend))
        } else {
            Err(BackendError::Unavailable(format!(
                "this worker has no backend with the numerics profile {profile}; it has: {}",
                self.profiles().join(", ")
            )))
        }
    }
}
