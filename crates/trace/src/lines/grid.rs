//! The cells of a block, and the traversal of the cells along a segment.
//!
//! Cells are numbered in bricks of one 64-bit word: a segment that crosses a dozen cells touches three or
//! four words, and neighbours are mostly in the same word. A brick has 4×4×4 cells, fewer along the short
//! axes of a flat block.

use glam::Vec3;
use sightline_viewcells::division::ROUNDING;

/// The binary logarithm of the number of cells in a brick, 64.
const BITS: u32 = 6;
/// The minimum fraction of a cell's size that a segment must cross for the cell to be credited.
const MARGIN: f32 = 1.0 / 1024.0;

/// A block of equal cells.
#[derive(Clone, Debug)]
pub struct CellGrid {
    cells: [u32; 3],
    /// The binary logarithms of a brick's sides.
    side: [u32; 3],
    bricks: [u32; 3],
    /// The mask of the first cells of a brick along an axis, by axis.
    first: [u64; 3],
    /// The summand of a coordinate in a cell's [`Slot::index`], by axis and coordinate.
    part: [Vec<u32>; 3],
    min: Vec3,
    max: Vec3,
    per_unit: [f32; 3],
    /// The minimum length of a segment in a credited cell, in cells.
    margin: f32,
}

/// The numbering and the scale of the cells of a grid.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// The binary logarithms of a brick's sides.
    pub side: [u32; 3],
    /// The number of bricks along each axis.
    pub bricks: [u32; 3],
    /// The mask of the first cells of a brick along an axis, by axis.
    pub first: [u64; 3],
    /// The number of cells per scene unit.
    pub per_unit: [f32; 3],
}

/// The place of a cell's bit in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// The index of the word in the row.
    pub word: u32,
    /// The number of the bit in the word.
    pub bit: u32,
}

impl Slot {
    /// Returns the index of the bit among all bits of a row.
    pub fn index(self) -> usize {
        self.word as usize * 64 + self.bit as usize
    }
}

/// The cells that a segment crosses: words and the bits in them.
pub type Crossed = Vec<(u32, u64)>;

impl CellGrid {
    /// Creates a block with `cells` cells along each axis between two corners.
    pub fn new(min: Vec3, max: Vec3, cells: [u32; 3]) -> Self {
        let per_unit = [0, 1, 2].map(|a| cells[a] as f32 / (max[a] - min[a]));
        // If coordinates are coarse, rounding moves the ends of a segment by more than this fraction of a
        // cell.
        let largest = min.abs().max(max.abs()).max_element();
        let finest = per_unit.into_iter().fold(0.0, f32::max);
        let margin = MARGIN.max(largest * f32::EPSILON * ROUNDING * finest);
        let side = brick(cells);
        let bricks = [0, 1, 2].map(|a| cells[a].div_ceil(1 << side[a]));
        let coordinate =
            |bit: u32, a: usize| bit >> side[..a].iter().sum::<u32>() & ((1 << side[a]) - 1);
        let first = [0, 1, 2].map(|a| {
            (0..64)
                .filter(|bit| coordinate(*bit, a) == 0)
                .fold(0, |m, b| m | 1 << b)
        });
        debug_assert!(
            bricks.iter().map(|b| u64::from(*b)).product::<u64>() <= 1 << 26,
            "bits are numbered in 32 bits"
        );
        let mut grid = Self {
            cells,
            side,
            bricks,
            first,
            part: Default::default(),
            min,
            max,
            per_unit,
            margin,
        };
        grid.part = [0, 1, 2].map(|a| {
            let on_axis = |x: u32| std::array::from_fn(|b| if a == b { x } else { 0 });
            (0..cells[a])
                .map(|x| grid.slot(on_axis(x)).index() as u32)
                .collect()
        });
        grid
    }

    /// Returns the number of cells along each axis.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    /// Returns the minimum length of a segment in a credited cell, in cells.
    pub fn margin(&self) -> f32 {
        self.margin
    }

