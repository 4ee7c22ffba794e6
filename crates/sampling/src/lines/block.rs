//! A block of cells that share their sight lines: the cells, the table of the triangles each cell sees, and
//! the distribution of work over threads.
//!
//! The order in which lines are cast is in [`super::rounds`].

use std::sync::atomic::AtomicU64;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Scene;

use super::bits::SeenBits;
use super::grid::{CellGrid, Crossed, Slot};
use super::pairs::Pairs;
use super::yields::Yields;
use crate::context::{TileError, Watcher};
use crate::cube::SKY;
use crate::error::BackendError;
use crate::packet::Packet;
use crate::rows::Rows;
use crate::sight::{Passed, Sight};
use crate::surface::Surface;
use sightline_model::{CellStats, LineKind};
use sightline_viewcells::viewpoints::PARTS;

/// Work of an aimed ray in units of a uniform ray, which is traced in a packet: measured as 2 (wide tiles,
/// small scenes) to 4.5.
pub(super) const AIMED_WORK: u64 = 3;

/// One lane in this many joins the cells that its line crosses, in all rounds but a cell's first ones:
/// neighbouring lanes cross about the same cells, and joining takes longer than tracing where a line crosses
/// many. The first rounds are a small part of a long bake and all of a short one.
pub(super) const JOINED_LANES: usize = 4;

/// Part of the block's size by which the two halves of a line overlap at least ([`Packet::reversed`]).
pub(super) const LEAST_STEP: f32 = 1.0 / (1 << 24) as f32;

/// The inputs of a block's sampling.
pub struct Tools<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Facts about its triangles.
    pub surface: &'a Surface,
    /// The rows of the table: triangles, or other items.
    pub rows: &'a Rows,
    /// The tracer of the lines.
    pub sight: &'a Sight<'a>,
    /// Seed of all choices.
    pub seed: u64,
    /// Receives the progress and can cancel the work.
    pub watcher: &'a dyn Watcher,
    /// When sampling stops with the sets found by then.
    pub deadline: Option<Instant>,
}

/// A view cell of the block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) at: [u32; 3],
    pub(super) slot: Slot,
    /// Least corner and size.
    pub(super) lo: Vec3,
    pub(super) size: Vec3,
    /// Its number in the whole division, for its random numbers.
    pub(super) number: u64,
    /// Which of its parts hold viewpoints ([`sightline_viewcells::Viewpoints`]); all bits when all do.
    pub(super) parts: u64,
}

impl Cell {
    /// A viewpoint at fractions of its size. Where only some parts of the cell hold viewpoints, the first
    /// fraction chooses one of them as well, which keeps the points of a sequence evenly spread.
    pub(super) fn point(&self, f: impl Into<Vec3>) -> [f32; 3] {
        let mut f: Vec3 = f.into();
        if self.parts != u64::MAX {
            let place = f.x * self.parts.count_ones() as f32;
            let mut rest = self.parts;
            // Rounding may give the number of parts itself.
            for _ in 0..(place as u32).min(self.parts.count_ones().saturating_sub(1)) {
                rest &= rest - 1;
            }
            let part = rest.trailing_zeros();
            let at = Vec3::new(
                (part % PARTS) as f32,
                (part / PARTS % PARTS) as f32,
                (part / PARTS / PARTS) as f32,
            );
            f = (at + Vec3::new(place.fract(), f.y, f.z)) / PARTS as f32;
        }
        (self.lo + self.size * f).to_array()
    }

    /// Whether viewpoints are everywhere in it.
    pub(super) fn is_whole(&self) -> bool {
        self.parts == u64::MAX
    }
}

/// The scratch memory of a thread.
pub(super) struct Scratch {
    /// For each row of the table the last tag under which one of its triangles was met.
    pub(super) met: Vec<u32>,
    pub(super) tag: u32,
    pub(super) packets: Vec<Packet>,
    pub(super) behind: Vec<Packet>,
    /// The see-through triangles on the lines traced last.
    pub(super) passed: Passed,
    pub(super) crossed: Crossed,
    /// The cells of the whole division that a line crosses.
    pub(super) joined: Crossed,
}

impl Scratch {
    /// Forgets all marks of triangles.
    pub(super) fn next_tag(&mut self) {
        self.tag = self.tag.wrapping_add(1);
        if self.tag == 0 {
            self.met.fill(0);
            self.tag = 1;
        }
    }
}

