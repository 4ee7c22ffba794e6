//! The sampling backends of this machine, by numerics profile.

use std::sync::Arc;

use sightline_scene::Scene;
use sightline_trace::cpu::{self, CpuBackend};
use sightline_trace::embree::EmbreeBackend;
use sightline_trace::gpu::{self, AdapterChoice, GpuBackend};
use sightline_trace::{CubeSpec, Tracer, TracerError};

/// The backends that a worker may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TracerSelection {
    /// The cpu backend, and wgpu if it works.
    Auto,
    /// The cpu backend, and wgpu if it works on a GPU.
    ///
    /// The coordinator does not bind a job to a software rasteriser if a worker has the cpu backend.
    Fast,
    /// Only wgpu.
    Gpu,
    /// Only the cpu backend.
    Cpu,
    /// Only Embree.
    Embree,
}

/// The profiles of the working backends of this machine, and the reasons why other backends do not work.
pub struct Backends {
    /// True if the cpu backend is requested. It works on every machine.
    cpu: bool,
    embree: Probed,
    gpu: Probed,
    adapter: AdapterChoice,
    /// True if the gpu backend is a software rasteriser.
    software: bool,
    /// True if software rasterisers were not probed.
    skipped_software: bool,
}

/// A backend that can be missing.
enum Probed {
    /// The backend is not requested.
    Unused,
    /// The backend works and has this numerics profile.
    Works(String),
    /// The backend does not work, for this reason.
    Missing(String),
}

impl Probed {
    fn new(profile: Result<String, TracerError>) -> Self {
        match profile {
            Ok(profile) => Self::Works(profile),
            Err(e) => Self::Missing(e.to_string()),
        }
    }

    fn profile(&self) -> Option<&str> {
        match self {
            Self::Works(profile) => Some(profile),
            Self::Unused | Self::Missing(_) => None,
        }
    }
}

impl Backends {
    /// Tries the backends of `choice` on this machine.
    pub fn probe(choice: TracerSelection, adapter: AdapterChoice) -> Self {
        use TracerSelection::{Auto, Cpu, Embree, Fast, Gpu};
        // Starting a software driver takes longer than a small bake.
        let skipped_software = choice == Fast && !gpu::device_present();
        let gpu = match choice {
            Auto | Fast | Gpu if !skipped_software => Probed::new(gpu::probe(&adapter)),
            _ => Probed::Unused,
        };
        let embree = match choice {
            Embree => Probed::new(EmbreeBackend::probe()),
            _ => Probed::Unused,
        };
        let software = gpu.profile().is_some_and(|profile| {
            gpu::adapters()
                .iter()
                .any(|a| a.software && a.profile == profile)
        });
        Self {
            cpu: matches!(choice, Auto | Fast | Cpu),
            embree,
            gpu,
            adapter,
            software,
            skipped_software,
        }
    }

    /// Returns the profiles of the working backends, cpu first.
    pub fn profiles(&self) -> Vec<String> {
        let cpu = self.cpu.then_some(cpu::PROFILE);
        let others = [self.embree.profile(), self.gpu.profile()];
        let all = std::iter::once(cpu).chain(others);
        all.flatten().map(str::to_owned).collect()
    }

    /// Returns true if software rasterisers were not probed, because no job would be bound to one.
    pub fn skipped_software(&self) -> bool {
        self.skipped_software
    }

    /// Returns true if `profile` belongs to a software rasteriser.
    pub fn is_software(&self, profile: &str) -> bool {
        self.software && self.gpu.profile() == Some(profile)
    }

    /// Returns one line for users for each requested backend that does not work.
    pub fn missing(&self) -> Vec<String> {
        [("embree", &self.embree), ("gpu", &self.gpu)]
            .into_iter()
            .filter_map(|(name, probed)| match probed {
                Probed::Missing(reason) => Some(format!("{name} backend: {reason}")),
                Probed::Unused | Probed::Works(_) => None,
            })
            .collect()
    }

    /// Opens the backend with the numerics profile `profile` for a scene.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] if this machine does not have the profile; otherwise the error of the
    /// backend.
    pub fn open(
        &self,
        profile: &str,
        scene: Arc<Scene>,
        spec: CubeSpec,
    ) -> Result<Arc<dyn Tracer>, TracerError> {
        if self.cpu && profile == cpu::PROFILE {
            Ok(Arc::new(CpuBackend::new(scene, spec)?))
        } else if self.embree.profile() == Some(profile) {
            Ok(Arc::new(EmbreeBackend::new(scene, spec)?))
        } else if self.gpu.profile() == Some(profile) {
            let backend = GpuBackend::new(scene, spec, self.adapter.clone())?;
            // If the adapter has failed since the probe, another adapter may have been opened instead.
            if backend.profile() != profile {
                return Err(TracerError::Unavailable(format!(
                    "the adapter with the numerics profile {profile} can no longer be opened; restart the \
                     worker"
                )));
            }
            Ok(Arc::new(backend))
        } else {
            Err(TracerError::Unavailable(format!(
                "this worker has no backend with the numerics profile {profile}; it has: {}",
                self.profiles().join(", ")
            )))
        }
    }
}
