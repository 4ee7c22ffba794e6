//! The traversal of half lines of different directions, up to 64 at a time.
//!
//! A single traversal waits for its own loads and for the branches that depend on them. Here the steps of 64
//! half lines alternate: each half line advances to its next child, then leaves are tested, then nodes. The
//! steps of different half lines do not depend on each other, so the processor overlaps them. No branch of a
//! step is hard to predict, because lists grow by zero or one element without a branch.
//!
//! A half line is a ray from an origin. The second half of a line is the ray in the opposite direction. Both
//! halves, and all lines with the same origin, share the search for the nodes that contain the origin.

use bytemuck::Zeroable;
use fearless_simd::{
    Bytes as _, Select as _, Simd, SimdBase, SimdFloat as _, SimdInto as _, SimdMask as _, f32x8,
    mask32x8, u32x8,
};

use super::hierarchy::{
    BEYOND, LEAF, Leaf, MAX_LEVELS, NO_TRIANGLE, NUMBER, Node, ONE_SIDED, PASSED, WIDTH,
    WideHierarchy,
};
use super::line_origin::{LISTED, OriginNodes, scaled_origin, widening};
use super::lines::{Hits, Lines};
use super::packet_rays::PacketRays;
use crate::packet::LANES;

/// The number of half lines that are traced at a time.
const HALVES: usize = 64;
/// The length of a list of half lines: more than [`HALVES`], and a power of two, so that a place needs no
/// check.
const LIST: usize = 128;
/// The height of a stack: the listed nodes, and a path below one of them.
const STACK: usize = LISTED + MAX_LEVELS + 1;
/// The largest distance of a hit that culls children. The keys of real children are below 2¹⁰¹, so no child
/// is culled without a hit.
const FAR_KEY: f32 = 2e38;

/// A half line, and its nearest hit so far. All numbers are in scaled units (module `cpu`).
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct HalfLine {
    /// The inverse direction, for box tests.
    inverse: [f32; 3],
    /// The sum for near planes: minus the product of the origin with the inverse direction, less the
    /// widening.
    near: [f32; 3],
    /// The sum for far planes.
    far: [f32; 3],
    /// The row of the near plane of each axis ([`Node::row`]).
    row: [u32; 3],
    /// The axes in the order of the sheared frame, for triangle tests.
    axes: [u32; 3],
    /// The origin along these axes.
    origin: [f32; 3],
    /// The shear of the first two axes.
    shear: [f32; 2],
    /// The component of the direction along the third axis.
    forward: f32,
    /// The distance beyond which hits count.
    from: f32,
    /// The distance of the nearest hit, or the end of the half line.
    until: f32,
    /// The distance of the nearest hit before it was rounded; infinite without a hit.
    exact: f64,
    /// The triangle of the nearest hit.
    triangle: u32,
    /// The largest key of a node that can hold a nearer hit.
    cull: i32,
    /// The child to visit.
    child: u32,
    /// The height of the stack.
    height: u32,
    /// The line: packet · 16 + lane.
    line: u32,
    /// The factor from scaled distances to given ones.
    outwards: f32,
    /// The summand of given distances: the distance from the origin to the start of a reversed ray, or −0,
    /// which changes no number.
    start: f32,
}

/// The children of a node that are still to be visited.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct Open {
    /// The distance at which each child is entered, with its slot in the last three bits, or [`BEYOND`] if
    /// the child is not visited.
    keys: [f32; WIDTH],
    node: u32,
    /// The number of children to visit.
    left: u32,
}

/// The sheared vertices of a leaf: x, y and z of the first, second and third corner.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct Sheared([[f32; WIDTH]; 9]);

/// A triangle that a half line may meet.
#[derive(Clone, Copy, Zeroable)]
struct Candidate {
    half: u32,
    sheared: u32,
    lane: u32,
    triangle: u32,
}

/// A list of half lines.
struct HalfList {
    places: [u32; LIST],
    count: usize,
}

impl HalfList {
    const fn new() -> Self {
        Self {
            places: [0; LIST],
            count: 0,
        }
    }

    /// Appends an element if `keep` is true, without a branch.
    #[inline(always)]
    fn push_if(&mut self, place: usize, keep: bool) {
        self.places[self.count % LIST] = place as u32;
        self.count += usize::from(keep);
    }

