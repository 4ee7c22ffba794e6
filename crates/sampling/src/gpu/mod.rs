//! The GPU backend: item buffers drawn by wgpu, reduced on the device, read back as short lists.
//!
//! Cubes are drawn with the raster pipeline. Sight lines are traced by a compute shader (`tracer.rs`), which
//! shares only the device with the raster path. A machine without a GPU driver uses the CPU backend.
//!
//! **Near plane.** The six frusta of a cube begin at [`crate::near_distance`]. Depth is reversed floating
//! point, near / distance, which has the same relative precision at every distance.
//!
//! **Same bits.** Triangles are drawn in one fixed order, and the first of equal depth wins. The reduction
//! uses integer sums and unions, which do not depend on the order, and its list is sorted before use.

mod adapter;
mod bvh;
mod clusters;
mod geometry;
mod line_scene;
mod pipelines;
mod renderer;
mod tally;
mod tracer;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use sightline_scene::Scene;

pub use adapter::{AdapterChoice, AdapterSummary, adapters, device_present, probe};

use crate::backend::{Backend, CubeRenderer};
use crate::cube::CubeSpec;
use crate::error::BackendError;
use crate::packet::LineTracer;
use geometry::{DrawStyle, Geometry};
use line_scene::{LineScene, Refusal};
use pipelines::{Kit, MAX_RESOLUTION, scoped};
use renderer::{GpuRenderer, Work};
use tracer::{GpuTracer, LineKit};

/// Rank of a degenerate triangle, which is never drawn.
const NEVER: u32 = u32::MAX;
/// Largest coordinate drawn; differences and their projections stay finite in `f32`.
const MOST_DISTANT: f32 = 1e30;
/// Most bytes of triangles in one vertex buffer; the device may allow fewer.
const PAGE_BYTES: u64 = 1 << 30;
/// How long to wait for one submission before the device counts as failed.
const PATIENCE: Duration = Duration::from_secs(300);

/// A device bound to one scene and one [`CubeSpec`].
pub struct GpuBackend {
    scene: Arc<Scene>,
    spec: CubeSpec,
    profile: String,
    device: wgpu::Device,
    queue: wgpu::Queue,
    kit: Kit,
    near: f32,
    page_bytes: u64,
    style: DrawStyle,
    /// The whole scene, in drawing order.
    whole: Arc<Geometry>,
    /// For each triangle, its place in the drawing order, or [`NEVER`].
    ranks: Vec<u32>,
    /// The first error that the device reported outside an error scope.
    fault: Arc<Mutex<Option<String>>>,
    /// Buffers for rendering cubes; used by one batch at a time.
    work: Mutex<Work>,
    /// The scene of the line tracer, made at the first call of `lines`.
    lines: OnceLock<Result<Arc<LineKit>, Refusal>>,
}

impl GpuBackend {
    /// Opens a device and copies `scene` to it.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] when no adapter fits, or when the adapter or this backend does not
    /// support `spec` or the scene's coordinates; [`BackendError::Failed`] when the device cannot hold the
    /// scene.
    pub fn new(scene: Arc<Scene>, spec: CubeSpec, choice: AdapterChoice) -> Result<Self, BackendError> {
        Self::with_pages(scene, spec, &choice, PAGE_BYTES)
    }

