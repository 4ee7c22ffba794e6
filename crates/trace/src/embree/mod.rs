//! The cpu backend: visibility cubes and sight lines traced with Embree. Cubes use coherent packets of
//! sixteen rays (4 × 4 pixels).
//!
//! Results are the same to the bit on every run: the hierarchy does not depend on the number of threads that
//! build it, the instruction set is fixed, and a packet always holds the same sixteen pixels. Samples are
//! spread over the threads of the current rayon pool.

mod filters;
mod library;
mod occlusion;
#[cfg(test)]
mod tests;

use std::ffi::CStr;
use std::sync::{Arc, Mutex, OnceLock};

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::{Scene, Triangle};

pub use self::occlusion::Occlusion;

use self::filters::Passes;
use self::library::{Device, Layer, RayHit1, RayHit16, TriangleScene};
use crate::backend::{Backend, CubeRenderer, LineSet};
use crate::cube::{CubeImage, CubeSpec, SKY, face_basis};
use crate::error::BackendError;
use crate::packet::{LANES, LineTracer, Packet, PassingTracer};
use crate::reduce::Reducer;
use sightline_model::VisibilitySample;

/// Smallest width of a scene. Products of three lengths of a smaller scene lose digits in single precision,
/// and then rays pass through its triangles.
const MIN_WIDTH: f32 = 1e-9;

/// A scene that is too narrow for Embree.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the scene is only {0:e} wide, and --backend cpu misses triangles of scenes below {MIN_WIDTH:e}; scale \
     the scene up, or use --backend gpu"
)]
pub struct TooNarrow(f32);

/// Checks the width of a scene. A scene whose triangles are all in one point shows nothing, and passes.
///
/// # Errors
/// [`TooNarrow`] below 10⁻⁹.
pub fn check_width(scene: &Scene) -> Result<(), TooNarrow> {
    let width = (scene.bounds().max - scene.bounds().min).max_element();
    if width > 0.0 && width < MIN_WIDTH {
        Err(TooNarrow(width))
    } else {
        Ok(())
    }
}

/// Embree bound to a scene.
pub struct CpuBackend {
    scene: Arc<Scene>,
    spec: CubeSpec,
    device: Arc<Device>,
    profile: String,
    whole: OnceLock<Result<Arc<Hierarchy>, String>>,
    /// Hierarchies over the triangles that sight lines can hit, by [`LineSet`].
    lines: [OnceLock<Result<Arc<Hierarchy>, String>>; LineSet::COUNT],
    /// The hierarchy over those that end a line and those that it passes.
    together: OnceLock<Result<Arc<Hierarchy>, String>>,
}

/// A committed hierarchy and the ids of its triangles.
struct Hierarchy {
    scene: TriangleScene,
    /// Triangle id for each of Embree's triangle numbers; ascending.
    ids: Vec<u32>,
    /// The same for the triangles that rays pass.
    passed: Vec<u32>,
}

impl CpuBackend {
    /// Opens Embree for `scene`.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] when Embree is not installed or cannot run here,
    /// [`BackendError::Failed`] for a scene that is too large or too small for single precision.
    pub fn new(scene: Arc<Scene>, spec: CubeSpec) -> Result<Self, BackendError> {
        // The number of threads that build the hierarchy does not change the bytes
        // (test `however_many_threads_build_it_the_hierarchy_is_the_same`).
        let device = Self::open(rayon::current_num_threads())?;
        let profile = profile(&device);
        if let Err(e) = scene.check_reach("the scene") {
            return Err(BackendError::Failed {
                profile,
                reason: e.to_string(),
            });
        }
        if let Err(e) = check_width(&scene) {
            return Err(BackendError::Failed {
                profile,
                reason: e.to_string(),
            });
        }
        Ok(Self {
            scene,
            spec,
            device: Arc::new(device),
            profile,
            whole: OnceLock::new(),
            lines: Default::default(),
            together: OnceLock::new(),
        })
    }

    /// The numerics profile of this backend on this machine.
    ///
    /// # Errors
    /// As [`CpuBackend::new`].
    pub fn probe() -> Result<String, BackendError> {
        // The number of threads is not part of the profile.
        Ok(profile(&Self::open(1)?))
    }

