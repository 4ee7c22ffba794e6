//! Filters of Embree's hits. One filter rejects hits on triangles met from behind. The other filter lists
//! hits on see-through triangles and rejects them all.
//!
//! Embree calls a filter for each hit that is nearer than the nearest hit so far, and continues behind
//! rejected hits. A coincident triangle that faces the ray is therefore still met, and one traversal finds
//! the end of a ray and the see-through triangles before it.

#![allow(
    unsafe_code,
    reason = "a C library calls back; each access says what it relies on"
)]

use std::ffi::{c_int, c_uint, c_void};

/// The normal of each of Embree's triangles towards its front, of any length; zero if both sides are met.
pub type Fronts = Vec<[f64; 3]>;

/// `RTCFilterFunctionNArguments` of Embree 3 and 4.
#[repr(C)]
pub struct FilterArguments {
    valid: *mut c_int,
    user: *const c_void,
    context: *mut Context,
    ray: *const c_void,
    hit: *const c_void,
    count: c_uint,
}

/// The type of a filter.
pub type Filter = unsafe extern "C" fn(*const FilterArguments);

/// A hit on a triangle that rays pass.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// The number of the ray.
    pub ray: u32,
    /// Embree's number of the triangle in its layer.
    pub triangle: u32,
    /// The distance along the ray.
    pub at: f32,
}

/// The hits that [`collect`] lists, in arbitrary order. Some hits lie behind the end of their ray, which was
/// not known when they were met.
pub type Passes = Vec<Pass>;

/// The context of a query, with spare room, and the list to which the query's filters write.
///
/// It is an `RTCIntersectContext` of Embree 3 or an `RTCRayQueryContext` of Embree 4.
#[repr(C, align(16))]
pub struct Context {
    flags: c_uint,
    filter: *const c_void,
    rest: [u32; 16],
    /// Null if no filter collects hits.
    passes: *mut Passes,
}

impl Context {
    /// Creates the context of a query of Embree 3.
    pub fn of_3(flags: c_uint, passes: *mut Passes) -> Self {
        Self {
            flags,
            filter: std::ptr::null(),
            rest: [u32::MAX; 16],
            passes,
        }
    }

    /// Creates the context of a query of Embree 4, which has instance numbers in the place of flags and
    /// filter.
    pub fn of_4(passes: *mut Passes) -> Self {
        let filter = std::ptr::without_provenance(usize::MAX);
        Self {
            flags: u32::MAX,
            filter,
            rest: [u32::MAX; 16],
            passes,
        }
    }
}

/// The first of the three rows of directions in `RTCRayN`, whose rows have one 32-bit word for each ray.
const DIRECTION: usize = 4;
/// The row of the distances, and the row of the rays' numbers.
const DISTANCE: usize = 8;
const NUMBER: usize = 10;
/// The row of triangle numbers in `RTCHitN`.
const TRIANGLE: usize = 5;

/// Rejects the hits on triangles that are met from behind. The product is rounded in `f64`, so its sign can
/// be wrong only for rays that meet the triangle edge-on ([`sightline_scene::Scene::front`]).
///
/// # Safety
/// `arguments` must be the arguments of a call by Embree, for a geometry whose user data points to the
/// [`Fronts`] of all its triangles.
pub unsafe extern "C" fn cull(arguments: *const FilterArguments) {
    // SAFETY: Embree passes a structure that lives during the call, and the caller guarantees the user data.
    let (arguments, fronts) = unsafe { (&*arguments, &*(*arguments).user.cast::<Fronts>()) };
    let n = arguments.count as usize;
    for i in 0..n {
        // SAFETY: `valid` has n elements, and `i` is less than n.
        unsafe {
            if *arguments.valid.add(i) != 0 && arguments.is_from_behind(fronts, i) {
                *arguments.valid.add(i) = 0;
            }
        }
    }
}

/// Lists the hits and rejects them, so that rays continue behind them. If the geometry has fronts, hits from
/// behind are omitted.
///
/// # Safety
/// `arguments` must be the arguments of a call by Embree whose context is a [`Context`] with a live list. The
/// user data of the geometry must be null or point to the [`Fronts`] of all its triangles.
pub unsafe extern "C" fn collect(arguments: *const FilterArguments) {
    // SAFETY: the caller guarantees the arguments; the list belongs to the thread that called Embree, which
    // waits.
    let (arguments, passes) = unsafe { (&*arguments, &mut *(*(*arguments).context).passes) };
    let n = arguments.count as usize;
    for i in 0..n {
        // SAFETY: `valid` has n elements; rays and hits have more rows of n words than are read here. The
        // caller guarantees the user data.
        unsafe {
            let valid = arguments.valid.add(i);
            if *valid == 0 {
                continue;
            }
            *valid = 0;
            let fronts = arguments.user.cast::<Fronts>().as_ref();
            if fronts.is_some_and(|f| arguments.is_from_behind(f, i)) {
                continue;
            }
            passes.push(Pass {
                ray: *arguments.ray.cast::<u32>().add(NUMBER * n + i),
                triangle: arguments.triangle(i),
                at: *arguments.ray.cast::<f32>().add(DISTANCE * n + i),
            });
        }
    }
}

impl FilterArguments {
    /// Returns Embree's number of the triangle that ray `i` hits.
    ///
    /// # Safety
    /// `i` must be less than `count`.
    unsafe fn triangle(&self, i: usize) -> u32 {
        // SAFETY: hits have more rows of `count` words than are read here.
        unsafe {
            *self
                .hit
                .cast::<u32>()
                .add(TRIANGLE * self.count as usize + i)
        }
    }

    /// Returns true if ray `i` meets its triangle from behind.
    ///
    /// # Safety
    /// `i` must be less than `count`.
    unsafe fn is_from_behind(&self, fronts: &Fronts, i: usize) -> bool {
        let n = self.count as usize;
        // SAFETY: rays have more rows of n words than are read here.
        unsafe {
            let direction = |axis: usize| *self.ray.cast::<f32>().add((DIRECTION + axis) * n + i);
            let Some(front) = fronts.get(self.triangle(i) as usize) else {
                return false;
            };
            (0..3)
                .map(|axis| front[axis] * f64::from(direction(axis)))
                .sum::<f64>()
                > 0.0
        }
    }
}
