//! Embree's C interface, loaded at run time.
//!
//! The library is opened with `dlopen`. One program therefore works with Embree 3 and 4, compiles on machines
//! without Embree, and can report the missing files (docs/decisions/0001-embree-at-run-time.md). Only the
//! functions that the sampler calls are bound. Layouts follow `rtcore_ray.h` and `rtcore_common.h` of both
//! versions. Newer versions append fields to some structures; the structures here are larger than in every
//! such version.

#![allow(
    unsafe_code,
    reason = "a C library is called; each call says what it relies on"
)]

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::sync::{Arc, OnceLock};

use libloading::Library;

use super::filters::{Context, Filter, Fronts, Passes, collect, cull};
use crate::error::TracerError;

/// An opaque `RTCDevice`, `RTCScene` or `RTCGeometry`.
pub type Handle = *mut c_void;

/// `RTC_GEOMETRY_TYPE_TRIANGLE`.
const TRIANGLES: c_int = 0;
/// `RTC_BUFFER_TYPE_INDEX` and `RTC_BUFFER_TYPE_VERTEX`.
const INDEX: c_int = 0;
const VERTEX: c_int = 1;
/// `RTC_FORMAT_UINT3` and `RTC_FORMAT_FLOAT3`.
const UINT3: c_int = 0x5003;
const FLOAT3: c_int = 0x9003;
/// `RTC_SCENE_FLAG_ROBUST`: no ray passes between two triangles that share an edge.
const ROBUST: c_int = 1 << 2;
/// `RTC_DEVICE_PROPERTY_VERSION_{MAJOR,MINOR,PATCH}`.
const VERSION: [c_int; 3] = [1, 2, 3];

/// `RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED`.
const FILTERS: c_int = 66;

/// Sixteen rays and their hits, `RTCRayHit16`, with room for the fields that Embree 4.4 appends.
#[repr(C, align(64))]
pub struct RayHit16 {
    /// The origins of the rays.
    pub org: [[f32; 16]; 3],
    /// The start of each ray, in lengths of its direction.
    pub tnear: [f32; 16],
    /// The directions of the rays.
    pub dir: [[f32; 16]; 3],
    time: [f32; 16],
    /// The end of each ray; after a query, the distance of the hit.
    pub tfar: [f32; 16],
    mask: [u32; 16],
    /// The number of each ray, for filters.
    pub id: [u32; 16],
    flags: [u32; 16],
    ng: [[f32; 16]; 3],
    uv: [[f32; 16]; 2],
    /// The number of the hit triangle.
    pub prim: [u32; 16],
    /// The number of the hit geometry; `u32::MAX` without a hit.
    pub geom: [u32; 16],
    inst: [u32; 16],
    newer_fields: [u32; 64],
}

impl RayHit16 {
    /// Creates sixteen rays without a direction and without hits.
    pub fn new() -> Self {
        Self {
            org: [[0.0; 16]; 3],
            tnear: [0.0; 16],
            dir: [[0.0; 16]; 3],
            time: [0.0; 16],
            tfar: [f32::INFINITY; 16],
            mask: [u32::MAX; 16],
            id: [0; 16],
            flags: [0; 16],
            ng: [[0.0; 16]; 3],
            uv: [[0.0; 16]; 2],
            prim: [u32::MAX; 16],
            geom: [u32::MAX; 16],
            inst: [u32::MAX; 16],
            newer_fields: [u32::MAX; 64],
        }
    }
}

/// One ray and its hit, `RTCRayHit`, with room for the fields that Embree 4.4 appends.
#[repr(C, align(64))]
pub struct RayHit1 {
    /// The origin of the ray.
    pub org: [f32; 3],
    /// The start of the ray, in lengths of its direction.
    pub tnear: f32,
    /// The direction of the ray.
    pub dir: [f32; 3],
    time: f32,
    /// The end of the ray; after a query, the distance of the hit.
    pub tfar: f32,
    mask: u32,
    /// The number of the ray, for filters.
    pub id: u32,
    flags: u32,
    ng: [f32; 3],
    uv: [f32; 2],
    /// The number of the hit triangle.
    pub prim: u32,
    /// The number of the hit geometry; `u32::MAX` without a hit.
    pub geom: u32,
    newer_fields: [u32; 16],
}