    /// Opens Embree with `threads` threads for building hierarchies. AVX-512 is excluded because its packets
    /// round differently from those of AVX2.
    fn open(threads: usize) -> Result<Device, BackendError> {
        let config = format!("threads={threads},set_affinity=0,max_isa=avx2\0");
        let config = CStr::from_bytes_until_nul(config.as_bytes())
            .map_err(|e| BackendError::Unavailable(format!("Embree cannot be configured: {e}")))?;
        Device::new(config)
    }

    /// A hierarchy over the triangles that end rays, all when `None`, and over those that rays pass.
    fn build(&self, ending: Option<&[u32]>, passed: &[u32]) -> Result<Arc<Hierarchy>, String> {
        let seen = |id: &u32| !self.scene.triangles()[*id as usize].is_degenerate();
        let ids: Vec<u32> = match ending {
            Some(ids) => ids.iter().copied().filter(seen).collect(),
            None => (0..self.scene.len()).filter(seen).collect(),
        };
        let passed: Vec<u32> = passed.iter().copied().filter(seen).collect();
        let ends = std::iter::once((&ids, false));
        let layers = ends.chain((!passed.is_empty()).then_some((&passed, true)));
        let scene = TriangleScene::new(
            &self.device,
            layers.map(|(ids, is_passed)| self.layer(ids, is_passed)),
        )?;
        Ok(Arc::new(Hierarchy { scene, ids, passed }))
    }

    /// The triangles `ids` for Embree.
    fn layer<'b>(
        &'b self,
        ids: &'b [u32],
        is_passed: bool,
    ) -> Layer<impl Iterator<Item = [f32; 9]> + use<'b>> {
        let all = self.scene.triangles();
        let flat =
            |id: &u32| -> [f32; 9] { bytemuck::cast::<Triangle, [f32; 9]>(all[*id as usize]) };
        let one_sided = !self.scene.sides().are_both();
        Layer {
            count: ids.len(),
            triangles: ids.iter().map(flat),
            fronts: one_sided.then(|| {
                ids.iter()
                    .map(|id| self.scene.front(*id).to_array())
                    .collect()
            }),
            is_passed,
        }
    }

    /// The tracer of a hierarchy.
    fn tracer(&self, hierarchy: Result<Arc<Hierarchy>, String>) -> Result<CpuTracer, BackendError> {
        let failed = |reason| BackendError::Failed {
            profile: self.profile.clone(),
            reason,
        };
        Ok(CpuTracer {
            hierarchy: hierarchy.map_err(failed)?,
            near: crate::near_distance(self.scene.bounds()),
        })
    }
}

fn profile(device: &Device) -> String {
    format!(
        "cpu/embree-{}/{}/{}",
        device.version(),
        instruction_set(),
        vendor()
    )
}

/// The maker of the processor. It is part of the profile because Embree computes reciprocals from a hardware
/// approximation that differs between makers.
fn vendor() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        let id = std::arch::x86_64::__cpuid(0);
        let bytes: Vec<u8> = [id.ebx, id.edx, id.ecx]
            .iter()
            .flat_map(|r| r.to_le_bytes())
            .collect();
        String::from_utf8_lossy(&bytes)
            .chars()
            .filter(char::is_ascii_alphanumeric)
            .collect()
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        "any".to_owned()
    }
}

/// The instruction set that Embree chooses with `max_isa=avx2`.
fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
        {
            "avx2"
        } else if std::arch::is_x86_feature_detected!("avx") {
            "avx"
        } else {
            "sse"
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH
    }
}

impl Backend for CpuBackend {
    fn profile(&self) -> &str {
        &self.profile
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, BackendError> {
        let hierarchy = self.lines[set as usize].get_or_init(|| self.build(Some(ids), &[]));
        Ok(Box::new(self.tracer(hierarchy.clone())?))
    }

    fn passing(
        &self,
        blocking: &[u32],
        see_through: &[u32],
    ) -> Result<Option<Box<dyn PassingTracer + '_>>, BackendError> {
        // A build of Embree without filters traces among the see-through triangles by themselves.
        if !self.device.has_filters() {
            return Ok(None);
        }
        let hierarchy = self
            .together
            .get_or_init(|| self.build(Some(blocking), see_through));
        Ok(Some(Box::new(self.tracer(hierarchy.clone())?)))
    }

