//! The embree backend, which traces visibility cubes and sight lines with the library Embree. Cubes use
//! coherent packets of sixteen rays (4 × 4 pixels).
//!
//! Results are equal to the bit on every run. The hierarchy does not depend on the number of threads that
//! build it, the instruction set is fixed, and a packet always contains the same sixteen pixels. Samples are
//! distributed over the threads of the current rayon pool.

mod filters;
mod library;
mod occlusion;
#[cfg(test)]
mod tests;

use std::ffi::CStr;
use std::sync::{Arc, Mutex, OnceLock};

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::{Scene, Triangle, TriangleId};

pub use self::occlusion::Occlusion;

use self::filters::Passes;
use self::library::{Device, Layer, RayHit1, RayHit16, TriangleScene};
use crate::cube::{CubeImage, CubeSpec, SKY, face_basis};
use crate::error::TracerError;
use crate::packet::{Halves, LANES, LineTracer, Packet, PassingTracer};
use crate::reduce::Reducer;
use crate::tracer::{CubeRenderer, LineSet, Tracer};
use crate::width::{self, TooNarrow};
use sightline_model::VisibilitySample;

/// The minimum width of a scene. Products of three lengths of a smaller scene lose digits in single
/// precision, so rays would pass through its triangles.
const MIN_WIDTH: f32 = 1e-9;

/// Checks the width of a scene.
///
/// # Errors
/// [`TooNarrow`] if the width is below 10⁻⁹.
pub fn check_width(scene: &Scene) -> Result<(), TooNarrow> {
    width::check(scene, "embree", MIN_WIDTH)
}

/// An Embree device for a scene.
pub struct EmbreeBackend {
    scene: Arc<Scene>,
    spec: CubeSpec,
    device: Arc<Device>,
    profile: String,
    whole: OnceLock<Result<Arc<Hierarchy>, String>>,
    /// The hierarchies over the triangles that sight lines can hit, by [`LineSet`].
    lines: [OnceLock<Result<Arc<Hierarchy>, String>>; LineSet::COUNT],
    /// The hierarchy over the triangles that end lines and the triangles that lines pass.
    together: OnceLock<Result<Arc<Hierarchy>, String>>,
}

/// A committed hierarchy and the ids of its triangles.
struct Hierarchy {
    scene: TriangleScene,
    /// The triangle id for each of Embree's triangle numbers, in ascending order.
    ids: Vec<u32>,
    /// The ids of the triangles that rays pass, for each of Embree's numbers, in ascending order.
    passed: Vec<u32>,
}

impl EmbreeBackend {
    /// Opens Embree for `scene`.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] if Embree is not installed or cannot run here, [`TracerError::Failed`] if
    /// the scene is too large or too small for single precision.
    pub fn new(scene: Arc<Scene>, spec: CubeSpec) -> Result<Self, TracerError> {
        // The number of threads that build the hierarchy does not change the bytes (test
        // `hierarchy_does_not_depend_on_build_threads`).
        let device = Self::open(rayon::current_num_threads())?;
        let profile = profile(&device);
        if let Err(e) = scene.check_reach("the scene") {
            return Err(TracerError::Failed {
                profile,
                reason: e.to_string(),
            });
        }
        if let Err(e) = check_width(&scene) {
            return Err(TracerError::Failed {
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

    /// Returns the numerics profile of this backend on this machine.
    ///
    /// # Errors
    /// The errors of [`EmbreeBackend::new`].
    pub fn probe() -> Result<String, TracerError> {
        // The number of threads is not part of the profile.
        Ok(profile(&Self::open(1)?))
    }

    /// Opens Embree with `threads` threads for building hierarchies. AVX-512 is excluded because its packets
    /// round differently from AVX2 packets.
    fn open(threads: usize) -> Result<Device, TracerError> {
        let config = format!("threads={threads},set_affinity=0,max_isa=avx2\0");
        let config = CStr::from_bytes_until_nul(config.as_bytes())
            .map_err(|e| TracerError::Unavailable(format!("Embree cannot be configured: {e}")))?;
        Device::new(config)
    }

    /// Builds a hierarchy over the triangles that end rays (all if `None`) and the triangles that rays pass.
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

    /// Returns the triangles `ids` as a layer for Embree.
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
                    .map(|id| self.scene.front(TriangleId(*id)).to_array())
                    .collect()
            }),
            is_passed,
        }
    }

