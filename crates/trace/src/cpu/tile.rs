//! The traversal of sixteen rays with one origin and similar directions, as of a tile of pixels.
//!
//! Distances are measured along the axis of the largest component of the directions, which must be the same
//! for all rays, with the same sign. A ray is then a pair of slopes, and the tile a rectangle of slopes. The
//! eight children of a node, or the eight triangles of a leaf, are first tested against the rectangle. Each
//! one that passes is then tested against the sixteen rays. The test of a triangle is the test of `batch.rs`,
//! so the hits are the same.
//!
//! **Slack.** The edge functions of a leaf are compared with a slack of 64 · 2⁻²⁴ · D², where D is the bound
//! of coordinate differences (module `cpu`). Each sheared coordinate is at most 2 · D and wrong by
//! 3 · 2⁻²⁴ · D, so shear changes an edge function by at most 24 · 2⁻²⁴ · D². The bounds over the rectangle
//! are wrong by at most 26 · 2⁻²⁴ · D² (products 4 and 2 · 6, sums 4 and 6).

use bytemuck::Zeroable;
use fearless_simd::{
    Select as _, Simd, SimdBase, SimdFloat as _, SimdMask as _, SimdWiden as _, f32x8, f32x16,
    f64x4, u32x16,
};

use super::batch::{main_axis, sheared_axes};
use super::hierarchy::{
    BEYOND, LEAF, Leaf, MAX_LEVELS, NO_TRIANGLE, NUMBER, Node, ONE_SIDED, PASSED, WIDTH,
    WideHierarchy,
};
use super::line_origin::{LISTED, OriginNodes, scaled_origin, widening};
use super::lines::{Hits, Lines};
use super::packet_rays::{Lanes, PacketRays};
use crate::packet::{LANES, Packet};

/// The height of the stack: the children of the listed nodes, and of a path below one of them.
const STACK: usize = WIDTH * (LISTED + MAX_LEVELS);
/// The smallest slope in box tests; smaller ones are replaced by it.
const LEAST_SLOPE: f32 = 1.0 / (1u64 << 60) as f32;
/// A factor greater than the rounding errors of three products.
const UP: f32 = 1.000_001;
/// The largest distance along the axis, which orders children and ends unbounded rays.
const FAR: f32 = 2e38;

/// The planes of one axis that bound the rectangle of slopes. Row, factor and sum of a plane give the
/// distance at which the rectangle reaches it.
#[derive(Clone, Copy, Zeroable)]
struct SlopeBounds {
    /// The planes at which the rectangle enters a box; the larger distance counts.
    enter: [(usize, f32, f32); 2],
    /// The plane at which the rectangle leaves a box.
    leave: (usize, f32, f32),
}

/// Sixteen half lines, all ahead or all behind. Lanes without a line repeat the last line.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct Tile {
    /// The slopes of each ray, which are also the shear of triangles.
    shear: [Lanes; 2],
    /// The inverse slopes, for box tests, and the sums for low and high planes.
    inverse: [Lanes; 2],
    low: [Lanes; 2],
    high: [Lanes; 2],
    /// The component of each direction along the axis.
    forward: Lanes,
    /// The distance beyond which hits count, in lengths of the scaled direction.
    from: Lanes,
    /// The distance of the nearest hit, or the end of the ray.
    until: Lanes,
    /// The distance of the nearest hit before it was rounded; infinite without a hit.
    exact: [f64; LANES],
    /// The triangle of the nearest hit.
    triangle: [u32; LANES],
    /// The largest distance along the axis at which a nearer hit can be, for each ray and for all.
    reach: Lanes,
    farthest: f32,
    /// The smallest distance along the axis at which a hit can be.
    nearest: f32,
    bounds: [SlopeBounds; 2],
    /// The rows of the near and far planes of the axis, and their sums.
    along: [usize; 2],
    sums: [f32; 2],
    /// 1 if the rays go up the axis, −1 if they go down.
    sign: f32,
    /// The smallest and the largest slopes.
    least: [f32; 2],
    most: [f32; 2],
    axes: [usize; 3],
    origin: [f32; 3],
    slack: f32,
    widening: f32,
    /// The bits of the lanes with rays.
    active: u32,
}