    fn prepare(
        &self,
        superset: Option<&[u32]>,
    ) -> Result<Box<dyn CubeRenderer + '_>, BackendError> {
        let hierarchy = match superset {
            Some(_) => self.build(superset, &[]),
            None => self.whole.get_or_init(|| self.build(None, &[])).clone(),
        }
        .map_err(|reason| BackendError::Failed {
            profile: self.profile.clone(),
            reason,
        })?;
        let near = crate::near_distance(self.scene.bounds());
        Ok(Box::new(CpuRenderer {
            hierarchy,
            spec: self.spec,
            near,
            reducers: Mutex::new(Vec::new()),
        }))
    }
}

/// Traces packets through one hierarchy.
struct CpuTracer {
    hierarchy: Arc<Hierarchy>,
    near: f32,
}

impl CpuTracer {
    /// Traces a packet up to a distance for each lane. Needs `passes` when the hierarchy has triangles that
    /// rays pass.
    fn packet(
        &self,
        rays: &mut RayHit16,
        p: &mut Packet,
        until: [f32; 16],
        passes: Option<&mut Passes>,
    ) {
        rays.org = p.origin;
        rays.dir = p.direction;
        rays.tnear = [self.near; 16];
        rays.tfar = until;
        rays.geom = [u32::MAX; 16];
        let valid = std::array::from_fn(|l| if l < p.count { -1 } else { 0 });
        self.hierarchy.scene.intersect(&valid, rays, passes);
        p.distance = rays.tfar;
        for l in 0..16 {
            p.triangle[l] = if rays.geom[l] == u32::MAX {
                SKY
            } else {
                self.hierarchy.ids[rays.prim[l] as usize]
            };
        }
    }

    /// Traces one lane up to a distance.
    fn lane(&self, p: &mut Packet, l: usize, until: f32, passes: Option<&mut Passes>) {
        let at = |v: &[[f32; 16]; 3]| [v[0][l], v[1][l], v[2][l]];
        let mut ray = RayHit1::new(at(&p.origin), at(&p.direction), self.near);
        ray.tfar = until;
        ray.id = l as u32;
        self.hierarchy.scene.intersect_one(&mut ray, passes);
        p.distance[l] = ray.tfar;
        p.triangle[l] = if ray.geom == u32::MAX {
            SKY
        } else {
            self.hierarchy.ids[ray.prim as usize]
        };
    }
}

impl LineTracer for CpuTracer {
    fn trace(&self, packets: &mut [Packet]) -> Result<(), BackendError> {
        let mut rays = RayHit16::new();
        packets
            .iter_mut()
            .for_each(|p| self.packet(&mut rays, p, [f32::INFINITY; 16], None));
        Ok(())
    }

    fn trace_each(&self, packets: &mut [Packet]) -> Result<(), BackendError> {
        for p in packets {
            (0..p.count).for_each(|l| self.lane(p, l, f32::INFINITY, None));
        }
        Ok(())
    }

    fn trace_within(&self, packets: &mut [Packet], coherent: bool) -> Result<(), BackendError> {
        let mut rays = RayHit16::new();
        for p in packets {
            let until = p.distance;
            if coherent {
                self.packet(&mut rays, p, until, None);
            } else {
                (0..p.count).for_each(|l| self.lane(p, l, until[l], None));
            }
        }
        Ok(())
    }
}