/// The cells of a block and the triangles seen from each.
pub struct Block<'a> {
    pub(super) tools: Tools<'a>,
    pub(super) grid: CellGrid,
    pub(super) bits: SeenBits,
    pub(super) cells: Vec<Cell>,
    /// One for each of `cells`.
    pub(super) stats: Vec<CellStats>,
    /// The words of a row without the cells that have no viewpoint; empty when all have one.
    reached: Vec<u64>,
    /// Which cells see which; `None` when the job does not ask.
    pub(super) pairs: Option<Pairs>,
    /// The pairs before the lines that are being cast.
    pub(super) held: Vec<u64>,
    /// For each cell, of the joined lines of its last uniform round: those that joined it with another cell
    /// for the first time, and all.
    pub(super) joins: Vec<[AtomicU64; 2]>,
    /// Whether the block is the whole division.
    is_whole: bool,
    pub(super) seeded: bool,
    /// Uniform rays after which a cell is finished, whatever they met; `None` when the expected error
    /// decides.
    pub(super) enough: Option<u64>,
    /// The yields of aiming at candidates.
    pub(super) yields: Yields,
    /// Whether the caller of the sampling, not the sampling itself, reports finished cells.
    pub(super) silent: bool,
    /// Number of cells reported as finished.
    told: usize,
    /// Least distance between the origin of a line and the start of its other half, in world units.
    pub(super) step: f32,
    scratch: Mutex<Vec<Scratch>>,
}

impl<'a> Block<'a> {
    /// A block with nothing seen. `number` gives each of its cells a number that no other cell of the job
    /// has, and `parts` the parts of the cell that hold viewpoints. Pairs of cells are looked for over
    /// `division`, the grid of the whole division.
    pub fn new(
        tools: Tools<'a>,
        grid: CellGrid,
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
        division: Option<CellGrid>,
    ) -> Self {
        let cells: Vec<Cell> = grid
            .each()
            .map(|at| {
                let (lo, size) = grid.cell_box(at);
                Cell { at, slot: grid.slot(at), lo, size, number: number(at), parts: parts(at) }
            })
            .collect();
        let mut reached = Vec::new();
        if cells.iter().any(|c| c.parts == 0) {
            reached.resize(grid.words(), 0u64);
            let with = cells.iter().filter(|c| c.parts != 0);
            with.for_each(|c| reached[c.slot.word as usize] |= 1 << c.slot.bit);
        }
        let same = |d: &CellGrid| d.bounds() == grid.bounds() && d.cells() == grid.cells();
        let is_whole = division.as_ref().is_some_and(same);
        let (min, max) = grid.bounds();
        let step = (max - min).max_element() * LEAST_STEP;
        let bits = SeenBits::new(tools.rows.count(), grid.words());
        let count = cells.len();
        let stats = vec![CellStats::default(); count];
        Self {
            tools,
            grid,
            bits,
            cells,
            stats,
            reached,
            pairs: division.map(Pairs::new),
            held: Vec::new(),
            joins: std::iter::repeat_with(Default::default).take(count).collect(),
            is_whole,
            seeded: false,
            enough: None,
            // A try casts one ray in each of two opposite directions.
            yields: Yields::new(2 * AIMED_WORK),
            silent: false,
            told: 0,
            step,
            scratch: Mutex::default(),
        }
    }

    /// Finishes cells when they have cast so many uniform rays that an item with the share `share` of a
    /// cell's sight lines is met with a probability of 95 %: the chance that n independent rays all miss it
    /// is (1 − share)ⁿ.
    pub fn search_for_share(&mut self, share: f64) {
        const MISSED: f64 = 0.05;
        self.enough = Some((MISSED.ln() / (-share).ln_1p()).ceil() as u64);
    }

    /// The table of the triangles seen from each cell.
    pub fn bits(&self) -> &SeenBits {
        &self.bits
    }

    /// As [`Block::bits`], for writing.
    pub fn bits_mut(&mut self) -> &mut SeenBits {
        &mut self.bits
    }

    /// The grid of its cells.
    pub fn grid(&self) -> &CellGrid {
        &self.grid
    }