    /// Returns the numbering and the scale of the cells, for traversals outside this type.
    pub fn shape(&self) -> Shape {
        Shape {
            side: self.side,
            bricks: self.bricks,
            first: self.first,
            per_unit: self.per_unit,
        }
    }

    /// Returns the number of cells.
    pub fn count(&self) -> usize {
        self.cells.iter().map(|c| *c as usize).product()
    }

    /// Returns the number of words of a row.
    pub fn words(&self) -> usize {
        self.bricks.iter().map(|c| *c as usize).product()
    }

    /// Returns the minimum and maximum corners of the block.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        (self.min, self.max)
    }

    /// Returns the cells in order, x fastest, then y, then z.
    pub fn each(&self) -> impl Iterator<Item = [u32; 3]> + use<> {
        let [nx, ny, nz] = self.cells;
        (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
    }

    /// Returns the minimum corner and the size of a cell.
    pub fn cell_box(&self, c: [u32; 3]) -> (Vec3, Vec3) {
        let vec = |c: [u32; 3]| Vec3::from(c.map(|x| x as f32));
        let size = (self.max - self.min) / vec(self.cells);
        (self.min + size * vec(c), size)
    }

    /// Returns the cell of a point within the bounds.
    pub fn cell_at(&self, point: Vec3) -> [u32; 3] {
        let at = (point - self.min).to_array();
        [0, 1, 2].map(|a| ((at[a] * self.per_unit[a]) as u32).min(self.cells[a] - 1))
    }

    /// Returns the place of a cell's bit.
    pub fn slot(&self, c: [u32; 3]) -> Slot {
        let ([sx, sy, sz], [bx, by, _]) = (self.side, self.bricks);
        let [x, y, z] = c;
        let within = |x: u32, side: u32| x & ((1 << side) - 1);
        Slot {
            word: ((z >> sz) * by + (y >> sy)) * bx + (x >> sx),
            bit: (within(z, sz) << sy | within(y, sy)) << sx | within(x, sx),
        }
    }

    /// Returns the cell whose bit is in a place. Places that no cell has give coordinates outside the block.
    pub fn cell_in(&self, slot: Slot) -> [u32; 3] {
        let ([sx, sy, sz], [bx, by, _]) = (self.side, self.bricks);
        let within = |from: u32, side: u32| slot.bit >> from & ((1 << side) - 1);
        [
            (slot.word % bx) << sx | within(0, sx),
            (slot.word / bx % by) << sy | within(sx, sy),
            (slot.word / bx / by) << sz | within(sx + sy, sz),
        ]
    }

    /// Returns true if the block contains a cell with these coordinates.
    pub fn has(&self, c: [u32; 3]) -> bool {
        (0..3).all(|a| c[a] < self.cells[a])
    }

    /// Finds the cells that a segment crosses, in order (Amanatides and Woo 1987).
    ///
    /// The segment is the part of the line through `origin` along `direction` between the distances `t0` and
    /// `t1`. Distances are in lengths of `direction` and may be infinite.
    pub fn walk(
        &self,
        origin: [f32; 3],
        direction: [f32; 3],
        mut t0: f32,
        mut t1: f32,
        out: &mut Crossed,
    ) {
        out.clear();
        let (mut start, mut d, mut inverse) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3]);
        for a in 0..3 {
            start[a] = (origin[a] - self.min[a]) * self.per_unit[a];
            d[a] = direction[a] * self.per_unit[a];
            inverse[a] = 1.0 / d[a];
            let n = self.cells[a] as f32;
            if d[a] == 0.0 {
                if !(0.0..=n).contains(&start[a]) {
                    return;
                }
            } else {
                let (u, v) = (-start[a] * inverse[a], (n - start[a]) * inverse[a]);
                t0 = t0.max(u.min(v));
                t1 = t1.min(u.max(v));
            }
        }
        // If a coordinate is NaN, no cell is credited.
        if t0.partial_cmp(&t1) != Some(std::cmp::Ordering::Less) {
            return;
        }
        let least = self.margin / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let (mut cell, mut step) = ([0i32; 3], [0i32; 3]);
        let (mut next, mut delta) = ([f32::INFINITY; 3], [0.0f32; 3]);
        for a in 0..3 {
            cell[a] = ((start[a] + d[a] * t0) as i32).clamp(0, self.cells[a] as i32 - 1);
            if d[a] != 0.0 {
                let up = d[a] > 0.0;
                step[a] = if up { 1 } else { -1 };
                delta[a] = inverse[a].abs();
                next[a] = ((cell[a] + i32::from(up)) as f32 - start[a]) * inverse[a];
            }
        }
        // Comparisons with NaN are false. NaN arises if a direction is almost parallel to a plane and begins
        // on it. The loop then advances along some axis, and still ends where the line leaves the block.
        //
        // All state is in registers. The next axis is unpredictable, so its selection has no branch.
        let ([mut nx, mut ny, mut nz], [dx, dy, dz]) = (next, delta);
        let ([mut cx, mut cy, mut cz], [sx, sy, sz]) = (cell, step);
        let [px, py, pz] = &self.part;
        let (mut t, mut word, mut bits) = (t0, u32::MAX, 0u64);
        while let (Some(x), Some(y), Some(z)) = (
            px.get(cx as u32 as usize),
            py.get(cy as u32 as usize),
            pz.get(cz as u32 as usize),
        ) {
            let first = if nx < ny { nx } else { ny };
            let is_z = first >= nz;
            let is_x = !is_z & (nx < ny);
            let is_y = !is_z & !is_x;
            let through = if is_z { nz } else { first };
            let end = if t1 < through { t1 } else { through };
            if end - t > least {
                let at = x + y + z;
                if at >> 6 != word {
                    if bits != 0 {
                        out.push((word, bits));
                    }
                    (word, bits) = (at >> 6, 0);
                }
                bits |= 1 << (at & 63);
            }
            if through >= t1 {
                break;
            }
            t = if end > t { end } else { t };
            nx += if is_x { dx } else { 0.0 };
            ny += if is_y { dy } else { 0.0 };
            nz += if is_z { dz } else { 0.0 };
            cx += sx & -i32::from(is_x);
            cy += sy & -i32::from(is_y);
            cz += sz & -i32::from(is_z);
        }
        if bits != 0 {
            out.push((word, bits));
        }
    }

    /// Returns word `at` of the union of the cells in `row` and their face neighbours. Bits outside the block
    /// may also be set.
    pub fn dilated(&self, row: &[u64], at: usize) -> u64 {
        let [bx, by, bz] = self.bricks.map(|b| b as usize);
        let step = [1, bx, bx * by];
        let count = [bx, by, bz];
        let places = [at % bx, at / bx % by, at / (bx * by)];
        let m = row[at];
        let mut near = m;
        // The distance between the bits of two neighbours along the axis.
        let mut apart = 0;
        for (a, place) in places.into_iter().enumerate() {
            let first = self.first[a];
            let near_by = 1u32 << apart;
            // From the last layer of a brick to the first layer of the next brick.
            let across = near_by * ((1 << self.side[a]) - 1);
            // The neighbours of a brick with one layer are all in other bricks.
            near |= m.checked_shl(near_by).unwrap_or(0) & !first;
            near |= (m & !first).checked_shr(near_by).unwrap_or(0);
            if place > 0 {
                near |= row[at - step[a]] >> across & first;
            }
            if place + 1 < count[a] {
                near |= (row[at + step[a]] & first) << across;
            }
            apart += self.side[a];
        }
        near
    }
}

