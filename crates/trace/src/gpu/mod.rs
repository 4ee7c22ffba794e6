//! The GPU backend: wgpu draws item buffers, and the device reduces them to short lists that the host reads.
//!
//! Cubes are drawn with the raster pipeline. Sight lines are traced by compute shaders, which share only the
//! device with the raster path: whole rounds of lines (`rounds`), or packets that the host creates
//! (`tracer.rs`). A machine without a GPU driver uses the CPU backend.
//!
//! **Near plane.** The six frusta of a cube begin at [`crate::near_distance`]. Depth is reversed floating
//! point, near / distance, which has the same relative precision at every distance.
//!
//! **Same bits.** Triangles are drawn in one fixed order, and the first triangle of equal depth wins. The
//! reduction uses integer sums and unions, which do not depend on the order, and its list is sorted before
//! use.

mod adapter;
mod choice;
mod clusters;
mod device;
mod geometry;
mod line_scene;
mod locks;
mod nodes;
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

use crate::cube::CubeSpec;
use crate::error::TracerError;
use crate::packet::LineTracer;
use crate::tracer::{CubeRenderer, LineSet, Tracer};
use device::Gpu;
use geometry::{DrawStyle, Geometry};
use line_scene::{DeviceLineScene, Refusal};
use renderer::{CubeBuffers, GpuRenderer};
use tracer::{GpuTracer, LineKit};

/// The rank of a degenerate triangle, which is never drawn.
const NEVER: u32 = u32::MAX;
/// Maximum size of the triangles in a vertex buffer, in bytes. The device may allow fewer.
const PAGE_BYTES: u64 = 1 << 30;
/// A device for one scene and one [`CubeSpec`].
pub struct GpuBackend {
    scene: Arc<Scene>,
    page_bytes: u64,
    /// The geometry of cubes, created when the first cube is drawn.
    drawn: OnceLock<Result<CubeGeometry, String>>,
    /// The buffers of one batch of cubes.
    buffers: Mutex<CubeBuffers>,
    /// The scenes of the line tracer, created at the first call of `lines`.
    lines: [OnceLock<Result<Arc<LineKit>, Refusal>>; LineSet::COUNT],
    /// The device. It is dropped last, so that a returned device contains no resources.
    gpu: Gpu,
}

/// The geometry of a scene from which cubes are drawn.
struct CubeGeometry {
    style: DrawStyle,
    /// The whole scene, in drawing order.
    whole: Arc<Geometry>,
    /// The place of each triangle in the drawing order, or [`NEVER`].
    ranks: Vec<u32>,
}

impl GpuBackend {
    /// Opens a device and copies `scene` to it.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] if no adapter fits, or if the adapter or this backend does not support
    /// `spec` or the scene's coordinates; [`TracerError::Failed`] if the device has not enough memory for the
    /// scene.
    pub fn new(
        scene: Arc<Scene>,
        spec: CubeSpec,
        choice: AdapterChoice,
    ) -> Result<Self, TracerError> {
        Self::with_pages(scene, spec, &choice, PAGE_BYTES)
    }

    /// Returns the backend with time measurement of each kernel of sight-line rounds, which lengthens the
    /// rounds.
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
    ) -> Result<Self, TracerError> {
        let gpu = Gpu::open(&scene, spec, choice)?;
        let page_bytes = page_bytes.min(gpu.device.limits().max_buffer_size);
        let (drawn, buffers, lines) = Default::default();
        Ok(Self {
            scene,
            page_bytes,
            drawn,
            buffers,
            lines,
            gpu,
        })
    }

    /// Returns the geometry from which cubes are drawn. The first call creates it.
    fn drawn(&self) -> Result<&CubeGeometry, TracerError> {
        if let Some(drawn) = self.drawn.get() {
            return drawn.as_ref().map_err(|reason| self.gpu.failed(reason));
        }
        // All threads of the pool compute the order, and one of them may be waiting for this value. The order
        // is therefore computed before the value.
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
            Ok(CubeGeometry {
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

impl Tracer for GpuBackend {
    fn profile(&self) -> &str {
        &self.gpu.profile
    }

    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, TracerError> {
        self.gpu.check()?;
        let CubeGeometry {
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
        Ok(Box::new(GpuRenderer::new(
            &self.gpu,
            &self.buffers,
            geometry,
        )?))
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, TracerError> {
        self.gpu.check()?;
        // All threads of the pool build the hierarchy.
        crate::prepared::outside_the_pool();
        let made = self.lines[set as usize].get_or_init(|| {
            DeviceLineScene::new(&self.gpu.device, &self.scene, ids, u64::MAX)
                .map(|scene| Arc::new(LineKit::new(scene)))
        });
        match made {
            Ok(kit) => Ok(Box::new(GpuTracer::new(&self.gpu, Arc::clone(kit)))),
            Err(Refusal::Unavailable(why)) => Err(TracerError::Unavailable(why.clone())),
            Err(Refusal::Failed(reason)) => Err(self.gpu.failed(reason.clone())),
        }
    }
}

#[cfg(test)]
mod tests;