    /// Creates the tracer of a hierarchy.
    fn tracer(
        &self,
        hierarchy: Result<Arc<Hierarchy>, String>,
    ) -> Result<EmbreeTracer, TracerError> {
        let failed = |reason| TracerError::Failed {
            profile: self.profile.clone(),
            reason,
        };
        Ok(EmbreeTracer {
            hierarchy: hierarchy.map_err(failed)?,
            near: crate::near_distance(self.scene.bounds()),
        })
    }
}

fn profile(device: &Device) -> String {
    format!(
        "embree/{}/{}/{}",
        device.version(),
        instruction_set(),
        vendor()
    )
}

/// Returns the maker of the processor. The maker is part of the profile because Embree computes reciprocals
/// from a hardware approximation that differs between makers.
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

/// Returns the instruction set that Embree selects with `max_isa=avx2`.
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

impl Tracer for EmbreeBackend {
    fn profile(&self) -> &str {
        &self.profile
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, TracerError> {
        let hierarchy = self.lines[set as usize].get_or_init(|| self.build(Some(ids), &[]));
        Ok(Box::new(self.tracer(hierarchy.clone())?))
    }

    fn passing(
        &self,
        blocking: &[u32],
        see_through: &[u32],
    ) -> Result<Option<Box<dyn PassingTracer + '_>>, TracerError> {
        // A build of Embree without filters traces among the see-through triangles separately.
        if !self.device.has_filters() {
            return Ok(None);
        }
        let hierarchy = self
            .together
            .get_or_init(|| self.build(Some(blocking), see_through));
        Ok(Some(Box::new(self.tracer(hierarchy.clone())?)))
    }

    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, TracerError> {
        let hierarchy = match superset {
            Some(_) => self.build(superset, &[]),
            None => self.whole.get_or_init(|| self.build(None, &[])).clone(),
        }
        .map_err(|reason| TracerError::Failed {
            profile: self.profile.clone(),
            reason,
        })?;
        let near = crate::near_distance(self.scene.bounds());
        Ok(Box::new(EmbreeRenderer {
            hierarchy,
            spec: self.spec,
            near,
            reducers: Mutex::new(Vec::new()),
        }))
    }
}

/// A tracer of packets through one hierarchy.
struct EmbreeTracer {
    hierarchy: Arc<Hierarchy>,
    near: f32,
}

impl EmbreeTracer {
    /// Traces a packet up to a distance for each lane. Requires `passes` if the hierarchy has triangles that
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

impl LineTracer for EmbreeTracer {
    fn trace(&self, packets: &mut [Packet], _: Halves, coherent: bool) -> Result<(), TracerError> {
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

impl PassingTracer for EmbreeTracer {
    fn trace_passing(
        &self,
        packets: &mut [Packet],
        _: Halves,
        coherent: bool,
        found: &mut Vec<(u32, u32, f32)>,
    ) -> Result<(), TracerError> {
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

/// A renderer that traces cubes through one hierarchy.
struct EmbreeRenderer {
    hierarchy: Arc<Hierarchy>,
    spec: CubeSpec,
    near: f32,
    /// The scratch memory of the reduction, one for each thread that samples.
    reducers: Mutex<Vec<Reducer>>,
}

impl EmbreeRenderer {
    /// Traces one cube. The image contains Embree's triangle numbers; [`Self::to_ids`] maps them to ids.
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
        // The lock is poisoned if another sample panicked; then new scratch memory is allocated.
        let pop = || self.reducers.lock().ok().and_then(|mut r| r.pop());
        let mut reducer = pop().unwrap_or_else(|| Reducer::new(self.hierarchy.ids.len()));
        let mut sample = reducer.reduce(&image, self.spec.strata);
        if let Ok(mut pool) = self.reducers.lock() {
            pool.push(reducer);
        }
        // The hierarchy's `ids` ascend, so the mapping preserves the order, and the lowest of equal ids
        // remains the lowest.
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

impl CubeRenderer for EmbreeRenderer {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError> {
        Ok(points.par_iter().map(|p| self.sample(*p)).collect())
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError> {
        Ok(self.to_ids(self.trace(point)))
    }
}
