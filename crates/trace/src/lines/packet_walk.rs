//! The traversal of the cells along the lines of a packet, eight lines at a time. [`CellGrid::walk`] finds
//! the same cells for the free part of each line, to the bit.

use fearless_simd::{
    Level, Select as _, Simd, SimdBase, SimdFloat as _, SimdInt as _, SimdMask as _, dispatch,
    f32x8, i32x8,
};

use super::grid::{CellGrid, Crossed};
use crate::packet::{LANES, OVERLAP, Packet};

/// The number of lines that are traversed at a time.
const WIDTH: usize = 8;

/// The cells that each line of a packet crosses.
#[derive(Debug, Default)]
pub struct PacketCrossed {
    /// The cells by lane.
    pub lanes: [Crossed; LANES],
}

impl CellGrid {
    /// Finds the cells that the free part of each line of a packet crosses, in order. `behind` is the traced
    /// packet [`Packet::reversed`] by `step`.
    pub fn walk_packet(
        &self,
        ahead: &Packet,
        behind: &Packet,
        step: f32,
        crossed: &mut PacketCrossed,
    ) {
        let packets = HalfPackets {
            ahead,
            behind,
            step,
        };
        walk_packet(Level::new(), self, packets, crossed);
    }
}

/// The halves of the lines of a packet, and the step between them.
#[derive(Clone, Copy)]
struct HalfPackets<'a> {
    ahead: &'a Packet,
    behind: &'a Packet,
    step: f32,
}

/// Traverses the lines with an instruction set.
fn walk_packet(level: Level, grid: &CellGrid, lines: HalfPackets<'_>, crossed: &mut PacketCrossed) {
    dispatch!(level, simd => {
        let parts = crossed.lanes.chunks_exact_mut(WIDTH);
        for (first, out) in (0..LANES).step_by(WIDTH).zip(parts) {
            out.iter_mut().for_each(Vec::clear);
            if first < lines.ahead.count {
                walk(simd, grid, lines, first, out);
            }
        }
    });
}

/// The word of the current cell of each line: its place in a row, and the bits of the crossed cells.
struct OpenWords {
    places: [u32; WIDTH],
    bits: [u64; WIDTH],
}

/// The coordinates of cells, one axis of eight lines.
#[derive(Clone, Copy)]
struct Axis<S: Simd> {
    /// The coordinates, and the largest coordinate of the grid.
    cell: i32x8<S>,
    last: i32x8<S>,
    /// 1 or −1, or 0 if the line does not move along the axis.
    step: i32x8<S>,
    /// The distance at which the line leaves the cell, and the distance between two cells.
    next: f32x8<S>,
    delta: f32x8<S>,
}