    /// Returns an element, a place in arrays of [`HALVES`] elements.
    #[inline(always)]
    fn get(&self, i: usize) -> usize {
        self.places[i % LIST] as usize % HALVES
    }
}

/// The memory of a thread that traces.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct BatchScratch {
    halves: [HalfLine; HALVES],
    stacks: [[Open; STACK]; HALVES],
    sheared: [Sheared; HALVES],
    candidates: [Candidate; (HALVES + 1) * WIDTH],
    listed: OriginNodes,
    /// The rays of the packet whose lines are begun.
    rays: PacketRays,
}

/// Returns the largest key of a node that can hold a hit at a distance.
#[inline(always)]
fn cull_of(distance: f32) -> i32 {
    // The sum turns a negative zero into a positive one. As a number, the bits of a negative zero are less
    // than every key.
    ((distance.clamp(0.0, FAR_KEY) + 0.0).to_bits() | 7) as i32
}

/// Returns the axis of the largest size; of equal ones, the first.
#[inline(always)]
pub(super) fn main_axis(size: [f32; 3]) -> usize {
    let second = size[1] > size[0];
    let larger = if second { size[1] } else { size[0] };
    if size[2] > larger {
        2
    } else {
        usize::from(second)
    }
}

/// Returns the axes in a right-handed order that ends with the main axis.
#[inline(always)]
pub(super) fn sheared_axes(main: usize) -> [usize; 3] {
    let first = if main == 2 { 0 } else { main + 1 };
    let second = if first == 2 { 0 } else { first + 1 };
    [first, second, main]
}

impl HalfLine {
    /// Returns both halves of a line with a scaled origin and direction.
    #[inline(always)]
    fn pair(origin: [f32; 3], direction: [f32; 3], widening: f32) -> [Self; 2] {
        /// The smallest component of a direction in box tests; smaller ones are replaced by it. A component
        /// that is replaced moves a point by less than the widening over all distances in the scene.
        const LEAST: f32 = 1.0 / (1u64 << 60) as f32;
        let axes = sheared_axes(main_axis(direction.map(f32::abs)));
        let mut ahead = Self::zeroed();
        let mut behind = Self::zeroed();
        for a in 0..3 {
            let is_backwards = direction[a] < 0.0;
            let size = direction[a].abs();
            let size = if size < LEAST { LEAST } else { size };
            let inverse = 1.0 / if is_backwards { -size } else { size };
            let pad = if is_backwards { -widening } else { widening };
            let near = -(origin[a] + pad) * inverse;
            let far = -(origin[a] - pad) * inverse;
            let row = 2 * a as u32 + u32::from(is_backwards);
            (ahead.inverse[a], ahead.near[a], ahead.far[a]) = (inverse, near, far);
            (behind.inverse[a], behind.near[a], behind.far[a]) = (-inverse, -far, -near);
            (ahead.row[a], behind.row[a]) = (row, row ^ 1);
        }
        let forward = direction[axes[2]];
        for half in [&mut ahead, &mut behind] {
            half.axes = axes.map(|a| a as u32);
            half.origin = axes.map(|a| origin[a]);
            half.shear = [direction[axes[0]] / forward, direction[axes[1]] / forward];
        }
        ahead.forward = forward;
        behind.forward = -forward;
        [ahead, behind]
    }

    /// Sets the interval in which hits count.
    #[inline(always)]
    fn limit(&mut self, [from, until]: [f32; 2], line: usize) {
        self.from = from;
        self.until = until;
        self.exact = f64::INFINITY;
        self.triangle = NO_TRIANGLE;
        self.cull = cull_of(until);
        self.line = line as u32;
    }

    /// Returns the distances at which the half line enters and leaves the boxes of a node.
    #[inline(always)]
    fn spans<S: Simd>(&self, simd: S, node: &Node) -> (f32x8<S>, f32x8<S>) {
        let row = |r: u32| f32x8::from_slice(simd, node.row(r as usize));
        let set = |x: f32| f32x8::splat(simd, x);
        let [x, y, z] = self.row;
        let [rx, ry, rz] = self.inverse.map(set);
        let enter = row(x)
            .mul_add(rx, set(self.near[0]))
            .max(row(y).mul_add(ry, set(self.near[1])))
            .max(row(z).mul_add(rz, set(self.near[2])));
        let leave = row(x ^ 1)
            .mul_add(rx, set(self.far[0]))
            .min(row(y ^ 1).mul_add(ry, set(self.far[1])))
            .min(row(z ^ 1).mul_add(rz, set(self.far[2])));
        (enter, leave)
    }

