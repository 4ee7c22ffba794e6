//! A block of cells that share their sight lines: the cells, the table of the triangles each cell sees, and
//! the distribution of work over threads.
//!
//! The order in which lines are cast is in [`super::rounds`].

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Scene;

use super::bits::SeenBits;
use super::grid::{CellGrid, Crossed, Slot};
use super::yields::Yields;
use crate::context::{TileError, Watcher};
use crate::cube::SKY;
use crate::error::BackendError;
use crate::packet::Packet;
use crate::sight::{Passed, Sight};
use crate::surface::Surface;
use sightline_model::{CellStats, LineKind};

/// Work of an aimed ray in units of a uniform ray, which is traced in a packet: measured as 2 (wide tiles,
/// small scenes) to 4.5.
pub(super) const AIMED_WORK: u64 = 3;

/// Part of the block's size by which the two halves of a line overlap at least ([`Packet::reversed`]).
const LEAST_STEP: f32 = 1.0 / (1 << 24) as f32;

/// The inputs of a block's sampling.
pub struct Tools<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Facts about its triangles.
    pub surface: &'a Surface,
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
}

impl Cell {
    /// A point at fractions of its size.
    pub(super) fn point(&self, f: impl Into<Vec3>) -> [f32; 3] {
        (self.lo + self.size * f.into()).to_array()
    }
}

/// The scratch memory of a thread.
pub(super) struct Scratch {
    /// For each triangle the last tag under which it was met.
    pub(super) met: Vec<u32>,
    pub(super) tag: u32,
    pub(super) packets: Vec<Packet>,
    pub(super) behind: Vec<Packet>,
    /// The see-through triangles on the lines traced last.
    pub(super) passed: Passed,
    pub(super) crossed: Crossed,
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
    pub(super) seeded: bool,
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
    /// has.
    pub fn new(tools: Tools<'a>, grid: CellGrid, number: impl Fn([u32; 3]) -> u64) -> Self {
        let cells: Vec<Cell> = grid
            .each()
            .map(|at| {
                let (lo, size) = grid.cell_box(at);
                Cell { at, slot: grid.slot(at), lo, size, number: number(at) }
            })
            .collect();
        let (min, max) = grid.bounds();
        let step = (max - min).max_element() * LEAST_STEP;
        let bits = SeenBits::new(tools.scene.triangles().len(), grid.words());
        let stats = vec![CellStats::default(); cells.len()];
        Self {
            tools,
            grid,
            bits,
            cells,
            stats,
            seeded: false,
            // A try casts one ray in each of two opposite directions.
            yields: Yields::new(2 * AIMED_WORK),
            silent: false,
            told: 0,
            step,
            scratch: Mutex::default(),
        }
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
    ) -> [u32; 2] {
        let [ahead, behind] = halves.map(|k| &packets[k]);
        let ends = [ahead.triangle[lane], behind.triangle[lane]];
        let mut between = passed.on_both(halves, lane).peekable();
        if ends != [SKY; 2] || between.peek().is_some() {
            let (origin, direction) = ahead.ray(lane);
            let (from, to) = ahead.free(behind, lane, self.step);
            self.grid.walk(origin, direction, from, to, crossed);
            ends.into_iter().filter(|t| *t != SKY).for_each(|t| self.bits.credit(t, crossed));
            between.for_each(|t| self.bits.credit(t, crossed));
        }
        ends
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
            }
        }
        Ok(())
    }

    /// Lends a thread's scratch memory.
    pub(super) fn with_scratch<R>(&self, f: impl FnOnce(&mut Scratch) -> R) -> R {
        let taken = self.scratch.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut scratch = taken.unwrap_or_else(|| Scratch {
            met: vec![0; self.tools.scene.triangles().len()],
            tag: 0,
            packets: Vec::new(),
            behind: Vec::new(),
            passed: Passed::default(),
            crossed: Vec::new(),
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