/// Traverses the lines of eight lanes from `first`, of which at least one is a line.
///
/// An alive line ends, or moves to the next cell along an axis on which it moves: on a flat axis, `next` is
/// infinite, so it is at least `to`, which is not NaN. The loop therefore ends.
#[inline(always)]
fn walk<S: Simd>(
    simd: S,
    grid: &CellGrid,
    lines: HalfPackets<'_>,
    first: usize,
    out: &mut [Crossed],
) {
    let HalfPackets {
        ahead,
        behind,
        step,
    } = lines;
    let count = (ahead.count - first).min(WIDTH);
    let set = |x: f32| f32x8::splat(simd, x);
    let int = |x: i32| i32x8::splat(simd, x);
    let lanes = first..first + WIDTH;
    let (zero, one) = (set(0.0), set(1.0));
    let mut alive = (1u32 << count) - 1;
    let (mut longest, mut largest, mut square) = (zero, zero, zero);
    let (mut start, mut along, mut inverse) = ([zero; 3], [zero; 3], [zero; 3]);
    // The free part of each line ([`Packet::free`]).
    for a in 0..3 {
        let direction = f32x8::from_slice(simd, &ahead.direction[a][lanes.clone()]);
        let origin = f32x8::from_slice(simd, &ahead.origin[a][lanes.clone()]);
        longest = longest.max_precise(direction.abs());
        largest = largest.max_precise(origin.abs());
        start[a] = (origin - set(grid.bounds().0[a])) * set(grid.shape().per_unit[a]);
        along[a] = direction * set(grid.shape().per_unit[a]);
        inverse[a] = one / along[a];
    }
    let advance = set(step).max_precise(largest * set(OVERLAP)) / longest;
    let advance = longest.simd_gt(zero).select(advance, zero);
    let mut from = advance - f32x8::from_slice(simd, &behind.distance[lanes.clone()]);
    let mut to = f32x8::from_slice(simd, &ahead.distance[lanes]);
    for a in 0..3 {
        let n = set(grid.cells()[a] as f32);
        let is_flat = along[a].simd_eq(zero);
        let is_inside = zero.simd_le(start[a]) & start[a].simd_le(n);
        alive &= !(is_flat & !is_inside).to_bitmask() as u32;
        let (u, v) = (-start[a] * inverse[a], (n - start[a]) * inverse[a]);
        from = is_flat.select(from, from.max_precise(u.min_precise(v)));
        to = is_flat.select(to, to.min_precise(u.max_precise(v)));
        square = if a == 0 {
            along[a] * along[a]
        } else {
            square + along[a] * along[a]
        };
    }
    alive &= from.simd_lt(to).to_bitmask() as u32;
    let least = set(grid.margin()) / square.sqrt();
    let axis = Axis {
        cell: int(0),
        last: int(0),
        step: int(0),
        next: zero,
        delta: zero,
    };
    let mut axes = [axis; 3];
    for (a, axis) in axes.iter_mut().enumerate() {
        let is_up = along[a].simd_gt(zero);
        let is_flat = along[a].simd_eq(zero);
        axis.last = int(grid.cells()[a] as i32 - 1);
        let at: i32x8<S> = (start[a] + along[a] * from).to_int_precise();
        axis.cell = at.max(int(0)).min(axis.last);
        axis.step = is_flat.select(int(0), is_up.select(int(1), int(-1)));
        axis.delta = is_flat.select(zero, inverse[a].abs());
        let plane: f32x8<S> = (axis.cell + is_up.select(int(1), int(0))).to_float();
        axis.next = is_flat.select(set(f32::INFINITY), (plane - start[a]) * inverse[a]);
    }
    let mut open = OpenWords {
        places: [u32::MAX; WIDTH],
        bits: [0; WIDTH],
    };
    let [mut x, mut y, mut z] = axes;
    let shape = grid.shape();
    let [sx, sy, sz] = shape.side;
    let [bx, by, _] = shape.bricks.map(|b| int(b as i32));
    let [mx, my, mz] = shape.side.map(|s| int((1 << s) - 1));
    let mut t = from;
    // The next axis of each line, as in [`CellGrid::walk`].
    while alive != 0 {
        let is_nearer = x.next.simd_lt(y.next);
        let nearer = is_nearer.select(x.next, y.next);
        let is_z = nearer.simd_ge(z.next);
        let is_x = is_nearer & !is_z;
        let is_y = !(is_nearer | is_z);
        let through = is_z.select(z.next, nearer);
        let end = to.simd_lt(through).select(to, through);
        let mut credited = (end - t).simd_gt(least).to_bitmask() as u32 & alive;
        if credited != 0 {
            let word = ((z.cell >> sz) * by + (y.cell >> sy)) * bx + (x.cell >> sx);
            let bit = ((z.cell & mz) << sy | (y.cell & my)) << sx | (x.cell & mx);
            let (mut words, mut bits) = ([0; WIDTH], [0; WIDTH]);
            word.store_slice(&mut words);
            bit.store_slice(&mut bits);
            while credited != 0 {
                let lane = credited.trailing_zeros() as usize % WIDTH;
                credited &= credited - 1;
                open.add(lane, words[lane] as u32, bits[lane] as u32, out);
            }
        }
        alive &= !(through.simd_ge(to).to_bitmask() as u32);
        t = end.simd_gt(t).select(end, t);
        x.next += is_x.select(x.delta, zero);
        y.next += is_y.select(y.delta, zero);
        z.next += is_z.select(z.delta, zero);
        x.cell += is_x.select(x.step, int(0));
        y.cell += is_y.select(y.step, int(0));
        z.cell += is_z.select(z.step, int(0));
        let outside = x.outside_sign() | y.outside_sign() | z.outside_sign();
        alive &= !(outside.simd_lt(int(0)).to_bitmask() as u32);
    }
    for lane in 0..count {
        open.flush(lane, out);
    }
}