    /// Writes to `open` the children that the half line enters, and returns their number. `bounds` is a lower
    /// bound of the distances at which children are entered.
    #[inline(always)]
    fn open<S: Simd>(
        &self,
        simd: S,
        spans: (f32x8<S>, f32x8<S>),
        bounds: f32x8<S>,
        open: &mut Open,
    ) -> u32 {
        let (enter, leave) = spans;
        let from = f32x8::splat(simd, self.from).max(bounds);
        let visited = enter
            .max(from)
            .simd_le(leave.min(f32x8::splat(simd, self.until)));
        keys(simd, enter, visited).store_slice(&mut open.keys);
        open.left = (visited.to_bitmask() as u32).count_ones();
        open.left
    }

    /// Shears the triangles of a leaf, and returns the bits of the triangles that the line may meet.
    #[inline(always)]
    fn shear<S: Simd>(&self, simd: S, leaf: &Leaf, sheared: &mut Sheared) -> u32 {
        let [kx, ky, kz] = self.axes.map(|k| k as usize);
        let set = |x: f32| f32x8::splat(simd, x);
        let at = |corner: usize, axis: usize| f32x8::from_slice(simd, &leaf.vertices[corner][axis]);
        let [ox, oy, oz] = self.origin.map(set);
        let [sx, sy] = self.shear.map(set);
        let az = at(0, kz) - oz;
        let bz = at(1, kz) - oz;
        let cz = at(2, kz) - oz;
        let ax = (at(0, kx) - ox) - sx * az;
        let ay = (at(0, ky) - oy) - sy * az;
        let bx = (at(1, kx) - ox) - sx * bz;
        let by = (at(1, ky) - oy) - sy * bz;
        let cx = (at(2, kx) - ox) - sx * cz;
        let cy = (at(2, ky) - oy) - sy * cz;
        let rows = [ax, ay, az, bx, by, bz, cx, cy, cz];
        for (to, row) in sheared.0.iter_mut().zip(rows) {
            row.store_slice(to);
        }
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let zero = set(0.0);
        let may = zero.simd_le(u.min(v).min(w)) | u.max(v).max(w).simd_le(zero);
        may.to_bitmask() as u32
    }

    /// Tests a triangle exactly, and keeps the hit if it is the nearest. Adds hits on passed triangles to
    /// `hits`.
    #[inline(always)]
    fn judge(&mut self, sheared: &Sheared, lane: usize, triangle: u32, hits: &mut Hits) {
        let at = |k: usize| f64::from(sheared.0[k][lane % WIDTH]);
        let ([ax, ay, az], [bx, by, bz]) = ([at(0), at(1), at(2)], [at(3), at(4), at(5)]);
        let [cx, cy, cz] = [at(6), at(7), at(8)];
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let least = if u < v { u } else { v };
        let least = if w < least { w } else { least };
        let most = if u < v { v } else { u };
        let most = if w > most { w } else { most };
        let area = (u + v) + w;
        let scale = area * f64::from(self.forward);
        let exact = ((u * az + v * bz) + w * cz) / scale;
        let distance = exact as f32;
        let number = triangle & NUMBER;
        // The axes are right-handed, and `area` is positive if the vertices run clockwise as seen from up the
        // third axis. A ray up this axis sees them from below.
        let is_front = (triangle & ONE_SIDED == 0) | (scale > 0.0);
        let is_inside = ((least >= 0.0) | (most <= 0.0)) & (area != 0.0);
        // The rounded distance decides whether a hit is before the end.
        let counts = is_inside & is_front & (distance > self.from) & (distance <= self.until);
        if triangle & PASSED != 0 {
            if counts {
                hits.passed.push((self.line, number, distance));
            }
            return;
        }
        let is_nearest = (exact < self.exact) | ((exact == self.exact) & (number < self.triangle));
        let is_met = counts & is_nearest;
        self.until = if is_met { distance } else { self.until };
        self.exact = if is_met { exact } else { self.exact };
        self.triangle = if is_met { number } else { self.triangle };
        self.cull = if is_met { cull_of(distance) } else { self.cull };
    }
}