/// A child to visit: the distance along the axis at which it is entered, and its number.
#[derive(Clone, Copy, Zeroable)]
struct OpenChild {
    enter: f32,
    child: u32,
}

/// The memory of a thread that traces.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct TileScratch {
    rays: PacketRays,
    tile: Tile,
    stack: [OpenChild; STACK],
    listed: OriginNodes,
}

/// Traces the chosen packets whose rays have one origin and one main axis. Removes them from `chosen`.
#[inline(always)]
pub(super) fn trace<S: Simd>(
    simd: S,
    scene: &WideHierarchy,
    lines: &mut Lines<'_>,
    chosen: &mut Vec<u32>,
    scratch: &mut TileScratch,
    hits: &mut Hits,
) {
    let mut kept = 0;
    for i in 0..chosen.len() {
        let packet = chosen[i] as usize;
        if !trace_packet(simd, scene, lines, packet, scratch, hits) {
            chosen[kept] = packet as u32;
            kept += 1;
        }
    }
    chosen.truncate(kept);
}

/// Traces a packet. Returns false, without a change, if the traversal is not suitable for its rays.
#[inline(always)]
fn trace_packet<S: Simd>(
    simd: S,
    scene: &WideHierarchy,
    lines: &mut Lines<'_>,
    packet: usize,
    scratch: &mut TileScratch,
    hits: &mut Hits,
) -> bool {
    if lines.packets[packet].count == 0 {
        return true;
    }
    let TileScratch {
        rays,
        tile,
        stack,
        listed,
    } = scratch;
    rays.set(simd, lines, packet, scene);
    let main = main_axis(rays.direction(0).map(f32::abs));
    let Some(origin) = scaled_origin(lines.packets[packet].ray(0).0, scene) else {
        return false;
    };
    if !rays.are_similar(simd, lines, packet, main) {
        return false;
    }
    let pad = widening(origin);
    let halves = if lines.step.is_some() { 2 } else { 1 };
    let along = rays.direction[main].load(simd).abs();
    for [from, _] in &rays.limits[..halves] {
        // At a negative distance w, the bounds of slopes are wrong by up to 2 · |w|. This may be half of the
        // widening.
        if (from.load(simd) * along).reduce_min() < -0.25 * pad {
            return false;
        }
    }
    listed.find(simd, scene, origin, pad);
    tile.set(simd, rays, origin, main, pad);
    for half in 0..halves {
        tile.face(simd, rays, half);
        let first = (packet + half) * LANES;
        tile.run(simd, scene, stack, listed, first as u32, hits);
        hits.ends[first..first + rays.count].copy_from_slice(&tile.until.0[..rays.count]);
        tile.write(simd, rays, half, &mut lines.packets[packet + half]);
    }
    true
}

impl Tile {
    /// Sets the values that do not depend on the direction along the axis ([`Self::face`]).
    #[inline(always)]
    fn set<S: Simd>(
        &mut self,
        simd: S,
        rays: &PacketRays,
        origin: [f32; 3],
        main: usize,
        widening: f32,
    ) {
        self.axes = sheared_axes(main);
        let along = rays.direction[main].load(simd);
        for k in 0..2 {
            let slopes = rays.direction[self.axes[k]].load(simd) / along;
            self.shear[k].store(slopes);
            self.least[k] = slopes.reduce_min();
            self.most[k] = slopes.reduce_max();
        }
        let largest = origin.iter().fold(0.0f32, |m, o| m.max(o.abs()));
        self.origin = self.axes.map(|k| origin[k]);
        self.slack = (1.0 + largest) * (1.0 + largest) * (1.0 / (1 << 18) as f32);
        self.widening = widening;
        self.active = (1u32 << rays.count) - 1;
    }

