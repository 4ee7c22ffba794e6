//! Uniform lines that do nothing but join the cells they cross: from every cell for the samplers whose rays
//! are not shared, and for the sampler lines from the cells whose last round still joined many.
//!
//! A cell is finished when the lines that joined it with another cell for the first time are few: half of
//! their fraction is expected to remain after the round, as in [`super::rounds`].

use std::sync::atomic::Ordering::Relaxed;

use rayon::prelude::*;
use sightline_model::TilePairs;
use sightline_viewcells::Tile;

use super::block::{Block, Cell};
use super::grid::{CellGrid, Crossed};
use super::pairs::{Pairs, of_tile};
use super::rounds::LEFT_AFTER_ROUND;
use crate::context::{JobContext, TileError, Watcher};
use crate::cube::face_basis;
use crate::packet::{LANES, Packet};
use crate::sequence::{Hashed, spread3};
use crate::sight::{Passed, Sight};

/// Tiles of directions along a cube face in the first round, and their growth from round to round.
const FIRST_TILES: f64 = 4.0;
const GROWTH: f64 = 1.5;
/// Most rounds of a cell; the last one has tiles of 4×4 directions as many as the largest round of sampling.
const MOST_ROUNDS: u32 = 9;
/// Pairs of packets traced at a time.
const BATCH: u32 = 16;
/// Lines of a round that say something about its cell.
const LEAST_LINES: u64 = 200;
/// No cell is searched for a smaller fraction of new pairs.
const LEAST_TOLERANCE: f64 = 5e-5;
/// Name of the stream of random numbers.
const JOIN: u64 = 7;

/// The pairs of cells that lines from a tile join; `None` when the job does not ask. Also the number of rays.
///
/// # Errors
/// [`TileError`] when it is cancelled or the backend fails.
pub fn search(
    job: &JobContext<'_>,
    tile: &Tile,
    watcher: &dyn Watcher,
) -> Result<(Option<TilePairs>, u64), TileError> {
    let Some(sides) = job.pairs else { return Ok((None, 0)) };
    let sight = Sight::new(job.backend, job.scene.traced())?.up_to(job.params.far);
    let (min, max) = job.division.root(&job.lattice).world(&job.lattice);
    let pairs = Pairs::new(CellGrid::new(min, max, sides));
    let step = (max - min).max_element() * super::block::LEAST_STEP;
    let units = job.lattice.units();
    let inside = |at: [u32; 3]| {
        (0..3).all(|a| {
            let middle = (u64::from(at[a]) * 2 + 1) * u64::from(units[a]) / (2 * u64::from(sides[a]));
            (u64::from(tile.cell.lo[a])..u64::from(tile.cell.hi[a])).contains(&middle)
        })
    };
    let grid = pairs.grid();
    let cells = grid.each().enumerate().filter(|(_, at)| inside(*at)).map(|(number, at)| {
        let (lo, size) = grid.cell_box(at);
        let parts = job.viewpoints.map_or(u64::MAX, |marks| marks.of(number));
        Cell { at, slot: grid.slot(at), lo, size, number: number as u64, parts }
    });
    let open: Vec<(Cell, u64)> = cells.filter(|c| c.parts != 0).map(|cell| (cell, 0)).collect();
    let rays = rounds(job, (&sight, &pairs, step), open, watcher)?;
    Ok((of_tile(job, Some(&pairs)), rays))
}

/// Goes on joining the cells of a sampled block of which the last round of sampling still joined many for the
/// first time. Returns the number of rays.
///
/// # Errors
/// As [`search`].
pub fn finish(job: &JobContext<'_>, block: &Block<'_>, watcher: &dyn Watcher) -> Result<u64, TileError> {
    let Some(pairs) = &block.pairs else { return Ok(0) };
    let open = block.active().into_iter().filter_map(|cell| {
        let [new, lines] = [0, 1].map(|k| block.joins[cell][k].load(Relaxed));
        let enough = lines >= LEAST_LINES && LEFT_AFTER_ROUND * new as f64 <= tolerance(job) * lines as f64;
        let own = block.cells[cell];
        let slot = block.pair_slot(&own).filter(|_| !enough)?;
        Some((Cell { slot, ..own }, 0))
    });
    rounds(job, (block.tools.sight, pairs, block.step), open.collect(), watcher)
}

/// The fraction of a cell's lines that may join it with another cell for the first time after the last round.
fn tolerance(job: &JobContext<'_>) -> f64 {
    (0.5 * job.params.target_error).max(LEAST_TOLERANCE)
}