    /// Which cells see which; `None` when the job does not ask.
    pub fn pairs(&self) -> Option<&Pairs> {
        self.pairs.as_ref()
    }

    /// Whether a viewpoint is in a cell, by its place in [`CellGrid::each`].
    pub fn is_reached(&self, cell: usize) -> bool {
        self.cells[cell].parts != 0
    }

    /// The cells with viewpoints, by their places in [`CellGrid::each`].
    pub(super) fn active(&self) -> Vec<usize> {
        (0..self.cells.len()).filter(|c| self.is_reached(*c)).collect()
    }

    /// The row of a triangle.
    pub(super) fn row(&self, triangle: u32) -> u32 {
        self.tools.rows.of(triangle)
    }

    /// Whether a triangle's item was seen from a cell at the last barrier.
    pub(super) fn seen(&self, triangle: u32, slot: Slot) -> bool {
        self.bits.seen(self.row(triangle), slot)
    }

    /// Credits cells with a triangle's item; those without viewpoints must have been taken out.
    pub(super) fn credit(&self, triangle: u32, crossed: &[(u32, u64)]) {
        self.bits.credit(self.row(triangle), crossed);
    }

    /// Credits a cell, if it has viewpoints, with a triangle's item.
    pub(super) fn credit_one(&self, triangle: u32, slot: Slot) {
        if self.reached.is_empty() || self.reached[slot.word as usize] >> slot.bit & 1 == 1 {
            self.credit(triangle, &[(slot.word, 1 << slot.bit)]);
        }
    }

    /// Takes out of the crossed cells those without viewpoints.
    pub(super) fn only_reached(&self, crossed: &mut Crossed) {
        if !self.reached.is_empty() {
            crossed.iter_mut().for_each(|(word, bits)| *bits &= self.reached[*word as usize]);
        }
    }

    /// The statistics of each cell, in the order of [`CellGrid::each`].
    pub fn stats(&self) -> &[CellStats] {
        &self.stats
    }

    /// Reports `n` more finished cells, unless the caller of the sampling reports them.
    pub(super) fn count_done(&mut self, cells: usize) {
        if !self.silent {
            self.tell_done(cells);
        }
    }

    /// Reports `n` more finished cells, but never more than the block has.
    pub(super) fn tell_done(&mut self, cells: usize) {
        let more = cells.min(self.cells.len() - self.told);
        self.told += more;
        (0..more).for_each(|_| self.tools.watcher.cell_done());
    }

    /// Credits every cell that the free part of a lane's line crosses with the triangles on it: those at both
    /// ends, and the see-through ones in between. Returns those at the ends; [`SKY`] where a half of the line
    /// meets nothing that shows. `packets` holds both halves ([`Packet::reversed`]), at the places `ahead`
    /// and `behind`, and `passed` the see-through triangles on them.
    pub(super) fn credit_line(
        &self,
        packets: &[Packet],
        passed: &Passed,
        halves: [usize; 2],
        lane: usize,
        crossed: &mut Crossed,
        (joined, one_in): (&mut Crossed, usize),
    ) -> [u32; 2] {
        let [ahead, behind] = halves.map(|k| &packets[k]);
        let ends = [ahead.triangle[lane], behind.triangle[lane]];
        let mut between = passed.on_both(halves, lane).peekable();
        let any = ends != [SKY; 2] || between.peek().is_some();
        let pairs = self.pairs.as_ref().filter(|_| lane.is_multiple_of(one_in));
        if !any && pairs.is_none() {
            return ends;
        }
        let (origin, direction) = ahead.ray(lane);
        let (from, to) = ahead.free(behind, lane, self.step);
        let far = self.tools.sight.far() / ahead.length(lane);
        let one_way = self.tools.sight.is_one_way();
        if far < f32::INFINITY || one_way {
            // Each triangle shows up to that distance on both sides of it, and cells that far apart do not
            // see each other. With triangles of one side, each half is free in its own direction alone: what
            // lies ahead is seen from the origin on, what lies behind from the origin back, and a triangle
            // that is passed is not seen from beyond it.
            let half = ahead.advance(lane, self.step);
            let on = [(ends[0], to, true), (ends[1], from, false)].into_iter();
            let on = on.chain(passed.on_at(halves[0], lane).map(|(t, d)| (t, d, true)));
            let on = on.chain(passed.on_at(halves[1], lane).map(|(t, d)| (t, half - d, false)));
            for (triangle, at, is_ahead) in on.filter(|(t, ..)| *t != SKY) {
                let (least, most) = match (one_way, is_ahead) {
                    (false, _) => (from, to),
                    (true, true) => (from.max(0.0), at),
                    (true, false) => (at, to.min(0.0)),
                };
                self.grid.walk(origin, direction, least.max(at - far), most.min(at + far), crossed);
                self.only_reached(crossed);
                self.credit(triangle, crossed);
            }
            if let Some(pairs) = pairs {
                for (from, to) in [(from.max(-far), to.min(0.0)), (from.max(0.0), to.min(far))] {
                    pairs.join_line((origin, direction), from, to, joined);
                }
            }
            return ends;
        }
        self.grid.walk(origin, direction, from, to, crossed);
        if let Some(pairs) = pairs {
            joined.clear();
            match self.is_whole {
                true => {
                    pairs.join(crossed);
                    joined.extend_from_slice(crossed);
                }
                false => pairs.join_line((origin, direction), from, to, joined),
            }
        }
        if any {
            self.only_reached(crossed);
            ends.into_iter().filter(|t| *t != SKY).for_each(|t| self.credit(t, crossed));
            between.for_each(|t| self.credit(t, crossed));
        }
        ends
    }