    /// Turns the tile along its directions, or against them if `half` is 1.
    #[inline(always)]
    fn face<S: Simd>(&mut self, simd: S, rays: &PacketRays, half: usize) {
        let splat = |x: f32| f32x16::splat(simd, x);
        let kz = self.axes[2];
        let forward = rays.direction[kz].load(simd);
        let is_down = (rays.direction[kz].0[0] < 0.0) != (half == 1);
        let sign = if is_down { -1.0 } else { 1.0 };
        // Along w = sign · (z − origin), a ray has x − origin = sign · slope · w.
        for k in 0..2 {
            let slopes = self.shear[k].load(simd) * splat(sign);
            let slopes = slopes.abs().max(splat(LEAST_SLOPE)).copysign(slopes);
            let inverse = splat(1.0) / slopes;
            let origin = self.origin[k];
            self.inverse[k].store(inverse);
            self.low[k].store(splat(-(origin + self.widening)) * inverse);
            self.high[k].store(splat(-(origin - self.widening)) * inverse);
            let (least, most) = if is_down {
                (-self.most[k], -self.least[k])
            } else {
                (self.least[k], self.most[k])
            };
            let planes = [origin + self.widening, origin - self.widening];
            self.bounds[k] = SlopeBounds::new(self.axes[k], [least, most], planes);
        }
        self.along = [
            2 * kz + usize::from(is_down),
            2 * kz + usize::from(!is_down),
        ];
        self.sign = sign;
        self.sums = [1.0, -1.0].map(|s| -sign * (self.origin[2] + s * sign * self.widening));
        self.triangle = [NO_TRIANGLE; LANES];
        self.exact = [f64::INFINITY; LANES];
        let [from, until] = &rays.limits[half];
        let (from, until) = (from.load(simd), until.load(simd));
        let length = forward.abs() * splat(UP);
        self.forward
            .store(if half == 1 { -forward } else { forward });
        self.from.store(from);
        self.until.store(until);
        self.nearest = (from * length).reduce_min().min(0.0);
        let reach = (until * length).min_precise(splat(FAR));
        self.farthest = reach.reduce_max();
        self.reach.store(reach);
        // The other lanes repeat the last ray, so the largest distance is the one of all rays.
        self.reach.0[rays.count..].fill(-BEYOND);
    }

    /// Writes the hits to the packet of a half of the rays. Rays without a hit keep their distance.
    #[inline(always)]
    fn write<S: Simd>(&self, simd: S, rays: &PacketRays, half: usize, packet: &mut Packet) {
        let mut distance = self.until.load(simd) * rays.outwards.load(simd);
        if half == 1 {
            distance += rays.advance.load(simd);
        }
        let none = u32x16::splat(simd, NO_TRIANGLE);
        let is_hit = u32x16::from_slice(simd, &self.triangle).simd_lt(none);
        let before = f32x16::from_slice(simd, &packet.distance);
        is_hit
            .select(distance, before)
            .store_slice(&mut packet.distance);
        packet.triangle = self.triangle;
    }

    /// Updates the largest distance of all rays.
    #[inline(always)]
    fn set_farthest<S: Simd>(&mut self, simd: S) {
        self.farthest = self.reach.load(simd).reduce_max();
    }

    /// Finds the nearest triangles along the rays. `line` is the line of the first lane.
    #[inline(always)]
    fn run<S: Simd>(
        &mut self,
        simd: S,
        scene: &WideHierarchy,
        stack: &mut [OpenChild; STACK],
        listed: &OriginNodes,
        line: u32,
        hits: &mut Hits,
    ) {
        let mut height = 0;
        for leaf in &listed.leaves[..listed.leaf_count] {
            self.test_leaf(simd, &scene.leaves[*leaf as usize], line, hits);
        }
        for k in 0..listed.count {
            let node = &scene.nodes[listed.nodes[k] as usize];
            height = self.test_node(simd, node, listed.others[k], stack, height);
        }
        while height > 0 {
            height -= 1;
            let open = stack[height];
            if open.enter > self.farthest {
                continue;
            }
            if open.child & LEAF != 0 {
                self.test_leaf(
                    simd,
                    &scene.leaves[(open.child & !LEAF) as usize],
                    line,
                    hits,
                );
            } else {
                height =
                    self.test_node(simd, &scene.nodes[open.child as usize], 255, stack, height);
            }
        }
    }