/// Casts lines from cells, each of which has cast some, until few of them join their cell with another one
/// for the first time. The slots of the cells are those in the grid of the pairs. Returns the number of rays.
fn rounds(
    job: &JobContext<'_>,
    (sight, pairs, step): (&Sight<'_>, &Pairs, f32),
    mut open: Vec<(Cell, u64)>,
    watcher: &dyn Watcher,
) -> Result<u64, TileError> {
    let mut rays = 0;
    for round in 0..MOST_ROUNDS {
        if open.is_empty() || job.is_late() {
            break;
        }
        let tiles = (FIRST_TILES * GROWTH.powi(round as i32)) as u32;
        let before = pairs.copy();
        let lines = Lines { sight, pairs, before: &before, step, seed: job.seed };
        let new: Vec<u64> = open
            .par_iter()
            .with_max_len(2)
            .map(|(cell, cast)| match watcher.cancelled() {
                true => Err(TileError::Cancelled),
                false => lines.from(cell, *cast, (round, tiles)),
            })
            .collect::<Result<_, TileError>>()?;
        let cast = u64::from(3 * tiles * tiles) * LANES as u64;
        rays += 2 * cast * open.len() as u64;
        watcher.rendered(2 * cast * open.len() as u64);
        let mut new = new.into_iter();
        open.retain_mut(|(_, before)| {
            *before += cast;
            LEFT_AFTER_ROUND * new.next().unwrap_or(0) as f64 / cast as f64 > tolerance(job)
        });
    }
    Ok(rays)
}

/// The inputs of a round.
struct Lines<'a> {
    sight: &'a Sight<'a>,
    pairs: &'a Pairs,
    /// The pairs before the round.
    before: &'a [u64],
    step: f32,
    seed: u64,
}

impl Lines<'_> {
    /// Casts 3 · tiles² · 16 lines from a cell that has cast `cast` lines; returns how many of them joined it
    /// with another cell for the first time.
    fn from(&self, cell: &Cell, cast: u64, (round, tiles): (u32, u32)) -> Result<u64, TileError> {
        let mut random = Hashed::new(&[self.seed, cell.number, u64::from(round), JOIN]);
        let shift = [random.unit(), random.unit(), random.unit()];
        let pixel = 2.0 / (4 * tiles) as f32;
        let total = 3 * tiles * tiles;
        let (mut packets, mut passed) = (Vec::new(), Passed::default());
        let (mut crossed, mut new) = (Crossed::new(), 0);
        for first in (0..total).step_by(BATCH as usize) {
            packets.clear();
            for k in first..(first + BATCH).min(total) {
                let (pair, tile) = (k / (tiles * tiles), k % (tiles * tiles));
                let origin = cell.point(spread3(cast / LANES as u64 + u64::from(k), shift));
                let [forward, right, up] = face_basis(pair * 2);
                let mut ahead = Packet::default();
                for lane in 0..LANES as u32 {
                    let x = ((tile % tiles * 4 + lane % 4) as f32 + random.unit()) * pixel - 1.0;
                    let y = ((tile / tiles * 4 + lane / 4) as f32 + random.unit()) * pixel - 1.0;
                    ahead.push(origin, (forward + right * x + up * y).to_array());
                }
                let behind = ahead.reversed(self.step);
                packets.push(ahead);
                packets.push(behind);
            }
            self.sight.trace(&mut packets, &mut passed, self.step)?;
            for both in packets.chunks_exact(2) {
                for lane in 0..LANES {
                    let (from, to) = both[0].free(&both[1], lane, self.step);
                    let ray = both[0].ray(lane);
                    let far = self.sight.far() / both[0].length(lane);
                    // As when sight lines are credited.
                    let in_halves = far < f32::INFINITY || self.sight.is_one_way();
                    let halves = match in_halves {
                        false => [(from, to); 2],
                        true => [(from.max(-far), to.min(0.0)), (from.max(0.0), to.min(far))],
                    };
                    let mut is_new = false;
                    for (from, to) in halves.into_iter().take(if in_halves { 2 } else { 1 }) {
                        self.pairs.join_line(ray, from, to, &mut crossed);
                        is_new |= self.pairs.is_new(self.before, cell.slot.index(), &crossed);
                    }
                    new += u64::from(is_new);
                }
            }
        }
        Ok(new)
    }
}