impl RayHit1 {
    /// Creates a ray without a hit.
    pub fn new(org: [f32; 3], dir: [f32; 3], tnear: f32) -> Self {
        Self {
            org,
            tnear,
            dir,
            time: 0.0,
            tfar: f32::INFINITY,
            mask: u32::MAX,
            id: 0,
            flags: 0,
            ng: [0.0; 3],
            uv: [0.0; 2],
            prim: u32::MAX,
            geom: u32::MAX,
            newer_fields: [u32::MAX; 16],
        }
    }
}

/// `RTCIntersectArguments` of Embree 4, with spare room.
#[repr(C, align(16))]
struct Arguments4 {
    flags: c_uint,
    feature_mask: c_uint,
    context: *mut c_void,
    filter: *const c_void,
    intersect: *const c_void,
    rest: [u32; 16],
}

impl Arguments4 {
    fn new(flags: c_uint, context: &mut Context) -> Self {
        Self {
            flags,
            feature_mask: u32::MAX,
            context: (&raw mut *context).cast(),
            filter: std::ptr::null(),
            intersect: std::ptr::null(),
            rest: [0; 16],
        }
    }
}

/// The flag for coherent rays: bit 0 in Embree 3, bit 16 in Embree 4.
const COHERENT_3: c_uint = 1;
const COHERENT_4: c_uint = 1 << 16;

type Single3 = unsafe extern "C" fn(Handle, *mut Context, *mut RayHit1);
type Single4 = unsafe extern "C" fn(Handle, *mut RayHit1, *mut Arguments4);
type Intersect3 = unsafe extern "C" fn(*const c_int, Handle, *mut Context, *mut RayHit16);
type Intersect4 = unsafe extern "C" fn(*const c_int, Handle, *mut RayHit16, *mut Arguments4);

/// The query functions of Embree 3 or 4: for a packet, and for one ray.
enum Intersect {
    V3(Intersect3, Single3),
    V4(Intersect4, Single4),
}

/// The function that determines whether the rays of a packet meet a triangle.
enum Occluded {
    V3(Intersect3),
    V4(Intersect4),
}

/// The functions of a loaded library, by their C names without the `rtc` prefix.
pub struct Embree {
    new_device: unsafe extern "C" fn(*const c_char) -> Handle,
    release_device: unsafe extern "C" fn(Handle),
    get_device_property: unsafe extern "C" fn(Handle, c_int) -> isize,
    get_device_error: unsafe extern "C" fn(Handle) -> c_int,
    new_scene: unsafe extern "C" fn(Handle) -> Handle,
    release_scene: unsafe extern "C" fn(Handle),
    set_scene_flags: unsafe extern "C" fn(Handle, c_int),
    commit_scene: unsafe extern "C" fn(Handle),
    attach_geometry: unsafe extern "C" fn(Handle, Handle) -> c_uint,
    new_geometry: unsafe extern "C" fn(Handle, c_int) -> Handle,
    release_geometry: unsafe extern "C" fn(Handle),
    set_new_geometry_buffer:
        unsafe extern "C" fn(Handle, c_int, c_uint, c_int, usize, usize) -> *mut c_void,
    commit_geometry: unsafe extern "C" fn(Handle),
    set_geometry_user_data: unsafe extern "C" fn(Handle, *const c_void),
    set_geometry_intersect_filter_function: unsafe extern "C" fn(Handle, Filter),
    intersect: Intersect,
    /// `None` in a library without this function, which no bake needs.
    occluded: Option<Occluded>,
    // The field keeps the library loaded as long as the functions are used.
    _library: Library,
}

/// The file names in the order of the attempts, with Embree's major version.
const NAMES: [(&str, u32); 4] = [
    ("libembree4.so.4", 4),
    ("libembree3.so.3", 3),
    ("libembree4.so", 4),
    ("libembree3.so", 3),
];