    /// Pushes the children in `slots` that a ray enters, the farthest first, and returns the new height.
    #[inline(always)]
    fn test_node<S: Simd>(
        &self,
        simd: S,
        node: &Node,
        slots: u32,
        stack: &mut [OpenChild; STACK],
        mut height: usize,
    ) -> usize {
        let set = |x: f32| f32x8::splat(simd, x);
        let row = |r: usize| f32x8::from_slice(simd, node.row(r));
        let sign = set(self.sign);
        let start = row(self.along[0]).mul_add(sign, set(self.sums[0]));
        let end = row(self.along[1]).mul_add(sign, set(self.sums[1]));
        let (mut enter, mut leave) = (start, end);
        for side in &self.bounds {
            for (r, factor, sum) in side.enter {
                enter = enter.max(row(r).mul_add(set(factor), set(sum)));
            }
            let (r, factor, sum) = side.leave;
            leave = leave.min(row(r).mul_add(set(factor), set(sum)));
        }
        enter = enter.max(set(self.nearest));
        let mut bits = enter.simd_le(leave.min(set(self.farthest))).to_bitmask() as u32 & slots;
        if bits == 0 {
            return height;
        }
        let (mut enters, mut starts, mut ends) = ([0.0; WIDTH], [0.0; WIDTH], [0.0; WIDTH]);
        enter.store_slice(&mut enters);
        start.store_slice(&mut starts);
        end.store_slice(&mut ends);
        let [rx, ry] = [self.inverse[0].load(simd), self.inverse[1].load(simd)];
        let [xl, yl] = [self.low[0].load(simd), self.low[1].load(simd)];
        let [xh, yh] = [self.high[0].load(simd), self.high[1].load(simd)];
        let reach = self.reach.load(simd);
        let splat = |x: f32| f32x16::splat(simd, x);
        let base = height;
        while bits != 0 {
            let slot = bits.trailing_zeros() as usize & 7;
            bits &= bits - 1;
            let plane = |axis: usize, high: usize| splat(node.row(2 * axis + high)[slot]);
            let x0 = plane(self.axes[0], 0).mul_add(rx, xl);
            let x1 = plane(self.axes[0], 1).mul_add(rx, xh);
            let y0 = plane(self.axes[1], 0).mul_add(ry, yl);
            let y1 = plane(self.axes[1], 1).mul_add(ry, yh);
            let enter = x0
                .min(x1)
                .max(y0.min(y1))
                .max(splat(starts[slot].max(self.nearest)));
            let leave = x0.max(x1).min(y0.max(y1)).min(splat(ends[slot])).min(reach);
            if enter.simd_le(leave).to_bitmask() as u32 & self.active == 0 {
                continue;
            }
            let mut i = height;
            height += 1;
            while i > base && stack[i - 1].enter < enters[slot] {
                stack[i] = stack[i - 1];
                i -= 1;
            }
            stack[i] = OpenChild {
                enter: enters[slot],
                child: node.child(slot),
            };
        }
        height
    }

