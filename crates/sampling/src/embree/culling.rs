//! The culling of back faces in Embree: a filter that rejects hits on triangles met from behind.
//!
//! Embree calls the filter for each hit nearer than the nearest one so far and goes on behind those that it
//! rejects. So a triangle in the same place that faces the ray is still met.

#![allow(unsafe_code, reason = "a C library calls back; each access says what it relies on")]

use std::ffi::{c_int, c_uint, c_void};

/// For each of Embree's triangles its normal towards its front, of any length; zero when both sides are met.
pub type Fronts = Vec<[f64; 3]>;

/// `RTCFilterFunctionNArguments` of Embree 3 and 4.
#[repr(C)]
pub struct FilterArguments {
    valid: *mut c_int,
    user: *const c_void,
    context: *const c_void,
    ray: *const c_void,
    hit: *const c_void,
    count: c_uint,
}

/// The type of a filter.
pub type Filter = unsafe extern "C" fn(*const FilterArguments);

/// First of the three rows of directions in `RTCRayN`, whose rows have one 32-bit word for each ray.
const DIRECTION: usize = 4;
/// Row of triangle numbers in `RTCHitN`.
const TRIANGLE: usize = 5;

/// Rejects the hits on triangles that are met from behind. The product is rounded in `f64`; its sign can be
/// wrong only for rays that meet the triangle edge-on ([`sightline_scene::Scene::front`]).
///
/// # Safety
/// `arguments` must be those of a call of Embree, for a geometry whose user data points to the [`Fronts`] of
/// all its triangles.
pub unsafe extern "C" fn cull(arguments: *const FilterArguments) {
    // SAFETY: Embree passes a structure that lives during the call, and the user data is as the caller says.
    let (arguments, fronts) = unsafe { (&*arguments, &*(*arguments).user.cast::<Fronts>()) };
    let n = arguments.count as usize;
    for i in 0..n {
        // SAFETY: `valid` has n elements; rays and hits have more rows of n words than are read here.
        unsafe {
            let valid = arguments.valid.add(i);
            if *valid == 0 {
                continue;
            }
            let direction = |axis: usize| *arguments.ray.cast::<f32>().add((DIRECTION + axis) * n + i);
            let triangle = *arguments.hit.cast::<u32>().add(TRIANGLE * n + i);
            let Some(front) = fronts.get(triangle as usize) else { continue };
            if (0..3).map(|axis| front[axis] * f64::from(direction(axis))).sum::<f64>() > 0.0 {
                *valid = 0;
            }
        }
    }
}