impl PassingTracer for CpuTracer {
    fn trace_passing(
        &self,
        packets: &mut [Packet],
        coherent: bool,
        found: &mut Vec<(u32, u32, f32)>,
    ) -> Result<(), BackendError> {
        let mut rays = RayHit16::new();
        rays.id = std::array::from_fn(|l| l as u32);
        let mut passes = Passes::new();
        for (k, p) in packets.iter_mut().enumerate() {
            let until = p.distance;
            passes.clear();
            if coherent {
                self.packet(&mut rays, p, until, Some(&mut passes));
            } else {
                (0..p.count).for_each(|l| self.lane(p, l, until[l], Some(&mut passes)));
            }
            let line = |ray: u32| (k * LANES) as u32 + ray;
            found.extend(
                passes
                    .iter()
                    .filter(|pass| pass.at <= p.distance[pass.ray as usize])
                    .map(|pass| {
                        (
                            line(pass.ray),
                            self.hierarchy.passed[pass.triangle as usize],
                            pass.at,
                        )
                    }),
            );
        }
        Ok(())
    }
}

/// Traces cubes through one hierarchy.
struct CpuRenderer {
    hierarchy: Arc<Hierarchy>,
    spec: CubeSpec,
    near: f32,
    /// Scratch memory of the reduction, one for each thread that samples.
    reducers: Mutex<Vec<Reducer>>,
}

impl CpuRenderer {
    /// Traces one cube. The image holds Embree's triangle numbers; [`Self::to_ids`] maps them to ids.
    fn trace(&self, point: Vec3) -> CubeImage {
        let n = self.spec.resolution;
        let mut ids = vec![SKY; (6 * n * n) as usize];
        let at = |x: u32| (2 * x + 1) as f32 / n as f32 - 1.0;
        let mut rays = RayHit16::new();
        for lane in 0..16 {
            for a in 0..3 {
                rays.org[a][lane] = point[a];
            }
        }
        for face in 0..6 {
            let [forward, right, up] = face_basis(face);
            for y0 in (0..n).step_by(4) {
                for x0 in (0..n).step_by(4) {
                    let mut valid = [0i32; 16];
                    for lane in 0..16u32 {
                        let (x, y) = (x0 + lane % 4, y0 + lane / 4);
                        let l = lane as usize;
                        if x < n && y < n {
                            valid[l] = -1;
                            // The components are ±1, u and v in some order, so the sum is exact.
                            let d = forward + right * at(x) + up * at(y);
                            for a in 0..3 {
                                rays.dir[a][l] = d[a];
                            }
                        }
                        rays.tnear[l] = self.near;
                        rays.tfar[l] = f32::INFINITY;
                        rays.geom[l] = u32::MAX;
                        rays.prim[l] = u32::MAX;
                    }
                    self.hierarchy.scene.intersect(&valid, &mut rays, None);
                    for lane in 0..16u32 {
                        let l = lane as usize;
                        if valid[l] != 0 && rays.geom[l] != u32::MAX {
                            let pixel = (face * n + y0 + lane / 4) * n + x0 + lane % 4;
                            ids[pixel as usize] = rays.prim[l];
                        }
                    }
                }
            }
        }
        CubeImage { resolution: n, ids }
    }

    fn sample(&self, point: Vec3) -> VisibilitySample {
        let image = self.trace(point);
        // The lock is poisoned when another sample panicked; then new scratch memory is allocated.
        let pop = || self.reducers.lock().ok().and_then(|mut r| r.pop());
        let mut reducer = pop().unwrap_or_else(|| Reducer::new(self.hierarchy.ids.len()));
        let mut sample = reducer.reduce(&image, self.spec.strata);
        if let Ok(mut pool) = self.reducers.lock() {
            pool.push(reducer);
        }
        // The hierarchy's `ids` ascend, so the mapping keeps the order, and the least of equals stays least.
        for id in &mut sample.ids {
            *id = self.hierarchy.ids[*id as usize];
        }
        sample.dominant = sample.dominant.map(|d| self.hierarchy.ids[d as usize]);
        if self.spec.keep_pixels {
            sample.pixels = Some(self.to_ids(image).ids.into());
        }
        sample
    }

    fn to_ids(&self, mut image: CubeImage) -> CubeImage {
        for id in image.ids.iter_mut().filter(|id| **id != SKY) {
            *id = self.hierarchy.ids[*id as usize];
        }
        image
    }
}

impl CubeRenderer for CpuRenderer {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, BackendError> {
        Ok(points.par_iter().map(|p| self.sample(*p)).collect())
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, BackendError> {
        Ok(self.to_ids(self.trace(point)))
    }
}