    /// Tests the triangles of a leaf against all rays.
    #[inline(always)]
    fn test_leaf<S: Simd>(&mut self, simd: S, leaf: &Leaf, line: u32, hits: &mut Hits) {
        let set = |x: f32| f32x8::splat(simd, x);
        let origin = self.origin.map(set);
        let a = translated(simd, leaf, 0, self.axes, origin);
        let b = translated(simd, leaf, 1, self.axes, origin);
        let c = translated(simd, leaf, 2, self.axes, origin);
        let [x0, x1] = [set(self.least[0]), set(self.most[0])];
        let [y0, y1] = [set(self.least[1]), set(self.most[1])];
        // The smallest upper and the largest lower bound of the three edge functions over the rectangle.
        let (mut upper, mut lower) = (set(BEYOND), set(-BEYOND));
        for (p, q) in [(c, b), (a, c), (b, a)] {
            let k = p[0] * q[1] - p[1] * q[0];
            let m = p[1] * q[2] - p[2] * q[1];
            let n = p[2] * q[0] - p[0] * q[2];
            let (xa, xb, ya, yb) = (x0 * m, x1 * m, y0 * n, y1 * n);
            upper = upper.min(k + (xa.max(xb) + ya.max(yb)));
            lower = lower.max(k + (xa.min(xb) + ya.min(yb)));
        }
        let slack = set(self.slack);
        let sign = set(self.sign);
        let [wa, wb, wc] = [a[2] * sign, b[2] * sign, c[2] * sign];
        let may = (set(-self.slack).simd_le(upper) | lower.simd_le(slack))
            & set(self.nearest - self.widening).simd_le(wa.max(wb).max(wc))
            & wa.min(wb)
                .min(wc)
                .simd_le(set(self.farthest + self.widening));
        let mut bits = may.to_bitmask() as u32;
        if bits == 0 {
            return;
        }
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize & 7;
            bits &= bits - 1;
            self.test_triangle(simd, leaf, lane, line, hits);
        }
        self.set_farthest(simd);
    }

    /// Tests one triangle against all rays.
    #[inline(always)]
    fn test_triangle<S: Simd>(
        &mut self,
        simd: S,
        leaf: &Leaf,
        lane: usize,
        line: u32,
        hits: &mut Hits,
    ) {
        let [kx, ky, kz] = self.axes;
        let splat = |x: f32| f32x16::splat(simd, x);
        let at = |corner: usize, k: usize, axis: usize| {
            leaf.vertices[corner][axis][lane] - self.origin[k]
        };
        let [az, bz, cz] = [at(0, 2, kz), at(1, 2, kz), at(2, 2, kz)];
        let [sx, sy] = [self.shear[0].load(simd), self.shear[1].load(simd)];
        let ax = splat(at(0, 0, kx)) - sx * splat(az);
        let ay = splat(at(0, 1, ky)) - sy * splat(az);
        let bx = splat(at(1, 0, kx)) - sx * splat(bz);
        let by = splat(at(1, 1, ky)) - sy * splat(bz);
        let cx = splat(at(2, 0, kx)) - sx * splat(cz);
        let cy = splat(at(2, 1, ky)) - sy * splat(cz);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let zero = splat(0.0);
        let may = zero.simd_le(u.min(v).min(w)) | u.max(v).max(w).simd_le(zero);
        let bits = may.to_bitmask() as u32 & self.active;
        if bits == 0 {
            return;
        }
        let mut sheared = [[0.0; LANES]; 6];
        for (to, v) in sheared.iter_mut().zip([ax, ay, bx, by, cx, cy]) {
            v.store_slice(to);
        }
        let number = leaf.triangles[lane] & NUMBER;
        let (one_sided, is_passed) = (
            leaf.triangles[lane] & ONE_SIDED != 0,
            leaf.triangles[lane] & PASSED != 0,
        );
        let wide = |x: f32| f64x4::splat(simd, f64::from(x));
        let [az, bz, cz] = [wide(az), wide(bz), wide(cz)];
        for half in [0, 8] {
            if bits >> half & 255 == 0 {
                continue;
            }
            let load = |v: &[f32; LANES]| f32x8::from_slice(simd, &v[half..half + 8]).widen();
            let (ax, ay, bx, by) = (
                load(&sheared[0]),
                load(&sheared[1]),
                load(&sheared[2]),
                load(&sheared[3]),
            );
            let (cx, cy, forward) = (load(&sheared[4]), load(&sheared[5]), load(&self.forward.0));
            let quarters = [
                [ax.0, ay.0, bx.0, by.0, cx.0, cy.0],
                [ax.1, ay.1, bx.1, by.1, cx.1, cy.1],
            ];
            let depths = [az, bz, cz];
            let (t0, met0) = judge(simd, quarters[0], depths, forward.0, one_sided);
            let (t1, met1) = judge(simd, quarters[1], depths, forward.1, one_sided);
            let mut distances = [0.0; 8];
            t0.store_slice(&mut distances[..4]);
            t1.store_slice(&mut distances[4..]);
            let mut met = (met0 | met1 << 4) & (bits >> half);
            while met != 0 {
                let k = met.trailing_zeros() as usize & 7;
                met &= met - 1;
                let (exact, ray) = (distances[k], half + k);
                let distance = exact as f32;
                if distance <= self.from.0[ray] || distance > self.until.0[ray] {
                    continue;
                }
                if is_passed {
                    hits.passed.push((line + ray as u32, number, distance));
                    continue;
                }
                let is_nearest = exact < self.exact[ray]
                    || (exact == self.exact[ray] && number < self.triangle[ray]);
                if !is_nearest {
                    continue;
                }
                self.until.0[ray] = distance;
                self.exact[ray] = exact;
                self.triangle[ray] = number;
                let reach = distance * self.forward.0[ray].abs();
                self.reach.0[ray] = reach + reach.abs() * 1e-6;
            }
        }
    }
}