impl Embree {
    /// Returns the library of this machine. The first call opens it.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] with the attempted file names and the package to install.
    pub fn get() -> Result<&'static Self, TracerError> {
        static LIBRARY: OnceLock<Result<Embree, String>> = OnceLock::new();
        LIBRARY
            .get_or_init(Self::open)
            .as_ref()
            .map_err(|e| TracerError::Unavailable(e.clone()))
    }

    fn open() -> Result<Self, String> {
        let mut tried = Vec::new();
        for (name, major) in NAMES {
            // SAFETY: Embree's initialisers run; they have no preconditions.
            match unsafe { Library::new(name) } {
                Ok(library) => {
                    return Self::bind(library, major).map_err(|e| {
                        format!("{name} was found but is not the Embree expected: {e}")
                    });
                }
                Err(e) => tried.push(format!("{name} ({e})")),
            }
        }
        Err(format!(
            "Embree is not installed, so the cpu backend cannot run. Install it with `apt-get install \
             libembree3-3` (Debian 12) or `apt-get install libembree4-4` (newer), or use --backend gpu. \
             Tried: {}",
            tried.join("; ")
        ))
    }

    fn bind(library: Library, major: u32) -> Result<Self, libloading::Error> {
        /// Looks up one function.
        ///
        /// # Safety
        /// `T` must be the function's type.
        unsafe fn f<T: Copy>(library: &Library, name: &[u8]) -> Result<T, libloading::Error> {
            // SAFETY: the caller guarantees the type.
            unsafe { library.get::<T>(name) }.map(|s| *s)
        }
        // SAFETY: the types follow Embree's headers, which are the same in both versions except for
        // `rtcIntersect16`, `rtcIntersect1` and `rtcOccluded16`. The version in the file name selects the
        // types of these three.
        unsafe {
            Ok(Self {
                new_device: f(&library, b"rtcNewDevice\0")?,
                release_device: f(&library, b"rtcReleaseDevice\0")?,
                get_device_property: f(&library, b"rtcGetDeviceProperty\0")?,
                get_device_error: f(&library, b"rtcGetDeviceError\0")?,
                new_scene: f(&library, b"rtcNewScene\0")?,
                release_scene: f(&library, b"rtcReleaseScene\0")?,
                set_scene_flags: f(&library, b"rtcSetSceneFlags\0")?,
                commit_scene: f(&library, b"rtcCommitScene\0")?,
                attach_geometry: f(&library, b"rtcAttachGeometry\0")?,
                new_geometry: f(&library, b"rtcNewGeometry\0")?,
                release_geometry: f(&library, b"rtcReleaseGeometry\0")?,
                set_new_geometry_buffer: f(&library, b"rtcSetNewGeometryBuffer\0")?,
                commit_geometry: f(&library, b"rtcCommitGeometry\0")?,
                set_geometry_user_data: f(&library, b"rtcSetGeometryUserData\0")?,
                set_geometry_intersect_filter_function: f(
                    &library,
                    b"rtcSetGeometryIntersectFilterFunction\0",
                )?,
                intersect: if major == 3 {
                    Intersect::V3(
                        f(&library, b"rtcIntersect16\0")?,
                        f(&library, b"rtcIntersect1\0")?,
                    )
                } else {
                    Intersect::V4(
                        f(&library, b"rtcIntersect16\0")?,
                        f(&library, b"rtcIntersect1\0")?,
                    )
                },
                occluded: if major == 3 {
                    f(&library, b"rtcOccluded16\0").ok().map(Occluded::V3)
                } else {
                    f(&library, b"rtcOccluded16\0").ok().map(Occluded::V4)
                },
                _library: library,
            })
        }
    }
}

/// An Embree device.
pub struct Device {
    embree: &'static Embree,
    handle: Handle,
}

// SAFETY: Embree's devices may be used from any thread (its manual, "Device Object").
unsafe impl Send for Device {}
// SAFETY: as above; the calls in this module need no exclusive access.
unsafe impl Sync for Device {}

impl Device {
    /// Opens a device with a configuration string of Embree.
    ///
    /// # Errors
    /// [`TracerError::Unavailable`] if Embree is not installed or does not support this processor.
    pub fn new(config: &CStr) -> Result<Self, TracerError> {
        let embree = Embree::get()?;
        // SAFETY: `config` is a C string that outlives the call.
        let handle = unsafe { (embree.new_device)(config.as_ptr()) };
        if handle.is_null() {
            // SAFETY: a null device is allowed; the call then returns the error of device creation.
            let code = unsafe { (embree.get_device_error)(std::ptr::null_mut()) };
            return Err(TracerError::Unavailable(match code {
                4 => "Embree could not start: not enough memory".to_owned(),
                _ => format!(
                    "Embree could not start (error {code}; 5 means that the processor is not supported); use \
                     --backend gpu"
                ),
            }));
        }
        Ok(Self { embree, handle })
    }