    /// The slot of one of its cells in the grid of the pairs; `None` when the job does not ask for pairs.
    pub(super) fn pair_slot(&self, cell: &Cell) -> Option<Slot> {
        let grid = self.pairs.as_ref()?.grid();
        let at = grid.cell_at(cell.lo + cell.size * 0.5);
        Some(grid.slot(at))
    }

    /// Whether the time is up.
    pub(super) fn late(&self) -> bool {
        self.tools.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Calls `f` for each piece of work on a thread of the pool and adds its counts to the cell's statistics.
    pub(super) fn each<W, F>(&mut self, work: &[W], f: F) -> Result<(), TileError>
    where
        W: Sync + HasCell,
        F: Fn(&Self, &mut Scratch, &W) -> Result<CellStats, BackendError> + Sync,
    {
        let this = &*self;
        let done: Vec<CellStats> = work
            .par_iter()
            .with_max_len(2)
            .map(|w| {
                if this.tools.watcher.cancelled() {
                    return Err(TileError::Cancelled);
                }
                if this.late() {
                    return Ok(CellStats::default());
                }
                let stats = this.with_scratch(|scratch| f(this, scratch, w))?;
                if this.tools.watcher.cancelled() {
                    return Err(TileError::Cancelled);
                }
                this.tools.watcher.rendered(stats.rays.iter().sum());
                Ok(stats)
            })
            .collect::<Result<_, TileError>>()?;
        for (w, s) in work.iter().zip(done) {
            let all = &mut self.stats[w.cell()];
            for k in 0..s.rays.len() {
                all.rays[k] += s.rays[k];
                all.finds[k] += s.finds[k];
            }
            if s.rays[LineKind::Uniform as usize] > 0 {
                all.rounds += 1;
                (all.last_rays, all.last_misses) = (s.last_rays, s.last_misses);
            }
            if s.bound_lines > 0 {
                (all.bound_lines, all.bound_misses, all.bound_look) =
                    (s.bound_lines, s.bound_misses, s.bound_look);
                all.bound_cell_misses = s.bound_cell_misses;
            }
        }
        Ok(())
    }

    /// Lends a thread's scratch memory.
    pub(super) fn with_scratch<R>(&self, f: impl FnOnce(&mut Scratch) -> R) -> R {
        let taken = self.scratch.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut scratch = taken.unwrap_or_else(|| Scratch {
            met: vec![0; self.tools.rows.count()],
            tag: 0,
            packets: Vec::new(),
            behind: Vec::new(),
            passed: Passed::default(),
            crossed: Vec::new(),
            joined: Vec::new(),
        });
        let result = f(&mut scratch);
        self.scratch.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
        result
    }
}

/// A piece of work on one cell of the block.
pub(super) trait HasCell {
    /// Its place in `Block::cells`.
    fn cell(&self) -> usize;
}

impl<T> HasCell for (usize, T) {
    fn cell(&self) -> usize {
        self.0
    }
}