/// Returns a corner of the triangles of a leaf relative to the origin, by axis.
#[inline(always)]
fn translated<S: Simd>(
    simd: S,
    leaf: &Leaf,
    corner: usize,
    axes: [usize; 3],
    [ox, oy, oz]: [f32x8<S>; 3],
) -> [f32x8<S>; 3] {
    let [x, y, z] = axes;
    let v = &leaf.vertices[corner];
    [
        f32x8::from_slice(simd, &v[x]) - ox,
        f32x8::from_slice(simd, &v[y]) - oy,
        f32x8::from_slice(simd, &v[z]) - oz,
    ]
}

/// Tests four rays against a triangle with sheared corners (x and y of the first, second and third) and
/// depths. Returns the distances, and the bits of the rays that meet it.
#[inline(always)]
fn judge<S: Simd>(
    simd: S,
    [ax, ay, bx, by, cx, cy]: [f64x4<S>; 6],
    [az, bz, cz]: [f64x4<S>; 3],
    forward: f64x4<S>,
    one_sided: bool,
) -> (f64x4<S>, u32) {
    let zero = f64x4::splat(simd, 0.0);
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let positive = zero.simd_le(u) & zero.simd_le(v) & zero.simd_le(w);
    let negative = u.simd_le(zero) & v.simd_le(zero) & w.simd_le(zero);
    let area = (u + v) + w;
    let flat = area.simd_le(zero) & zero.simd_le(area);
    let scale = area * forward;
    let distance = ((u * az + v * bz) + w * cz) / scale;
    let mut met = (positive | negative).to_bitmask() & !flat.to_bitmask();
    if one_sided {
        met &= zero.simd_lt(scale).to_bitmask();
    }
    (distance, met as u32)
}

impl SlopeBounds {
    /// Returns the planes of an axis that bound a rectangle of slopes. `slopes` are the smallest and the
    /// largest slope, and `origins` the origin plus and minus the widening.
    fn new(axis: usize, slopes: [f32; 2], origins: [f32; 2]) -> Self {
        let ([least, most], [plus, minus]) = (slopes, origins);
        let (low, high) = (2 * axis, 2 * axis + 1);
        let at_low = |factor: f32| (low, factor, -plus * factor);
        let at_high = |factor: f32| (high, factor, -minus * factor);
        if least > LEAST_SLOPE {
            Self {
                enter: [at_low(1.0 / most), (low, 0.0, -BEYOND)],
                leave: at_high(1.0 / least),
            }
        } else if most < -LEAST_SLOPE {
            Self {
                enter: [at_high(1.0 / least), (low, 0.0, -BEYOND)],
                leave: at_low(1.0 / most),
            }
        } else {
            let (up, down) = (most.max(LEAST_SLOPE), least.min(-LEAST_SLOPE));
            Self {
                enter: [at_low(1.0 / up), at_high(1.0 / down)],
                leave: (low, 0.0, BEYOND),
            }
        }
    }
}
