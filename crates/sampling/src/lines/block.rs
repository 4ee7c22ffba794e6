//! A block of cells sampled together: rounds of sight lines until every cell misses little enough.
//!
//! A round casts uniform lines from every cell still at work, floods from what they find, and then aims at candidates.
//! The fraction of a round's uniform rays that met something new estimates, without bias, how much the cell was missing
//! when the round began; the round itself leaves about half of that or less. A cell is done when what it is expected to
//! miss falls below the target, or for the hardest cells below more than that ([`Hard`]).

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Scene;

use super::bits::SeenBits;
use super::candidates::Candidate;
use super::grid::{CellGrid, Crossed, Slot};
use super::packet::{LineTracer, Packet};
use super::surface::Surface;
use super::yields::Yields;
use super::{CellStats, Kind};
use crate::backend::BackendError;
use crate::cube::SKY;
use crate::tile::{TileError, Watcher};

/// Uniform tiles of the first round along a cube face: 27 packet pairs, 864 rays; 12 where little accuracy is wanted.
const FIRST_TILES: u32 = 3;
const FIRST_COARSE: u32 = 2;
/// Targets above this are coarse.
const COARSE: f64 = 5e-3;
/// Most tiles along a face in a round: 1.6 million rays, of which one miss is well below the least target there is.
const MOST_TILES: u32 = 128;
/// Part of what a cell misses at a round's beginning that is still missing at its end, measured on scenes of every kind as
/// 0.4 to 0.65.
pub(super) const LEFT_AFTER_ROUND: f64 = 0.5;
/// The same for the first round, which begins with next to nothing and floods far: 0.01 to 0.06.
const LEFT_AFTER_FIRST: f64 = 0.1;
/// Misses a round should count for its estimate to be worth something.
const MISSES_WANTED: f64 = 1.0;
/// Growth of the least number of tiles along a face from round to round: where much is missing for long, few rays a round
/// would only repeat themselves.
const GROWTH: f64 = 1.25;
/// Candidates that would cover less than this part of what the cell misses are left.
const CANDIDATE_PART: f64 = 1e-4;
/// Rounds after which a cell is given up with what it has; a cell that needs more sees new triangles in every round.
const MOST_ROUNDS: u32 = 24;
/// A cell that has taken so many times the work of the average cell is allowed as many times the target as it exceeds
/// that: its error is one of many in the mean, and the time is better spent on those. See [`Hard`].
const HARD_FROM: f64 = 3.0;
/// Work of an aimed ray in uniform ones, which are in packets: measured as 2 (wide tiles, small scenes) to 4.5.
const AIMED_WORK: u64 = 3;
/// Seeds from all surfaces are worth their time below this target.
const SEEDS_BELOW: f64 = 3e-3;

/// Part of the block's size by which the two halves of a line overlap at least ([`Packet::reversed`]).
const LEAST_STEP: f32 = 1.0 / (1 << 24) as f32;

/// What a block's sampling is done with.
pub struct Tools<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Facts about its triangles.
    pub surface: &'a Surface,
    /// What traces.
    pub tracer: &'a dyn LineTracer,
    /// Seed of all choices.
    pub seed: u64,
    /// Told of progress; asked whether to go on.
    pub watcher: &'a dyn Watcher,
    /// When to stop with what there is.
    pub deadline: Option<Instant>,
}

/// What becomes of cells that need many times the work of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hard {
    /// They go on like any other.
    Alike,
    /// They are done earlier ([`HARD_FROM`]).
    Spared,
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

/// What a thread works with.
pub(super) struct Scratch {
    /// For each triangle the last tag under which it was met.
    pub(super) met: Vec<u32>,
    pub(super) tag: u32,
    pub(super) packets: Vec<Packet>,
    pub(super) behind: Vec<Packet>,
    pub(super) crossed: Crossed,
}

impl Scratch {
    /// Forgets what was met.
    pub(super) fn next_tag(&mut self) {
        self.tag = self.tag.wrapping_add(1);
        if self.tag == 0 {
            self.met.fill(0);
            self.tag = 1;
        }
    }
}

