//! The newly found triangles that guided rays still have to follow, and the bits that the rays added.

use std::collections::VecDeque;

use glam::Vec3;
use rustc_hash::FxHashMap;
use sightline_trace::lines::grid::Slot;

/// Maximum number of attempts at the neighbours of a newly found triangle.
const TRIES: usize = 8;
/// Maximum number of words of cells that a new triangle remembers.
const WORDS: usize = 6;

/// The distance of a line's start from the surface behind it, as a fraction of the segment.
const LIFT: f32 = 1e-4;
/// The minimum of this distance, as a fraction of the largest coordinate: sixteen units in the last place.
const ROUNDING: f32 = 16.0 * f32::EPSILON;

/// The cells that a segment crosses.
#[derive(Clone, Copy, Debug)]
pub(super) struct FoundCells {
    /// Words of a row, and bits. Words without bits are unused.
    words: [(u32, u64); WORDS],
    /// The first cell that had not seen the triangle.
    new: Slot,
}

/// The free part of a line: its start and end, in lengths of the direction.
pub(super) struct FreeSegment {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    pub(super) from: f32,
    pub(super) to: f32,
}

/// A triangle that a segment newly showed to some cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct NewTriangle {
    pub(super) triangle: u32,
    /// The point at which the segment meets the triangle.
    pub(super) hit: Vec3,
    /// The other end of the segment, within the block if the segment is unbounded there.
    pub(super) other: Vec3,
    pub(super) cells: FoundCells,
    /// True if shifts follow.
    pub(super) shifts: bool,
}

impl NewTriangle {
    /// Creates the triangle at an end of a segment: the end along the direction if `is_ahead` is true,
    /// otherwise the end against it. `bounds` are the corners of the block.
    pub(super) fn new(
        segment: &FreeSegment,
        is_ahead: bool,
        triangle: u32,
        bounds: [Vec3; 2],
        cells: FoundCells,
    ) -> Self {
        let FreeSegment {
            origin,
            direction,
            from,
            to,
        } = *segment;
        let (hit, other) = if is_ahead { (to, from) } else { (from, to) };
        let hit = origin + direction * hit;
        let other = match other.is_finite() {
            true => origin + direction * other,
            false => leaves(origin, direction * other.signum(), bounds),
        };
        Self {
            triangle,
            hit,
            other,
            cells,
            shifts: false,
        }
    }

    /// Returns the cells that the segment crosses: words of a row, and bits.
    pub(super) fn cells(&self) -> &[(u32, u64)] {
        let used = self.cells.words.iter().position(|(_, bits)| *bits == 0);
        &self.cells.words[..used.unwrap_or(WORDS)]
    }

    /// Returns the first cell that had not seen the triangle.
    pub(super) fn new_cell(&self) -> Slot {
        self.cells.new
    }

    /// Returns the first place of the segment that is distinct from the surface at its other end, or `None`
    /// if the segment is so short that rounding could move the place beyond an end.
    pub(super) fn start(&self) -> Option<Vec3> {
        let segment = self.hit - self.other;
        let rounding = ROUNDING * self.other.abs().max_element();
        let lift = LIFT.max(rounding / segment.length());
        (lift < 0.25).then_some(self.other + segment * lift)
    }

    /// Returns the point at a fraction of the part of the segment in a box. If rounding leaves no such part,
    /// the point is on the segment.
    pub(super) fn point_in(&self, lo: Vec3, size: Vec3, fraction: f32) -> Vec3 {
        let segment = self.hit - self.other;
        let (mut from, mut to) = (0f32, 1f32);
        for axis in 0..3 {
            if segment[axis] != 0.0 {
                let near = (lo[axis] - self.other[axis]) / segment[axis];
                let far = (lo[axis] + size[axis] - self.other[axis]) / segment[axis];
                from = from.max(near.min(far));
                to = to.min(near.max(far));
            }
        }
        self.other + segment * (from + (to - from) * fraction).clamp(0.0, 1.0)
    }
}

/// Returns the point at which a ray from within a box leaves the box.
fn leaves(origin: Vec3, direction: Vec3, [lo, hi]: [Vec3; 2]) -> Vec3 {
    let mut to = f32::INFINITY;
    for axis in 0..3 {
        if direction[axis] != 0.0 {
            let side = if direction[axis] > 0.0 { hi } else { lo };
            to = to.min((side[axis] - origin[axis]) / direction[axis]);
        }
    }
    origin + direction * to.max(0.0)
}

/// The newly found triangles that rays still have to follow.
#[derive(Default)]
pub(super) struct Frontier {
    /// The triangles by the number of attempts.
    queues: [VecDeque<NewTriangle>; TRIES],
    /// The bits that the rays added to the table since the last barrier, by row and word.
    added: FxHashMap<u64, u64>,
}

fn key(row: u32, word: u32) -> u64 {
    u64::from(row) << 32 | u64::from(word)
}

impl Frontier {
    /// Forgets the added bits at a barrier.
    pub(super) fn forget_added(&mut self) {
        self.added.clear();
    }

    /// Returns true if no triangle waits.
    pub(super) fn is_empty(&self) -> bool {
        self.queues.iter().all(VecDeque::is_empty)
    }

    /// Adds a triangle that has had `tries` attempts, unless these are the maximum number.
    pub(super) fn queue(&mut self, tries: usize, new: NewTriangle) {
        if let Some(queue) = self.queues.get_mut(tries) {
            queue.push_back(new);
        }
    }

    /// Removes the first triangle with the fewest attempts, and returns it with their number.
    pub(super) fn pop(&mut self) -> Option<(usize, NewTriangle)> {
        let mut queues = self.queues.iter_mut().enumerate();
        queues.find_map(|(tries, queue)| Some((tries, queue.pop_front()?)))
    }

    /// Returns which of `bits` are neither in the row `seen` nor added since the last barrier.
    pub(super) fn new_bits(&self, seen: &[u64], row: u32, word: u32, bits: u64) -> u64 {
        let new = bits & !seen[word as usize];
        match new {
            0 => 0,
            _ => new & !self.added.get(&key(row, word)).copied().unwrap_or(0),
        }
    }

    /// Adds crossed cells to a row. Returns the cells if one of them is new.
    pub(super) fn add(
        &mut self,
        seen: &[u64],
        row: u32,
        crossed: &[(u32, u64)],
    ) -> Option<FoundCells> {
        let mut first = None;
        for (word, bits) in crossed {
            let bits = bits & !seen[*word as usize];
            if bits == 0 {
                continue;
            }
            let added = self.added.entry(key(row, *word)).or_default();
            let new = bits & !*added;
            *added |= new;
            if new != 0 && first.is_none() {
                first = Some(Slot {
                    word: *word,
                    bit: new.trailing_zeros(),
                });
            }
        }
        let mut words = [(0, 0); WORDS];
        // A word without bits has only cells without viewpoints.
        let crossed = crossed.iter().filter(|(_, bits)| *bits != 0);
        words
            .iter_mut()
            .zip(crossed)
            .for_each(|(word, crossed)| *word = *crossed);
        Some(FoundCells { words, new: first? })
    }
}
