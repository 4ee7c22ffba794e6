//! An open device with the pipelines of cubes. It records faults and waits for submissions.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use sightline_scene::Scene;

use super::adapter;
use super::choice::{AdapterChoice, AdapterSummary};
use super::locks::lock;
use super::pipelines::{Kit, MAX_RESOLUTION, scoped};
use super::spare::{self, Opened};
use crate::cube::CubeSpec;
use crate::error::TracerError;

/// The largest coordinate that is drawn. Differences and their projections stay finite in `f32`.
pub(super) const MOST_DISTANT: f32 = 1e30;
/// The maximum time to wait for a submission before the device counts as failed.
pub(super) const PATIENCE: Duration = Duration::from_secs(300);

/// A device with the pipelines for cubes of one [`CubeSpec`].
pub(super) struct Gpu {
    pub(super) spec: CubeSpec,
    pub(super) profile: String,
    /// The summary of the device's adapter, and the choice that led to it.
    opened_as: (AdapterSummary, AdapterChoice),
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    /// The pipelines of cubes, created when the first cube is drawn. Sight lines do not need them.
    kit: OnceLock<Result<Kit, String>>,
    /// True if the device is a software rasteriser.
    pub(super) software: bool,
    /// True if the times of kernels are measured.
    pub(super) measures: bool,
    /// The distance of the near plane, in world units.
    pub(super) near: f32,
    /// The first error that the device reported outside an error scope.
    fault: Arc<Mutex<Option<String>>>,
    /// True if an operation on the device has failed. Then the device is never used again.
    has_failed: AtomicBool,
}

impl Gpu {
    /// Opens the adapter of `choice` for `scene`.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] if no adapter fits, or if it does not support `spec` or the scene.
    pub(super) fn open(
        scene: &Scene,
        spec: CubeSpec,
        choice: &AdapterChoice,
    ) -> Result<Self, TracerError> {
        if !(1..=MAX_RESOLUTION).contains(&spec.resolution) {
            return Err(TracerError::Unavailable(format!(
                "a cube of {} pixels a side cannot be rendered; choose 1 to {MAX_RESOLUTION}",
                spec.resolution
            )));
        }
        let bounds = scene.bounds();
        if bounds.min.abs().max(bounds.max.abs()).max_element() > MOST_DISTANT {
            return Err(TracerError::Unavailable(format!(
                "the scene's coordinates go beyond {MOST_DISTANT:e}; scale it down"
            )));
        }
        let opened = adapter::open(choice)?;
        let most = opened.device.limits().max_texture_dimension_2d / 3;
        if spec.resolution > most {
            let refused = TracerError::Unavailable(format!(
                "the adapter {} renders cubes of at most {most} pixels a side, not {}; choose fewer or use \
                    --backend cpu",
                opened.summary.name, spec.resolution
            ));
            spare::give_back(opened);
            return Err(refused);
        }
        let Opened {
            device,
            queue,
            summary,
            choice,
        } = opened;
        let fault = watch(&device);
        let kit = OnceLock::new();
        let near = crate::near_distance(bounds);
        let (profile, software) = (summary.profile.clone(), summary.software);
        let opened_as = (summary, choice);
        let (measures, has_failed) = (false, AtomicBool::new(false));
        Ok(Self {
            spec,
            profile,
            opened_as,
            device,
            queue,
            kit,
            software,
            measures,
            near,
            fault,
            has_failed,
        })
    }

    /// Returns the pipelines of cubes, which the first call creates.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device cannot create them.
    pub(super) fn kit(&self) -> Result<&Kit, TracerError> {
        let make = || {
            scoped(&self.device, || {
                Ok(Kit::new(&self.device, self.spec.resolution))
            })
        };
        self.kit
            .get_or_init(make)
            .as_ref()
            .map_err(|reason| self.failed(reason))
    }

    pub(super) fn failed(&self, reason: impl Into<String>) -> TracerError {
        self.has_failed.store(true, Ordering::Relaxed);
        TracerError::Failed {
            profile: self.profile.clone(),
            reason: reason.into(),
        }
    }

    /// Returns an error if the device has reported an error since it was opened. Such an error is permanent.
    pub(super) fn check(&self) -> Result<(), TracerError> {
        match &*lock(&self.fault) {
            Some(reason) => Err(self.failed(reason.clone())),
            None => Ok(()),
        }
    }

    /// Waits until the device has finished `submission` and mapped its buffers.
    ///
    /// The callback of a mapping may still run in another waiting thread, so receive its message with
    /// [`PATIENCE`] as the limit.
    pub(super) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), TracerError> {
        let poll = wgpu::PollType::Wait {
            submission_index: Some(submission),
            timeout: Some(PATIENCE),
        };
        // wgpu panics if the device is lost during the wait. Here the panic becomes an error.
        let polled = catch_unwind(AssertUnwindSafe(|| self.device.poll(poll)));
        self.check()?;
        match polled {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(self.failed(format!("waiting for the device: {error}"))),
            Err(_) => Err(self.failed("the device was lost while it worked")),
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        drop(self.kit.take());
        let (summary, choice) = self.opened_as.clone();
        let opened = Opened {
            device: self.device.clone(),
            queue: self.queue.clone(),
            summary,
            choice,
        };
        match self.check().is_err() || self.has_failed.load(Ordering::Relaxed) {
            false => spare::give_back(opened),
            true => spare::give_up(opened),
        }
    }
}

/// Records the first error or the loss that `device` reports.
fn watch(device: &wgpu::Device) -> Arc<Mutex<Option<String>>> {
    let fault = Arc::new(Mutex::new(None));
    let (errors, losses) = (Arc::clone(&fault), Arc::clone(&fault));
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        lock(&errors).get_or_insert_with(|| error.to_string());
    }));
    device.set_device_lost_callback(move |reason, text| {
        lock(&losses).get_or_insert_with(|| format!("the device was lost ({reason:?}): {text}"));
    });
    fault
}
