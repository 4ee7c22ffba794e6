//! The GPU backend: item buffers drawn by wgpu, reduced on the device, read back as short lists.
//!
//! Cubes are drawn with the raster pipeline. Sight lines are traced by compute shaders, which share only the
//! device with the raster path: whole rounds of them (`rounds`), or packets that the host makes
//! (`tracer.rs`).
//! A machine without a GPU driver uses the CPU backend.
//!
//! **Near plane.** The six frusta of a cube begin at [`crate::near_distance`]. Depth is reversed floating
//! point, near / distance, which has the same relative precision at every distance.
//!
//! **Same bits.** Triangles are drawn in one fixed order, and the first of equal depth wins. The reduction
//! uses integer sums and unions, which do not depend on the order, and its list is sorted before use.

mod adapter;
mod bvh;
mod choice;
mod clusters;
mod device;
mod geometry;
mod line_scene;
mod locks;
mod pipelines;
mod reading;
mod renderer;
mod rounds;
mod spare;
mod tally;
mod tracer;

use std::sync::{Arc, Mutex, OnceLock};

use sightline_scene::Scene;

pub use adapter::{adapters, device_present, probe};
pub use choice::{AdapterChoice, AdapterSummary};
pub use spare::close as close_spare;

use crate::backend::{Backend, CubeRenderer, LineSet};
use crate::cube::CubeSpec;
use crate::error::BackendError;
use crate::packet::LineTracer;
use device::Gpu;
use geometry::{DrawStyle, Geometry};
use line_scene::{DeviceLineScene, Refusal};
use renderer::{GpuRenderer, Work};
use tracer::{GpuTracer, LineKit};

/// Rank of a degenerate triangle, which is never drawn.
const NEVER: u32 = u32::MAX;
/// Most bytes of triangles in one vertex buffer; the device may allow fewer.
const PAGE_BYTES: u64 = 1 << 30;
/// A device bound to one scene and one [`CubeSpec`].
pub struct GpuBackend {
    scene: Arc<Scene>,
    page_bytes: u64,
    /// What cubes are drawn from, made when the first cube is drawn.
    drawn: OnceLock<Result<Drawn, String>>,
    /// The buffers of one batch of cubes.
    work: Mutex<Work>,
    /// The scene of the line tracer, made at the first call of `lines`.
    lines: [OnceLock<Result<Arc<LineKit>, Refusal>>; LineSet::COUNT],
    /// The last to be dropped: the device that it gives back holds nothing then.
    gpu: Gpu,
}

/// A scene as cubes are drawn from it.
struct Drawn {
    style: DrawStyle,
    /// The whole scene, in drawing order.
    whole: Arc<Geometry>,
    /// For each triangle, its place in the drawing order, or [`NEVER`].
    ranks: Vec<u32>,
}

impl GpuBackend {
    /// Opens a device and copies `scene` to it.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] when no adapter fits, or when the adapter or this backend does not
    /// support `spec` or the scene's coordinates; [`BackendError::Failed`] when the device cannot hold the
    /// scene.
    pub fn new(
        scene: Arc<Scene>,
        spec: CubeSpec,
        choice: AdapterChoice,
    ) -> Result<Self, BackendError> {
        Self::with_pages(scene, spec, &choice, PAGE_BYTES)
    }

    /// The same, and the rounds of sight lines measure the time of each kernel, which lengthens them.
    #[must_use]
    pub fn measuring(mut self) -> Self {
        self.gpu.measures = true;
        self
    }

    fn with_pages(
        scene: Arc<Scene>,
        spec: CubeSpec,
        choice: &AdapterChoice,
        page_bytes: u64,
    ) -> Result<Self, BackendError> {
        let gpu = Gpu::open(&scene, spec, choice)?;
        let page_bytes = page_bytes.min(gpu.device.limits().max_buffer_size);
        let (drawn, work, lines) = Default::default();
        Ok(Self {
            scene,
            page_bytes,
            drawn,
            work,
            lines,
            gpu,
        })
    }

    /// The scene as cubes are drawn from it.
    fn drawn(&self) -> Result<&Drawn, BackendError> {
        if let Some(drawn) = self.drawn.get() {
            return drawn.as_ref().map_err(|reason| self.gpu.failed(reason));
        }
        // By all threads of the pool, one of which may be waiting for this value: so before it is made.
        let order = clusters::drawing_order(&self.scene);
        let make = || {
            let mut ranks = vec![NEVER; self.scene.triangles().len()];
            for (rank, id) in (0..).zip(&order) {
                ranks[*id as usize] = rank;
            }
            let style = if self.gpu.software {
                DrawStyle::SOFTWARE
            } else {
                DrawStyle::HARDWARE
            };
            let (device, triangles) = (&self.gpu.device, self.scene.triangles());
            let whole = Geometry::upload(device, triangles, order, self.page_bytes, style)?;
            Ok(Drawn {
                style,
                whole: Arc::new(whole),
                ranks,
            })
        };
        self.drawn
            .get_or_init(make)
            .as_ref()
            .map_err(|reason: &String| self.gpu.failed(reason))
    }
}

impl Backend for GpuBackend {
    fn profile(&self) -> &str {
        &self.gpu.profile
    }

    fn prepare(
        &self,
        superset: Option<&[u32]>,
    ) -> Result<Box<dyn CubeRenderer + '_>, BackendError> {
        self.gpu.check()?;
        let Drawn {
            style,
            whole,
            ranks,
        } = self.drawn()?;
        let geometry = match superset {
            None => Arc::clone(whole),
            Some(ids) => {
                let mut places = Vec::with_capacity(ids.len());
                for id in ids {
                    let place = ranks.get(*id as usize).ok_or_else(|| {
                        self.gpu.failed(format!(
                            "the superset names triangle {id} of a scene of {}",
                            ranks.len()
                        ))
                    })?;
                    places.extend((*place != NEVER).then_some(*place));
                }
                places.sort_unstable();
                places.dedup();
                let ids = places
                    .into_iter()
                    .map(|place| whole.ids[place as usize])
                    .collect();
                let made = Geometry::upload(
                    &self.gpu.device,
                    self.scene.triangles(),
                    ids,
                    self.page_bytes,
                    *style,
                );
                Arc::new(made.map_err(|reason| self.gpu.failed(reason))?)
            }
        };
        let most = tally::most_slots(&self.gpu.device.limits());
        if geometry.slots() > most {
            return Err(self.gpu.failed(format!(
                "{} triangles at once are more than the {most} this device can count; \
                 give it a smaller superset or use --backend cpu",
                geometry.slots()
            )));
        }
        Ok(Box::new(GpuRenderer::new(&self.gpu, &self.work, geometry)?))
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, BackendError> {
        self.gpu.check()?;
        // The hierarchy is built by all threads of the pool.
        crate::prepared::outside_the_pool();
        let made = self.lines[set as usize].get_or_init(|| {
            DeviceLineScene::new(&self.gpu.device, &self.scene, ids, u64::MAX)
                .map(|scene| Arc::new(LineKit::new(scene)))
        });
        match made {
            Ok(kit) => Ok(Box::new(GpuTracer::new(&self.gpu, Arc::clone(kit)))),
            Err(Refusal::Unavailable(why)) => Err(BackendError::Unavailable(why.clone())),
            Err(Refusal::Failed(reason)) => Err(self.gpu.failed(reason.clone())),
        }
    }
}

#[cfg(test)]
mod tests;