/// Returns the keys of a node's children: their distances, with the slots in the last three bits.
#[inline(always)]
fn keys<S: Simd>(simd: S, enter: f32x8<S>, visited: mask32x8<S>) -> f32x8<S> {
    let slots: u32x8<S> = [0u32, 1, 2, 3, 4, 5, 6, 7].simd_into(simd);
    let distances: u32x8<S> = enter.max(f32x8::splat(simd, 0.0)).bitcast();
    let tagged = (distances & u32x8::splat(simd, !7)) | slots;
    visited.select(tagged.bitcast(), f32x8::splat(simd, BEYOND))
}

/// Traces lines, each separately.
#[inline(always)]
pub(super) fn trace<S: Simd>(
    simd: S,
    scene: &WideHierarchy,
    lines: &mut Lines<'_>,
    scratch: &mut BatchScratch,
    hits: &mut Hits,
) {
    let mut next = (0, 0);
    let mut listed_origin = [f32::NAN; 3];
    loop {
        let (used, waiting) = begin(
            simd,
            scene,
            lines,
            &mut next,
            &mut listed_origin,
            scratch,
            hits,
        );
        if used == 0 && next.0 == lines.chosen.len() {
            return;
        }
        advance(simd, scene, scratch, waiting, hits);
        for half in &scratch.halves[..used] {
            hits.ends[half.line as usize] = half.until;
            if half.triangle != NO_TRIANGLE {
                let packet = &mut lines.packets[half.line as usize / LANES];
                let lane = half.line as usize % LANES;
                packet.distance[lane] = half.until * half.outwards + half.start;
                packet.triangle[lane] = half.triangle;
            }
        }
    }
}

/// Prepares the next lines, up to [`HALVES`] half lines. Returns the number of half lines, and a list of the
/// half lines that have nodes to visit. `next` is the place in the chosen packets, and the lane, of the next
/// line.
#[inline(always)]
fn begin<S: Simd>(
    simd: S,
    scene: &WideHierarchy,
    lines: &mut Lines<'_>,
    next: &mut (usize, usize),
    listed_origin: &mut [f32; 3],
    scratch: &mut BatchScratch,
    hits: &mut Hits,
) -> (usize, HalfList) {
    let BatchScratch {
        halves,
        stacks,
        sheared,
        listed,
        rays,
        ..
    } = scratch;
    let halves_per_line = if lines.step.is_some() { 2 } else { 1 };
    let mut waiting = HalfList::new();
    let mut used = 0;
    while used + halves_per_line <= HALVES {
        let Some(packet) = lines.chosen.get(next.0).map(|p| *p as usize) else {
            break;
        };
        let lane = next.1;
        if lane >= lines.packets[packet].count {
            *next = (next.0 + 1, 0);
            continue;
        }
        if lane == 0 {
            rays.set(simd, lines, packet, scene);
        }
        next.1 += 1;
        if rays.scaled >> lane & 1 == 0 {
            continue;
        }
        let Some(origin) = scaled_origin(lines.packets[packet].ray(lane).0, scene) else {
            continue;
        };
        let pad = widening(origin);
        if origin != *listed_origin {
            listed.find(simd, scene, origin, pad);
            *listed_origin = origin;
        }
        let mut pair = HalfLine::pair(origin, rays.direction(lane), pad);
        let line = packet * LANES + lane;
        let limits = rays.limits.iter().take(halves_per_line);
        for (half, [from, until]) in pair.iter_mut().zip(limits) {
            half.limit([from.0[lane], until.0[lane]], line);
            half.outwards = rays.outwards.0[lane];
        }
        pair[1].line += LANES as u32;
        pair[0].start = -0.0;
        pair[1].start = rays.advance.0[lane];
        for leaf in &listed.leaves[..listed.leaf_count] {
            let leaf = &scene.leaves[*leaf as usize];
            let mut bits = pair[0].shear(simd, leaf, &mut sheared[0]);
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize % WIDTH;
                bits &= bits - 1;
                for half in &mut pair[..halves_per_line] {
                    half.judge(&sheared[0], lane, leaf.triangles[lane], hits);
                }
            }
        }
        let zero = f32x8::splat(simd, 0.0);
        for k in 0..listed.count {
            let node = &scene.nodes[listed.nodes[k] as usize];
            let bounds = f32x8::from_slice(simd, &listed.bounds[k]);
            let (enter, leave) = pair[0].spans(simd, node);
            let both = [(enter, leave), (zero - leave, zero - enter)];
            for (i, spans) in both.into_iter().enumerate().take(halves_per_line) {
                let half = &mut pair[i];
                let open = &mut stacks[(used + i) % HALVES][half.height as usize];
                open.node = listed.nodes[k];
                let count = half.open(simd, spans, bounds, open);
                half.height += u32::from(count != 0);
            }
        }
        for half in pair.into_iter().take(halves_per_line) {
            halves[used % HALVES] = half;
            waiting.push_if(used, half.height > 0);
            used += 1;
        }
    }
    (used, waiting)
}