    /// Returns Embree's version as `major.minor.patch`.
    pub fn version(&self) -> String {
        let part = |p: c_int| {
            // SAFETY: the handle is a live device.
            unsafe { (self.embree.get_device_property)(self.handle, p) }
        };
        VERSION.map(|p| part(p).to_string()).join(".")
    }

    /// Returns true if this build of Embree calls filters.
    pub fn has_filters(&self) -> bool {
        // SAFETY: the handle is a live device.
        unsafe { (self.embree.get_device_property)(self.handle, FILTERS) != 0 }
    }

    fn check(&self) -> Result<(), String> {
        // SAFETY: the handle is a live device.
        match unsafe { (self.embree.get_device_error)(self.handle) } {
            0 => Ok(()),
            4 => Err("out of memory".to_owned()),
            code => Err(format!("Embree error {code}")),
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: the handle is live and released once.
        unsafe { (self.embree.release_device)(self.handle) }
    }
}

/// The triangles of one of Embree's geometries.
pub struct Layer<I> {
    /// The number of triangles.
    pub count: usize,
    /// The nine floats of each triangle's three vertices.
    pub triangles: I,
    /// The front of each triangle, for triangles that rays do not meet from behind; `None` if both sides are
    /// met.
    pub fronts: Option<Fronts>,
    /// True if rays continue behind these triangles and list them.
    pub is_passed: bool,
}

/// A committed Embree scene of triangles, numbered in each layer in the order given to [`Self::new`].
pub struct TriangleScene {
    device: Arc<Device>,
    handle: Handle,
    /// The fronts that the filters read through their user data; released after the scene.
    fronts: Vec<Arc<Fronts>>,
}

// SAFETY: a committed scene is read-only and may be queried from many threads (manual, "Scene Object").
unsafe impl Send for TriangleScene {}
// SAFETY: as above.
unsafe impl Sync for TriangleScene {}

impl TriangleScene {
    /// Builds the hierarchy over all layers. Embree numbers the geometries in the order of the layers.
    ///
    /// # Errors
    /// Embree's error, usually that the memory is too small.
    pub fn new<I: Iterator<Item = [f32; 9]>>(
        device: &Arc<Device>,
        layers: impl IntoIterator<Item = Layer<I>>,
    ) -> Result<Self, String> {
        let e = device.embree;
        // SAFETY: the handle is created here and released when the value is dropped.
        let mut scene = unsafe {
            let handle = (e.new_scene)(device.handle);
            (e.set_scene_flags)(handle, ROBUST);
            Self {
                device: Arc::clone(device),
                handle,
                fronts: Vec::new(),
            }
        };
        for layer in layers {
            scene.attach(layer)?;
        }
        // SAFETY: the handle is live.
        unsafe { (e.commit_scene)(scene.handle) };
        device.check()?;
        Ok(scene)
    }

    fn attach(&mut self, layer: Layer<impl Iterator<Item = [f32; 9]>>) -> Result<(), String> {
        let (e, count) = (self.device.embree, layer.count);
        if layer.fronts.is_some() && !self.device.has_filters() {
            return Err(
                "this Embree was built without filter functions, which --cull-back-faces needs; \
                        install another build of it, or use --backend gpu"
                    .to_owned(),
            );
        }
        // SAFETY: the geometry is created here and lives; both buffers are filled to their whole size before
        // it is committed, and the scene holds a reference to it after it is attached. The fronts live as
        // long as the scene, and the filters only read them.
        unsafe {
            let geometry = (e.new_geometry)(self.device.handle, TRIANGLES);
            let vertices = (e.set_new_geometry_buffer)(geometry, VERTEX, 0, FLOAT3, 12, count * 3);
            let indices = (e.set_new_geometry_buffer)(geometry, INDEX, 0, UINT3, 12, count);
            if count > 0 && (vertices.is_null() || indices.is_null()) {
                let reason = self
                    .device
                    .check()
                    .err()
                    .unwrap_or_else(|| "no buffer".to_owned());
                (e.release_geometry)(geometry);
                return Err(reason);
            }
            let mut written = 0;
            for (i, t) in layer.triangles.take(count).enumerate() {
                vertices.cast::<[f32; 9]>().add(i).write(t);
                let first = 3 * i as u32;
                indices
                    .cast::<[u32; 3]>()
                    .add(i)
                    .write([first, first + 1, first + 2]);
                written += 1;
            }
            assert_eq!(written, count, "as many triangles as announced");
            if let Some(fronts) = layer.fronts.map(Arc::new) {
                (e.set_geometry_user_data)(geometry, Arc::as_ptr(&fronts).cast());
                self.fronts.push(fronts);
                (e.set_geometry_intersect_filter_function)(geometry, cull);
            }
            if layer.is_passed {
                (e.set_geometry_intersect_filter_function)(geometry, collect);
            }
            (e.commit_geometry)(geometry);
            (e.attach_geometry)(self.handle, geometry);
            (e.release_geometry)(geometry);
            Ok(())
        }
    }

