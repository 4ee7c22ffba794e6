//! A fast test that excludes boxes and triangles outside of a beam.
//!
//! The test uses single precision and four planes at a time.
//!
//! A plane is stored as a normal n and a number c, so that n · (p − x) + c is negative for points on its
//! outer side. The number c is 0 for a side of the beam, and the plane's distance for a cap. Coordinates are
//! scaled by a power of two that brings vectors to the scene below 1. Bounds on all roundings are added to
//! the left side. So an excluded box is certainly outside, and an included box may still be outside. If the
//! scaled viewpoint overflows, because the viewpoint is far from the origin compared with its distance from
//! the scene's farthest corner, the bound is infinite. Then no box is excluded.

use glam::{DVec3, Vec3, Vec3A, Vec4};
use sightline_geometry::rounding::UNIT as U;

use super::beam::{Edge, radius};
use super::planes::{Facing, Planes};

/// Number of planes that are tested together.
const LANES: usize = 4;

/// A group of four planes in single precision.
#[derive(Clone, Copy, Debug)]
struct PlaneGroup {
    /// The x components of all normals, then the y components, then the z components.
    normals: [Vec4; 3],
    /// The constant c of each plane, including the error bounds that do not depend on the tested box.
    constant: Vec4,
    /// The error margin of each plane, relative to the largest coordinate of the tested vectors.
    margin: Vec4,
}

/// A plane in doubles: its normal with an error bound, and its constant including the error bounds.
#[derive(Clone, Copy, Debug)]
struct RoundedPlane {
    normal: DVec3,
    error: f64,
    constant: f64,
}

/// The planes that bound the visible space of a beam: the beam's sides, its cap, and the pieces of its patch.
#[derive(Debug, Default)]
pub struct Sieve {
    /// The planes of the list `bounds` in doubles. Empty unless `is_narrow` is true.
    close: Vec<RoundedPlane>,
    /// True if single precision is too coarse for the beam.
    is_narrow: bool,
    /// The planes of the beam and its cap. A box outside of one of these planes is excluded.
    bounds: Vec<PlaneGroup>,
    /// The number of planes in `bounds`.
    bound_count: usize,
    /// The planes of the patch. A box behind all these planes is excluded.
    patch: Vec<PlaneGroup>,
    /// The number of planes in `patch`.
    patch_count: usize,
    /// The viewpoint.
    x: DVec3,
    /// The power of two by which coordinates are multiplied.
    scale: f64,
    /// The scaled viewpoint as the sum of two vectors in single precision.
    parts: [Vec3A; 2],
    single_scale: f32,
    /// The error that the rounding of the second vector of `parts` adds to constants.
    slack: f64,
}

/// Relative rounding error of a plane's value in single precision.
///
/// A normal's components are below 2, and scaled vectors are at most 1 + 2⁻²². Single precision rounds each
/// normal once and each vector twice, each product and each sum by a relative error of 2⁻²⁴: 3 · 2 · 4 + 6 ·
/// 3 < 45 such errors. The bound is 64 such errors.
const ROUNDED: f64 = 1.0 / (1u64 << 18) as f64;
/// Radius of a beam in radians, below which boxes that pass the test in single precision are also tested in
/// doubles.
const NARROW: f64 = 16.0 * ROUNDED;
/// Exponent of the largest power of two by which coordinates are multiplied. Single precision represents this
/// power.
const LARGEST: i32 = 100;
/// Bound on the error of a few products that underflow.
const TINY: f64 = 1e-36;

impl Sieve {
    /// Begins a query from a viewpoint. No coordinate of the scene's box is farther than `reach` from the
    /// viewpoint.
    pub fn begin(&mut self, x: [f64; 3], reach: f64) {
        self.x = x.into();
        let exponent = if reach > 0.0 {
            -(libm::ilogb(reach) + 1)
        } else {
            0
        };
        self.scale = f64::powi(2.0, exponent.min(LARGEST));
        self.single_scale = self.scale as f32;
        let x = self.x * self.scale;
        let first = x.as_vec3();
        let second = (x - first.as_dvec3()).as_vec3();
        self.parts = [first.into(), second.into()];
        // The second part is rounded, and so is the remainder after the first part is subtracted. Each
        // rounding has a relative error of 2⁻²⁴ of the second part, times three components of a normal below
        // 2.
        self.slack = 16.0 * f64::from(second.abs().max_element()) / (1u64 << 24) as f64;
    }

    /// Begins a beam: replaces all planes by the sides of the ring and by the plane of the cap, if any.
    pub fn begin_beam(&mut self, planes: &Planes, ring: &[Edge], cap: Option<&Facing>) {
        (self.bound_count, self.patch_count) = (0, 0);
        self.bounds.clear();
        self.patch.clear();
        self.close.clear();
        self.is_narrow = radius(ring) < NARROW * NARROW;
        for edge in ring {
            let n = planes.normal(edge.side);
            self.bound((n.v, n.error), (0.0, 0.0));
        }
        if let Some(cap) = cap {
            self.cap(cap);
        }
    }

    /// Adds the plane of a cap, so that boxes behind the cap are excluded.
    pub fn cap(&mut self, cap: &Facing) {
        let (n, c) = self.scaled(cap);
        self.bound(n, c);
    }

    fn bound(&mut self, n: ([f64; 3], f64), c: (f64, f64)) {
        add(
            &mut self.bounds,
            &mut self.bound_count,
            1.0,
            n,
            (c.0, c.1 + self.slack),
        );
        if self.is_narrow {
            // The bound has the same form as in single precision, with the roundings of doubles: of normals,
            // coordinates, products and sums.
            let constant = c.0 + c.1 + c.0.abs() * 64.0 * U + f64::MIN_POSITIVE;
            self.close.push(RoundedPlane {
                normal: n.0.into(),
                error: 4.0 * n.1 + 64.0 * U,
                constant,
            });
        }
    }