    fn with_pages(
        scene: Arc<Scene>,
        spec: CubeSpec,
        choice: &AdapterChoice,
        page_bytes: u64,
    ) -> Result<Self, BackendError> {
        if !(1..=MAX_RESOLUTION).contains(&spec.resolution) {
            return Err(BackendError::Unavailable(format!(
                "a cube of {} pixels a side cannot be rendered; choose 1 to {MAX_RESOLUTION}",
                spec.resolution
            )));
        }
        let bounds = scene.bounds();
        if bounds.min.abs().max(bounds.max.abs()).max_element() > MOST_DISTANT {
            return Err(BackendError::Unavailable(format!(
                "the scene's coordinates go beyond {MOST_DISTANT:e}; scale it down"
            )));
        }
        let adapter::Opened { device, queue, summary } = adapter::open(choice)?;
        let limits = device.limits();
        if 3 * spec.resolution > limits.max_texture_dimension_2d {
            return Err(BackendError::Unavailable(format!(
                "the adapter {} renders cubes of at most {} pixels a side, not {}; choose fewer or use \
                    --backend cpu",
                summary.name,
                limits.max_texture_dimension_2d / 3,
                spec.resolution
            )));
        }
        let fault = watch(&device);
        let failed = |reason| BackendError::Failed { profile: summary.profile.clone(), reason };
        let kit = scoped(&device, || Ok(Kit::new(&device, spec.resolution))).map_err(failed)?;
        let page_bytes = page_bytes.min(limits.max_buffer_size);
        let order = clusters::drawing_order(&scene);
        let mut ranks = vec![NEVER; scene.triangles().len()];
        for (rank, id) in (0..).zip(&order) {
            ranks[*id as usize] = rank;
        }
        let style = if summary.software { DrawStyle::SOFTWARE } else { DrawStyle::HARDWARE };
        let whole = Geometry::upload(&device, scene.triangles(), order, page_bytes, style).map_err(failed)?;
        let near = crate::near_distance(bounds);
        Ok(Self {
            profile: summary.profile,
            whole: Arc::new(whole),
            work: Mutex::default(),
            lines: OnceLock::new(),
            scene,
            spec,
            device,
            queue,
            kit,
            near,
            page_bytes,
            style,
            ranks,
            fault,
        })
    }

    fn failed(&self, reason: impl Into<String>) -> BackendError {
        BackendError::Failed { profile: self.profile.clone(), reason: reason.into() }
    }

    /// Fails when the device has reported an error since it was opened. Such an error is permanent.
    fn check(&self) -> Result<(), BackendError> {
        match &*lock(&self.fault) {
            Some(reason) => Err(self.failed(reason.clone())),
            None => Ok(()),
        }
    }

    /// Waits until the device has finished `submission` and mapped its buffers. The callback of a mapping may
    /// still run in another thread that waits; receive its message with [`PATIENCE`] as the limit.
    fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), BackendError> {
        let poll = wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(PATIENCE) };
        // wgpu panics when the device is lost during the wait; here that becomes an error like any other.
        let polled = catch_unwind(AssertUnwindSafe(|| self.device.poll(poll)));
        self.check()?;
        match polled {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(self.failed(format!("waiting for the device: {error}"))),
            Err(_) => Err(self.failed("the device was lost while it worked")),
        }
    }
}

impl Backend for GpuBackend {
    fn profile(&self) -> &str {
        &self.profile
    }

    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, BackendError> {
        self.check()?;
        let geometry = match superset {
            None => Arc::clone(&self.whole),
            Some(ids) => {
                let mut places = Vec::with_capacity(ids.len());
                for id in ids {
                    let place = self.ranks.get(*id as usize).ok_or_else(|| {
                        self.failed(format!(
                            "the superset names triangle {id} of a scene of {}",
                            self.ranks.len()
                        ))
                    })?;
                    places.extend((*place != NEVER).then_some(*place));
                }
                places.sort_unstable();
                places.dedup();
                let ids = places.into_iter().map(|place| self.whole.ids[place as usize]).collect();
                let made =
                    Geometry::upload(&self.device, self.scene.triangles(), ids, self.page_bytes, self.style);
                Arc::new(made.map_err(|reason| self.failed(reason))?)
            }
        };
        let most = tally::most_slots(&self.device.limits());
        if geometry.slots() > most {
            return Err(self.failed(format!(
                "{} triangles at once are more than the {most} this device can count; \
                 give it a smaller superset or use --backend cpu",
                geometry.slots()
            )));
        }
        Ok(Box::new(GpuRenderer::new(self, geometry)))
    }

    fn lines(&self, distinct: &[u32]) -> Result<Box<dyn LineTracer + '_>, BackendError> {
        self.check()?;
        let made = self.lines.get_or_init(|| {
            LineScene::new(&self.device, &self.scene, distinct, u64::MAX)
                .map(|scene| Arc::new(LineKit::new(scene)))
        });
        match made {
            Ok(kit) => Ok(Box::new(GpuTracer::new(self, Arc::clone(kit)))),
            Err(Refusal::Unavailable(why)) => Err(BackendError::Unavailable(why.clone())),
            Err(Refusal::Failed(reason)) => Err(self.failed(reason.clone())),
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

/// Locks a mutex, also after a panic in another thread: the guarded data is consistent after every statement.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