    /// Finds the nearest hit of each ray whose `valid` entry is −1. Rays with similar directions are fastest.
    /// Requires `passes` if rays pass a layer.
    pub fn intersect(&self, valid: &[i32; 16], rays: &mut RayHit16, passes: Option<&mut Passes>) {
        /// `valid` with the alignment that Embree requires, 64 bytes.
        #[repr(align(64))]
        struct Valid([i32; 16]);
        let valid = Valid(*valid);
        let passes = passes.map_or(std::ptr::null_mut(), |p| &raw mut *p);
        match self.device.embree.intersect {
            Intersect::V3(f, _) => {
                let mut context = Context::of_3(COHERENT_3, passes);
                // SAFETY: all three structures have at least the size and alignment that Embree 3 needs.
                unsafe { f(valid.0.as_ptr(), self.handle, &raw mut context, rays) }
            }
            Intersect::V4(f, _) => {
                let mut context = Context::of_4(passes);
                let mut arguments = Arguments4::new(COHERENT_4, &mut context);
                // SAFETY: as above for Embree 4.
                unsafe { f(valid.0.as_ptr(), self.handle, rays, &raw mut arguments) }
            }
        }
    }

    /// Returns true if the library supports [`Self::occluded`].
    pub fn has_occluded(&self) -> bool {
        self.device.embree.occluded.is_some()
    }

    /// Sets `tfar` to −∞ for each ray that meets a triangle and whose `valid` entry is −1.
    ///
    /// The scene must not have a layer that rays pass. The function has no effect if the library does not
    /// support it.
    pub fn occluded(&self, valid: &[i32; 16], rays: &mut RayHit16) {
        /// `valid` with the alignment that Embree requires, 64 bytes.
        #[repr(align(64))]
        struct Valid([i32; 16]);
        let valid = Valid(*valid);
        match self.device.embree.occluded {
            None => {}
            Some(Occluded::V3(f)) => {
                let mut context = Context::of_3(0, std::ptr::null_mut());
                // SAFETY: as for `intersect`; `RTCRay16` is the first part of `RTCRayHit16`.
                unsafe { f(valid.0.as_ptr(), self.handle, &raw mut context, rays) }
            }
            Some(Occluded::V4(f)) => {
                let mut context = Context::of_4(std::ptr::null_mut());
                let mut arguments = Arguments4::new(0, &mut context);
                // SAFETY: as above for Embree 4, whose `RTCOccludedArguments` has the fields of
                // `RTCIntersectArguments`.
                unsafe { f(valid.0.as_ptr(), self.handle, rays, &raw mut arguments) }
            }
        }
    }

    /// Finds the nearest hit of one ray. Requires `passes` if rays pass a layer.
    pub fn intersect_one(&self, ray: &mut RayHit1, passes: Option<&mut Passes>) {
        let passes = passes.map_or(std::ptr::null_mut(), |p| &raw mut *p);
        match self.device.embree.intersect {
            Intersect::V3(_, f) => {
                let mut context = Context::of_3(0, passes);
                // SAFETY: both structures have at least the size and alignment that Embree 3 needs.
                unsafe { f(self.handle, &raw mut context, ray) }
            }
            Intersect::V4(_, f) => {
                let mut context = Context::of_4(passes);
                let mut arguments = Arguments4::new(0, &mut context);
                // SAFETY: as above for Embree 4.
                unsafe { f(self.handle, ray, &raw mut arguments) }
            }
        }
    }
}

impl Drop for TriangleScene {
    fn drop(&mut self) {
        // SAFETY: the handle is live and released once.
        unsafe { (self.device.embree.release_scene)(self.handle) }
    }
}
