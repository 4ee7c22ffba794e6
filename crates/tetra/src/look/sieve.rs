//! Which boxes and triangles a beam does not meet, in single precision and for four planes at a time.
//!
//! A plane is kept as a normal n and a number c, so that n · (p − x) + c is negative for what is on its outer
//! side: c is 0 for a side of the beam, and the plane's distance for a cap. Coordinates are scaled by a power
//! of two that brings ways to the scene below 1. Bounds on all roundings are added to the left side: what is
//! left out is left out for certain, and what is kept may still be outside. A viewpoint so far from the
//! origin beside its distance from the scene that it overflows once it is scaled has an infinite bound, so
//! that nothing is left out.

use glam::{DVec3, Vec3, Vec3A, Vec4};
use sightline_geometry::rounding::UNIT as U;

use super::beam::{Edge, radius};
use super::planes::{Facing, Planes};

/// Planes that are tried together.
const LANES: usize = 4;

/// Four planes.
#[derive(Clone, Copy, Debug)]
struct Group {
    /// The normals' x of all, their y, their z.
    normals: [Vec4; 3],
    /// The constants, with what bounds add to them.
    constant: Vec4,
    /// What bounds add, as a part of the largest coordinate.
    margin: Vec4,
}

/// A plane in doubles: its normal with a bound, its constant with what bounds add.
#[derive(Clone, Copy, Debug)]
struct Close {
    normal: DVec3,
    error: f64,
    constant: f64,
}

/// The planes of a beam and its cap, or its patch.
#[derive(Debug, Default)]
pub struct Sieve {
    /// The first list in doubles.
    close: Vec<Close>,
    /// Whether single precision is too coarse for the beam.
    is_narrow: bool,
    /// What is outside of one of these is left out.
    bounds: Vec<Group>,
    bound_count: usize,
    /// What is outside of all of these is left out.
    patch: Vec<Group>,
    patch_count: usize,
    x: DVec3,
    scale: f64,
    /// The viewpoint scaled, in two parts, and what rounding of the second one adds to a plane's constant.
    parts: [Vec3A; 2],
    single_scale: f32,
    slack: f64,
}

/// A normal's components are below 2, and scaled ways are at most 1 + 2⁻²². Single precision rounds each
/// normal once and each way twice, each product and each sum by a part of 2⁻²⁴: 3 · 2 · 4 + 6 · 3 < 45 such
/// parts. This is 64 of them.
const ROUNDED: f64 = 1.0 / (1u64 << 18) as f64;
/// Beams with a radius below this many radians are tried in doubles too.
const NARROW: f64 = 16.0 * ROUNDED;
/// The largest power of two by which coordinates are scaled: single precision holds it.
const LARGEST: i32 = 100;
/// More than what underflow can take away from a few products.
const TINY: f64 = 1e-36;

impl Sieve {
    /// Begins a query from a viewpoint; no coordinate of the scene's box is farther than `reach` from it.
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
        // The second part is rounded, and so is what is left after the first one was taken away: by a part of
        // 2⁻²⁴ of the second part each, times three components of a normal below 2.
        self.slack = 16.0 * f64::from(second.abs().max_element()) / (1u64 << 24) as f64;
    }

    /// Begins a beam.
    pub fn of(&mut self, planes: &Planes, ring: &[Edge], cap: Option<&Facing>) {
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

    /// Leaves out what is behind a cap from now on.
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
            // As in single precision, with doubles' own roundings: of normals, coordinates, products and
            // sums.
            let constant = c.0 + c.1 + c.0.abs() * 64.0 * U + f64::MIN_POSITIVE;
            self.close.push(Close {
                normal: n.0.into(),
                error: 4.0 * n.1 + 64.0 * U,
                constant,
            });
        }
    }

    /// Adds a face to the patch.
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

    /// A face's normal, outer side to the back, and its distance, with their bounds.
    fn scaled(&self, face: &Facing) -> (([f64; 3], f64), (f64, f64)) {
        let n = face.normal.scaled();
        let by = n.size() / face.normal.size() * self.scale;
        (
            (n.v.map(|c| -c), n.error),
            (face.height.value * by, face.height.error * by),
        )
    }

    /// Whether all of a box is outside of the beam, or behind its cap, or behind all of its patch.
    #[inline]
    pub fn stops(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let way = Ways::new(self.way(low), self.way(high));
        self.bounds
            .iter()
            .any(|g| way.most(g).cmplt(Vec4::ZERO).any())
            || self.is_narrow && self.stops_closely(low, high)
            || !self.patch.is_empty() && way.is_behind(&self.patch)
    }

    /// Whether all of a box is behind all of the patch.
    #[inline]
    pub fn hides(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        !self.patch.is_empty() && Ways::new(self.way(low), self.way(high)).is_behind(&self.patch)
    }

    /// Whether all of a box is outside of the beam or behind its cap, in doubles.
    fn stops_closely(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let [near, far] = [low, high].map(|p| (Vec3::from(p).as_dvec3() - self.x) * self.scale);
        let reach = near.abs().max(far.abs()).max_element();
        self.close.iter().any(|plane| {
            let most = (plane.normal * near).max(plane.normal * far).element_sum();
            most + plane.constant + reach * plane.error < 0.0
        })
    }

    /// Nothing where all of a triangle is outside of the beam or behind its cap, or behind all of its patch;
    /// else the pieces of the patch that it is behind, a bit each.
    #[inline]
    pub fn behind(&self, points: [[f32; 3]; 3]) -> Option<u64> {
        let [a, b, c] = points.map(|p| self.way(p));
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        let most = |g: &Group| {
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

    /// The scaled way from the viewpoint.
    #[inline]
    fn way(&self, p: [f32; 3]) -> Vec3A {
        Vec3A::from(p) * self.single_scale - self.parts[0] - self.parts[1]
    }
}

/// The ways to the least and the greatest corner of a box.
struct Ways {
    near: Vec3A,
    far: Vec3A,
    reach: f32,
}

impl Ways {
    #[inline]
    fn new(near: Vec3A, far: Vec3A) -> Self {
        Self {
            near,
            far,
            reach: near.abs().max(far.abs()).max_element(),
        }
    }

    /// How far the box is on the inner side of four planes at most.
    #[inline]
    fn most(&self, g: &Group) -> Vec4 {
        let [x, y, z] = g.normals;
        let x = (x * self.near.x).max(x * self.far.x);
        let y = (y * self.near.y).max(y * self.far.y);
        let z = (z * self.near.z).max(z * self.far.z);
        x + y + z + (g.constant + g.margin * self.reach)
    }

    #[inline]
    fn is_behind(&self, patch: &[Group]) -> bool {
        patch.iter().all(|g| self.most(g).cmplt(Vec4::ZERO).all())
    }
}

/// Adds a plane to the last group, or to a new one whose other planes have nothing on their outer sides
/// (`fill` positive) or everything.
fn add(groups: &mut Vec<Group>, count: &mut usize, fill: f32, n: ([f64; 3], f64), c: (f64, f64)) {
    let lane = *count % LANES;
    if lane == 0 {
        groups.push(Group {
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