impl<S: Simd> Axis<S> {
    /// Returns numbers that are negative for lines outside the grid.
    #[inline(always)]
    fn outside_sign(&self) -> i32x8<S> {
        self.cell | (self.last - self.cell)
    }
}

impl OpenWords {
    #[inline(always)]
    fn add(&mut self, lane: usize, place: u32, bit: u32, out: &mut [Crossed]) {
        if self.places[lane] != place {
            self.flush(lane, out);
            self.places[lane] = place;
            self.bits[lane] = 0;
        }
        self.bits[lane] |= 1 << bit;
    }

    /// Appends the word of a line to its cells.
    #[inline(always)]
    fn flush(&self, lane: usize, out: &mut [Crossed]) {
        if self.bits[lane] != 0 {
            out[lane].push((self.places[lane], self.bits[lane]));
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::cpu::levels;

    /// Returns coordinates of a ray: usual ones, and numbers that make infinite or undefined products.
    fn coordinate(most: f32) -> impl Strategy<Value = f32> {
        let special = [
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::NAN,
            1e-40,
            -1e-45,
            0.0,
            -0.0,
            1e30,
        ];
        prop_oneof![
            16 => -most..most,
            4 => (-most..most).prop_map(f32::round),
            1 => proptest::sample::select(special.to_vec()),
        ]
    }

    proptest! {
        #[test]
        fn packet_walk_equals_walk_to_the_bit(
            cells in prop_oneof![[1u32..10, 1u32..10, 1u32..10], [1u32..30, 1u32..3, 1u32..30]],
            rays in proptest::collection::vec(
                (
                    proptest::array::uniform3(coordinate(12.0)),
                    // Directions along axes and diagonals, from places on planes, cause ties.
                    proptest::array::uniform3(coordinate(1.4)),
                    prop_oneof![[0f32..8.0, 0f32..8.0], Just([f32::INFINITY; 2])],
                ),
                0..=LANES,
            ),
            // Far from the origin, the least length in a cell is larger.
            place in prop_oneof![Just(0.0f32), Just(30_000.0)],
        ) {
            let corner = Vec3::new(-1.0, 2.0, 0.5) + place;
            let grid = CellGrid::new(corner, corner + Vec3::new(4.0, 3.0, 9.0), cells);
            let mut ahead = Packet::default();
            for (origin, direction, _) in &rays {
                ahead.push(origin.map(|x| x + place), *direction);
            }
            let mut behind = ahead.reversed(1e-3);
            for (lane, (.., distances)) in rays.iter().enumerate() {
                [ahead.distance[lane], behind.distance[lane]] = *distances;
            }
            let mut expected = PacketCrossed::default();
            for lane in 0..rays.len() {
                let (origin, direction) = ahead.ray(lane);
                let (from, to) = ahead.free(&behind, lane, 1e-3);
                grid.walk(origin, direction, from, to, &mut expected.lanes[lane]);
            }
            let lines = HalfPackets { ahead: &ahead, behind: &behind, step: 1e-3 };
            for level in levels() {
                let mut crossed = PacketCrossed::default();
                // The cells of an earlier packet are removed.
                crossed.lanes[LANES - 1].push((7, 7));
                walk_packet(level, &grid, lines, &mut crossed);
                prop_assert_eq!(&crossed.lanes, &expected.lanes, "{:?}", level);
            }
        }
    }
}