/// Traces the half lines that wait until none has a node to visit.
#[inline(always)]
fn advance<S: Simd>(
    simd: S,
    scene: &WideHierarchy,
    scratch: &mut BatchScratch,
    mut waiting: HalfList,
    hits: &mut Hits,
) {
    let BatchScratch {
        halves,
        stacks,
        sheared,
        candidates,
        ..
    } = scratch;
    let no_bounds = f32x8::splat(simd, f32::NEG_INFINITY);
    let mut inner = HalfList::new();
    let mut leaves = HalfList::new();
    while waiting.count | inner.count | leaves.count != 0 {
        // Each waiting half line advances to its nearest open child.
        let mut again = HalfList::new();
        for i in 0..waiting.count {
            let place = waiting.get(i);
            let half = &mut halves[place];
            let open = &mut stacks[place][half.height as usize - 1];
            let key = f32x8::from_slice(simd, &open.keys).reduce_min().to_bits() as i32;
            let is_visited = key <= half.cull;
            let slot = key as usize % WIDTH;
            let child = scene.nodes[open.node as usize].child(slot);
            open.keys[slot] = BEYOND;
            open.left -= 1;
            half.height -= u32::from(!is_visited | (open.left == 0));
            half.child = child;
            inner.push_if(place, is_visited & (child & LEAF == 0));
            leaves.push_if(place, is_visited & (child & LEAF != 0));
            again.push_if(place, !is_visited & (half.height > 0));
        }
        waiting = again;
        // Leaves.
        let mut queued = 0;
        for i in 0..leaves.count {
            let place = leaves.get(i);
            let leaf = &scene.leaves[(halves[place].child & !LEAF) as usize];
            let mut bits = halves[place].shear(simd, leaf, &mut sheared[i % HALVES]);
            // Most leaves have at most two candidates.
            for _ in 0..2 {
                let lane = (bits | 128).trailing_zeros();
                let triangle = leaf.triangles[lane as usize % WIDTH];
                candidates[queued] = Candidate {
                    half: place as u32,
                    sheared: i as u32,
                    lane,
                    triangle,
                };
                queued += usize::from(bits != 0);
                bits &= bits.wrapping_sub(1);
            }
            while bits != 0 {
                let lane = bits.trailing_zeros();
                let triangle = leaf.triangles[lane as usize % WIDTH];
                candidates[queued] = Candidate {
                    half: place as u32,
                    sheared: i as u32,
                    lane,
                    triangle,
                };
                queued += 1;
                bits &= bits - 1;
            }
        }
        for c in &candidates[..queued] {
            let half = &mut halves[c.half as usize % HALVES];
            half.judge(
                &sheared[c.sheared as usize % HALVES],
                c.lane as usize,
                c.triangle,
                hits,
            );
        }
        for i in 0..leaves.count {
            let place = leaves.get(i);
            waiting.push_if(place, halves[place].height > 0);
        }
        // Nodes.
        let mut next_inner = HalfList::new();
        leaves = HalfList::new();
        for i in 0..inner.count {
            let place = inner.get(i);
            let half = &mut halves[place];
            let node = &scene.nodes[half.child as usize];
            let open = &mut stacks[place][half.height as usize];
            open.node = half.child;
            let spans = half.spans(simd, node);
            let count = half.open(simd, spans, no_bounds, open);
            let key = f32x8::from_slice(simd, &open.keys).reduce_min();
            let slot = key.to_bits() as usize % WIDTH;
            open.keys[slot] = BEYOND;
            open.left = count.wrapping_sub(1);
            half.height += u32::from(count > 1);
            half.child = node.child(slot);
            let is_leaf = half.child & LEAF != 0;
            next_inner.push_if(place, (count != 0) & !is_leaf);
            leaves.push_if(place, (count != 0) & is_leaf);
            waiting.push_if(place, (count == 0) & (half.height > 0));
        }
        inner = next_inner;
    }
}