    /// Adds the plane of a piece's triangle to the patch.
    pub fn patch(&mut self, face: &Facing) {
        let (n, c) = self.scaled(face);
        add(
            &mut self.patch,
            &mut self.patch_count,
            -1.0,
            n,
            (c.0, c.1 + self.slack),
        );
    }

    /// Returns a face's normal, which points to the viewpoint's side, and the face's distance in the same
    /// scale, each with its error bound.
    fn scaled(&self, face: &Facing) -> (([f64; 3], f64), (f64, f64)) {
        let n = face.normal.scaled();
        let by = n.size() / face.normal.size() * self.scale;
        (
            (n.v.map(|c| -c), n.error),
            (face.height.value * by, face.height.error * by),
        )
    }

    /// Returns true if a box is certainly hidden in the beam: all of the box is outside of the beam, behind
    /// the beam's cap, or behind the whole patch.
    #[inline]
    pub fn stops(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let way = CornerDirections::new(self.way(low), self.way(high));
        self.bounds
            .iter()
            .any(|g| way.most(g).cmplt(Vec4::ZERO).any())
            || self.is_narrow && self.stops_closely(low, high)
            || !self.patch.is_empty() && way.is_behind(&self.patch)
    }

    /// Returns true if all of a box is behind the whole patch.
    #[inline]
    pub fn hides(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        !self.patch.is_empty()
            && CornerDirections::new(self.way(low), self.way(high)).is_behind(&self.patch)
    }

    /// Returns true if all of a box is outside of the beam or behind its cap, by a test in doubles.
    fn stops_closely(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let [near, far] = [low, high].map(|p| (Vec3::from(p).as_dvec3() - self.x) * self.scale);
        let reach = near.abs().max(far.abs()).max_element();
        self.close.iter().any(|plane| {
            let most = (plane.normal * near).max(plane.normal * far).element_sum();
            most + plane.constant + reach * plane.error < 0.0
        })
    }

    /// Returns the pieces of the patch behind whose planes a triangle certainly is: bit k for piece k.
    ///
    /// Returns `None` if all of the triangle is outside of the beam, behind the beam's cap, or behind the
    /// whole patch.
    #[inline]
    pub fn behind(&self, points: [[f32; 3]; 3]) -> Option<u64> {
        let [a, b, c] = points.map(|p| self.way(p));
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        let most = |g: &PlaneGroup| {
            let [x, y, z] = g.normals;
            let dot_normals = |p: Vec3A| x * p.x + y * p.y + z * p.z;
            dot_normals(a).max(dot_normals(b)).max(dot_normals(c)) + (g.constant + g.margin * reach)
        };
        if self.bounds.iter().any(|g| most(g).cmplt(Vec4::ZERO).any()) {
            return None;
        }
        let mut behind = 0u64;
        for (k, g) in self.patch.iter().enumerate() {
            behind |= u64::from(most(g).cmplt(Vec4::ZERO).bitmask()) << (k * LANES);
        }
        let all = self.patch.len() * LANES;
        (all == 0 || behind.count_ones() as usize != all).then_some(behind)
    }

    /// Returns the scaled vector from the viewpoint to a point.
    #[inline]
    fn way(&self, p: [f32; 3]) -> Vec3A {
        Vec3A::from(p) * self.single_scale - self.parts[0] - self.parts[1]
    }
}

/// The scaled vectors from the viewpoint to the corners of a box with the smallest and the largest
/// coordinates.
struct CornerDirections {
    near: Vec3A,
    far: Vec3A,
    /// The largest magnitude of a coordinate of both vectors.
    reach: f32,
}

impl CornerDirections {
    #[inline]
    fn new(near: Vec3A, far: Vec3A) -> Self {
        Self {
            near,
            far,
            reach: near.abs().max(far.abs()).max_element(),
        }
    }

    /// Returns the maximum value in the box of each of four planes. Positive values are on the inner sides.
    #[inline]
    fn most(&self, g: &PlaneGroup) -> Vec4 {
        let [x, y, z] = g.normals;
        let x = (x * self.near.x).max(x * self.far.x);
        let y = (y * self.near.y).max(y * self.far.y);
        let z = (z * self.near.z).max(z * self.far.z);
        x + y + z + (g.constant + g.margin * self.reach)
    }

    #[inline]
    fn is_behind(&self, patch: &[PlaneGroup]) -> bool {
        patch.iter().all(|g| self.most(g).cmplt(Vec4::ZERO).all())
    }
}

/// Adds a plane, given as normal and constant with their error bounds, to the last group or to a new group.
/// `count` is the number of planes in all groups.
///
/// If `fill` is positive, everything is on the inner sides of the unused planes of a new group. If `fill` is
/// negative, everything is on their outer sides.
fn add(
    groups: &mut Vec<PlaneGroup>,
    count: &mut usize,
    fill: f32,
    n: ([f64; 3], f64),
    c: (f64, f64),
) {
    let lane = *count % LANES;
    if lane == 0 {
        groups.push(PlaneGroup {
            normals: [Vec4::ZERO; 3],
            constant: Vec4::splat(fill),
            margin: Vec4::ZERO,
        });
    }
    *count += 1;
    let Some(group) = groups.last_mut() else {
        return;
    };
    for (normals, n) in group.normals.iter_mut().zip(n.0) {
        normals[lane] = n as f32;
    }
    group.constant[lane] = (c.0 + c.1 + c.0.abs() * ROUNDED + TINY) as f32;
    group.margin[lane] = (4.0 * n.1 + ROUNDED) as f32;
}