/// Returns the binary logarithms of the brick sides that cover a block with the fewest words. Among these,
/// the sides that differ least are selected.
fn brick(cells: [u32; 3]) -> [u32; 3] {
    let all = (0..=BITS).flat_map(|x| (0..=BITS - x).map(move |y| [x, y, BITS - x - y]));
    let words = |side: &[u32; 3]| -> u64 {
        (0..3)
            .map(|a| u64::from(cells[a].div_ceil(1 << side[a])))
            .product()
    };
    let uneven = |side: &[u32; 3]| side.iter().map(|s| s * s).sum::<u32>();
    all.min_by_key(|side| (words(side), uneven(side), *side))
        .unwrap_or([2; 3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid(cells: [u32; 3]) -> CellGrid {
        CellGrid::new(Vec3::new(-1.0, 2.0, 0.5), Vec3::new(3.0, 5.0, 9.5), cells)
    }

    #[test]
    fn dilation_reaches_exactly_the_six_neighbours() {
        for g in [
            [9, 5, 6],
            [20, 1, 7],
            [1, 1, 70],
            [1, 65, 2],
            [3, 2, 1],
            [16, 9, 2],
        ]
        .map(grid)
        {
            for c in g.each() {
                let mut row = vec![0; g.words()];
                let slot = g.slot(c);
                row[slot.word as usize] |= 1 << slot.bit;
                let near: Vec<u64> = (0..g.words()).map(|at| g.dilated(&row, at)).collect();
                for d in g.each() {
                    let apart: u32 = (0..3).map(|a| c[a].abs_diff(d[a])).sum();
                    let s = g.slot(d);
                    assert_eq!(
                        near[s.word as usize] >> s.bit & 1 == 1,
                        apart <= 1,
                        "{c:?} {d:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn bricks_are_as_flat_as_the_block() {
        for (cells, words) in [
            ([8, 8, 8], 8),
            ([20, 1, 20], 9),
            ([4, 4, 4], 1),
            ([64, 1, 1], 1),
            ([1, 1, 512], 8),
        ] {
            let g = grid(cells);
            assert_eq!(g.words(), words, "{cells:?} in bricks of {:?}", g.side);
            let slots: std::collections::BTreeSet<usize> =
                g.each().map(|c| g.slot(c).index()).collect();
            assert_eq!(slots.len(), g.count());
            assert!(g.each().all(|c| g.cell_in(g.slot(c)) == c));
        }
    }

    /// Traverses cells with one branch per step (Amanatides and Woo 1987). [`CellGrid::walk`] must equal it
    /// bit for bit.
    fn plain_walk(g: &CellGrid, o: [f32; 3], dir: [f32; 3], mut t0: f32, mut t1: f32) -> Crossed {
        let mut out = Crossed::new();
        let start: [f32; 3] = std::array::from_fn(|a| (o[a] - g.min[a]) * g.per_unit[a]);
        let d: [f32; 3] = std::array::from_fn(|a| dir[a] * g.per_unit[a]);
        for a in 0..3 {
            let n = g.cells[a] as f32;
            if d[a] == 0.0 {
                if !(0.0..=n).contains(&start[a]) {
                    return out;
                }
                continue;
            }
            let (u, v) = (-start[a] * (1.0 / d[a]), (n - start[a]) * (1.0 / d[a]));
            (t0, t1) = (t0.max(u.min(v)), t1.min(u.max(v)));
        }
        let least = g.margin / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let mut cell: [i32; 3] = std::array::from_fn(|a| {
            ((start[a] + d[a] * t0) as i32).clamp(0, g.cells[a] as i32 - 1)
        });
        let mut next: [f32; 3] = std::array::from_fn(|a| match d[a] {
            0.0 => f32::INFINITY,
            d => ((cell[a] + i32::from(d > 0.0)) as f32 - start[a]) * (1.0 / d),
        });
        let mut t = t0;
        while t0 < t1 && (0..3).all(|a| (0..g.cells[a] as i32).contains(&cell[a])) {
            let axis = match (next[0] < next[1], next[0] < next[2], next[1] < next[2]) {
                (true, true, _) => 0,
                (false, _, true) => 1,
                _ => 2,
            };
            let end = next[axis].min(t1);
            if end - t > least {
                let slot = g.slot(cell.map(|c| c as u32));
                match out.last_mut().filter(|(word, _)| *word == slot.word) {
                    Some((_, bits)) => *bits |= 1 << slot.bit,
                    None => out.push((slot.word, 1 << slot.bit)),
                }
            }
            if next[axis] >= t1 {
                break;
            }
            t = end.max(t);
            cell[axis] += if d[axis] > 0.0 { 1 } else { -1 };
            next[axis] += (1.0 / d[axis]).abs();
        }
        out
    }

    proptest! {
        #[test]
        fn walk_equals_plain_walk_to_the_bit(
            cells in prop_oneof![[1u32..10, 1u32..10, 1u32..10], [1u32..30, 1u32..3, 1u32..30]],
            o in [-3f32..6.0, 0f32..7.0, -2f32..12.0],
            d in [-1f32..1.0, -1f32..1.0, -1f32..1.0],
            // Directions along axes and diagonals, from places on planes, cause ties.
            coarse in any::<[bool; 2]>(),
            ends in prop_oneof![[-8f32..8.0, -8f32..8.0], Just([f32::NEG_INFINITY, f32::INFINITY])],
        ) {
            let g = grid(cells);
            let o = if coarse[0] { o.map(f32::round) } else { o };
            let d = if coarse[1] { d.map(|x| (2.0 * x).round()) } else { d };
            let mut crossed = Crossed::new();
            g.walk(o, d, ends[0], ends[1], &mut crossed);
            prop_assert_eq!(crossed, plain_walk(&g, o, d, ends[0], ends[1]));
        }

        /// Compares with clipping the line to the box of every cell in double precision.
        #[test]
        fn walk_credits_exactly_the_crossed_cells(
            cells in prop_oneof![[1u32..10, 1u32..10, 1u32..10], [1u32..30, 1u32..3, 1u32..30]],
            o in [-3f32..6.0, 0f32..7.0, -2f32..12.0],
            d in [-1f32..1.0, -1f32..1.0, -1f32..1.0],
            flat in 0usize..8,
            ends in [0f32..8.0, 0f32..8.0],
            sky in any::<[bool; 2]>(),
        ) {
            let g = grid(cells);
            let zero = |a: usize| flat >> a & 1 == 1 && flat != 7;
            let d: [f32; 3] = std::array::from_fn(|a| if zero(a) { 0.0 } else { d[a] });
            prop_assume!(d.iter().any(|x| x.abs() > 1e-3));
            let t0 = if sky[0] { f32::NEG_INFINITY } else { -ends[0] };
            let t1 = if sky[1] { f32::INFINITY } else { ends[1] };
            let mut crossed = Crossed::new();
            g.walk(o, d, t0, t1, &mut crossed);
            let length = (0..3).map(|a| f64::from(d[a] * g.per_unit[a]).powi(2)).sum::<f64>().sqrt();
            for c in g.each() {
                let (mut a, mut b) = (f64::from(t0), f64::from(t1));
                for k in 0..3 {
                    let size = f64::from(g.max[k] - g.min[k]) / f64::from(cells[k]);
                    let lo = f64::from(g.min[k]) + size * f64::from(c[k]);
                    if d[k] == 0.0 {
                        if !(lo..=lo + size).contains(&f64::from(o[k])) { b = f64::NEG_INFINITY; }
                        continue;
                    }
                    let (from, along) = (f64::from(o[k]), f64::from(d[k]));
                    let (u, v) = ((lo - from) / along, (lo + size - from) / along);
                    a = a.max(u.min(v));
                    b = b.min(u.max(v));
                }
                let inside = (b - a) * length;
                let s = g.slot(c);
                let credited = crossed.iter().any(|(w, bits)| *w == s.word && bits >> s.bit & 1 == 1);
                // Between half and twice the margin both results are correct.
                if inside > 2.0 / 1024.0 { prop_assert!(credited, "{c:?} {inside}"); }
                if inside < 0.5 / 1024.0 { prop_assert!(!credited, "{c:?} {inside}"); }
            }
        }
    }
}