/// Cells and what is seen from them.
pub struct Block<'a> {
    pub(super) tools: Tools<'a>,
    pub(super) grid: CellGrid,
    pub(super) bits: SeenBits,
    pub(super) cells: Vec<Cell>,
    /// Beside `cells`.
    pub(super) stats: Vec<CellStats>,
    seeded: bool,
    /// What aiming at candidates brings.
    pub(super) yields: Yields,
    /// Whether sampling leaves it to others to say which cells are done.
    pub(super) silent: bool,
    /// Cells said to be done.
    told: usize,
    /// How far ahead of a line's origin its other half begins at least.
    pub(super) step: f32,
    scratch: Mutex<Vec<Scratch>>,
}

impl<'a> Block<'a> {
    /// A block with nothing seen. `number` gives each of its cells a number that no other cell of the job has.
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
            // A try is a ray each way.
            yields: Yields::new(2 * AIMED_WORK),
            silent: false,
            told: 0,
            step,
            scratch: Mutex::default(),
        }
    }

    /// The table of what is seen.
    pub fn bits(&self) -> &SeenBits {
        &self.bits
    }

    /// As [`Block::bits`], to put in what is known.
    pub fn bits_mut(&mut self) -> &mut SeenBits {
        &mut self.bits
    }

    /// The grid of its cells.
    pub fn grid(&self) -> &CellGrid {
        &self.grid
    }

    /// How each cell came to its set, in the order of [`CellGrid::each`].
    pub fn stats(&self) -> &[CellStats] {
        &self.stats
    }

    /// Samples the cells `wanted` (all when empty) until each is expected to miss at most `target`, a fraction of the
    /// sight lines from it, or as much more as `hard` grants it.
    ///
    /// # Errors
    /// [`TileError`] when it is cancelled or the tracer fails. Running out of time is no error.
    pub fn sample(&mut self, target: f64, wanted: &[usize], hard: Hard) -> Result<(), TileError> {
        let mut open: Vec<usize> =
            if wanted.is_empty() { (0..self.cells.len()).collect() } else { wanted.to_vec() };
        for cell in &open {
            (self.stats[*cell].unfinished, self.stats[*cell].spared) = (false, false);
        }
        for round in 0..MOST_ROUNDS {
            if open.is_empty() || self.late() {
                break;
            }
            let sizes: Vec<u32> = open.iter().map(|c| self.tiles_for(*c, target, round)).collect();
            let work: Vec<(usize, u32)> = open.iter().copied().zip(sizes).collect();
            self.each(&work, |block, scratch, (cell, tiles)| block.cubes(scratch, *cell, *tiles))?;
            self.bits.settle();
            if round == 1 && !self.seeded && target < SEEDS_BELOW {
                self.seeded = true;
                self.seeds()?;
                self.bits.settle();
            }
            if self.late() {
                break;
            }
            {
                // Where the first round is was good enough, aiming at candidates would be for nothing.
                let before = open.len();
                open.retain(|c| self.stats[*c].rounds > 1 || self.left(*c, LEFT_AFTER_FIRST) > target);
                self.count_done(before - open.len());
            }
            let least: Vec<f64> =
                open.iter().map(|c| (self.missing(*c) * CANDIDATE_PART).max(1e-12)).collect();
            self.plan_tries(&open);
            let lists = self.candidates(&open, &least);
            let work: Vec<(usize, Vec<Candidate>)> = open.iter().copied().zip(lists).collect();
            self.each(&work, |block, scratch, (cell, list)| block.aim(scratch, *cell, list, round))?;
            self.bits.settle();
            if self.late() {
                // Aiming was cut short, and with it what the rule below counts on.
                break;
            }
            let before = open.len();
            let average = self.work() / self.cells.len() as f64;
            let mut spared = Vec::new();
            open.retain(|c| {
                let granted = match hard {
                    Hard::Alike => 1.0,
                    Hard::Spared => (self.work_of(*c) / (average * HARD_FROM)).max(1.0),
                };
                let left = self.left(*c, LEFT_AFTER_ROUND);
                if left > target && left <= target * granted {
                    spared.push(*c);
                }
                left > target * granted
            });
            spared.into_iter().for_each(|c: usize| self.stats[c].spared = true);
            tracing::debug!("round {round}: {before} cells, {} left", open.len());
            self.count_done(before - open.len());
        }
        for cell in &open {
            self.stats[*cell].unfinished = true;
        }
        self.count_done(open.len());
        Ok(())
    }

    /// Plans how often the candidates of `open` are tried, by what its uniform rays and the last tries met.
    fn plan_tries(&mut self, open: &[usize]) {
        let sum = |of: fn(&CellStats) -> u64| open.iter().map(|c| of(&self.stats[*c])).sum::<u64>();
        let (misses, cast) = (sum(|s| s.last_misses), sum(|s| s.last_rays));
        let rays = sum(|s| s.rays[Kind::Uniform as usize]) as f64 / open.len().max(1) as f64;
        self.yields.plan(misses, cast, rays);
    }

    /// Says that so many more cells are done, unless something else decides that.
    pub(super) fn count_done(&mut self, cells: usize) {
        if !self.silent {
            self.tell_done(cells);
        }
    }

    /// Says that so many more cells are done, but never more than there are.
    pub(super) fn tell_done(&mut self, cells: usize) {
        let more = cells.min(self.cells.len() - self.told);
        self.told += more;
        (0..more).for_each(|_| self.tools.watcher.cell_done());
    }

    /// What the cell is expected to miss after a round that leaves `part` of what was missing.
    pub(super) fn left(&self, cell: usize, part: f64) -> f64 {
        let s = &self.stats[cell];
        // One miss more than was counted: none in a few rays is no proof of anything.
        part * (s.last_misses as f64 + 1.0) / s.last_rays.max(1) as f64
    }

    /// What the cell was missing when its last round began, as far as that round could tell.
    fn missing(&self, cell: usize) -> f64 {
        let s = &self.stats[cell];
        (s.last_misses as f64 + 0.5) / s.last_rays.max(1) as f64
    }

    /// Work a cell has taken, in uniform rays.
    fn work_of(&self, cell: usize) -> f64 {
        let [uniform, flood, candidate, _] = self.stats[cell].rays;
        (uniform + AIMED_WORK * (flood + candidate)) as f64
    }

    /// Work of all cells.
    fn work(&self) -> f64 {
        (0..self.cells.len()).map(|c| self.work_of(c)).sum()
    }

    /// Tiles along a cube face for a cell's next round: enough to see what is expected to be missing a few times.
    fn tiles_for(&self, cell: usize, target: f64, round: u32) -> u32 {
        let s = &self.stats[cell];
        if s.last_rays == 0 {
            return if target > COARSE { FIRST_COARSE } else { FIRST_TILES };
        }
        let expected = (self.missing(cell) * LEFT_AFTER_ROUND).max(target);
        let rays = MISSES_WANTED / expected;
        // 3·tiles² pairs of sixteen.
        let least = f64::from(FIRST_TILES) * GROWTH.powi(round as i32);
        ((rays / 96.0).sqrt().max(least).ceil() as u32).clamp(FIRST_TILES, MOST_TILES)
    }

    /// Shows both ends of a lane's line to every cell of its free part, whose other half `behind` is
    /// ([`Packet::reversed`]), and gives them; [`SKY`] where a half meets nothing.
    pub(super) fn credit_line(
        &self,
        ahead: &Packet,
        behind: &Packet,
        lane: usize,
        crossed: &mut Crossed,
    ) -> [u32; 2] {
        let ends = [ahead.triangle[lane], behind.triangle[lane]];
        if ends != [SKY; 2] {
            let (origin, direction) = ahead.ray(lane);
            let (from, to) = ahead.free(behind, lane, self.step);
            self.grid.walk(origin, direction, from, to, crossed);
            ends.into_iter().filter(|t| *t != SKY).for_each(|t| self.bits.credit(t, crossed));
        }
        ends
    }

    /// Whether the time is up.
    pub(super) fn late(&self) -> bool {
        self.tools.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Does `f` for each piece of work on some thread and adds what it counted to the cell's account.
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
            if s.rays[Kind::Uniform as usize] > 0 {
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
            crossed: Vec::new(),
        });
        let result = f(&mut scratch);
        self.scratch.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
        result
    }
}

/// Work on a cell of the block.
pub(super) trait HasCell {
    /// Its place in `Block::cells`.
    fn cell(&self) -> usize;
}

impl<T> HasCell for (usize, T) {
    fn cell(&self) -> usize {
        self.0
    }
}
