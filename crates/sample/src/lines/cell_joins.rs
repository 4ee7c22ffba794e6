//! The search for pairs of cells that see each other, by segments between random points of unjoined cells.
//!
//! A segment is free up to the first triangle that blocks it. It joins all cells that it crosses until then,
//! also beyond its target. The first two rounds cast at all open pairs. Later rounds cast at open pairs of
//! which a neighbour is joined, because most missed pairs have such a neighbour. Segments at random cells
//! estimate the number of pairs of points that see each other. Segments at open pairs that reach their target
//! estimate the fraction of these that the relation still misses. The search ends when this fraction is
//! small.
//!
//! Lines that search for triangles have already joined the cells that they cross. They find narrow openings,
//! but few of them lead from one end of a flat division to the other (`docs/experiments/cell-to-cell.md`).

use sightline_trace::lines::device::SegmentWork;
use sightline_trace::lines::grid::{CellGrid, Crossed};
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_viewcells::CellBox;

use super::block::{Block, LEAST_STEP};
use super::cell_table::Cell;
use super::phase::{self, Items, Tables};
use super::rounds::LEFT_AFTER_ROUND;
use crate::context::{JobContext, TileError, ViewRegion, Watcher};

/// Maximum number of segments from a cell per round. If more pairs are open, a part of them is drawn.
const MOST_SEGMENTS: usize = 512;
/// Minimum number of segments per round from all cells together. With fewer open pairs, several segments are
/// cast per pair.
const LEAST_SEGMENTS: usize = 1 << 16;
/// The number of segments from each cell at any later cell, which estimate the number of pairs of points that
/// see each other.
const FREE_SEGMENTS: usize = 32;
/// The number of rounds that cast at all open pairs.
const WHOLE_ROUNDS: u32 = 2;
/// Maximum number of rounds if the sampler lines has already joined cells.
pub const FEW_ROUNDS: u32 = 8;
/// Maximum number of rounds if no lines have joined cells: with the samplers guided and cubes.
pub const MANY_ROUNDS: u32 = 32;
/// The fraction of the free pairs of points that may be missed after the last round.
///
/// The search ends when at most this fraction is missed.
const TOLERANCE: f64 = 1e-4;
/// The names of the streams of random numbers.
const JOIN: u64 = 7;
const FREE: u64 = 12;

/// Creates an empty table for the pairs of a job, or returns `None` if the job does not request pairs.
pub fn table(job: &JobContext<'_>) -> Option<Pairs> {
    let (min, max) = job.division.root(&job.lattice).world(&job.lattice);
    job.pairs.map(|sides| {
        let pairs = Pairs::new(CellGrid::new(min, max, sides));
        match job.viewpoints {
            Some(marks) => pairs.reached_in(|cell| marks.parts(cell)),
            None => pairs,
        }
    })
}

/// Joins the cells of the part `within` of the division with the cells that they see, in at most `rounds`
/// rounds.
///
/// Of two cells, the cell with the lower number casts the segments. If a device casts the rounds of `block`,
/// it also casts the segments. Returns the number of rays.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
pub fn search(
    job: &JobContext<'_>,
    sight: &SightLineTracer<'_>,
    pairs: &Pairs,
    within: &CellBox,
    rounds: u32,
    watcher: &dyn Watcher,
    mut block: Option<&mut Block<'_>>,
) -> Result<u64, TileError> {
    let grid = pairs.grid();
    let cells: Vec<Cell> = grid
        .each()
        .enumerate()
        .map(|(number, at)| {
            let (lo, size) = grid.cell_box(at);
            let parts = job.viewpoints.map_or(u64::MAX, |marks| marks.parts(number));
            Cell {
                at,
                slot: grid.slot(at),
                lo,
                size,
                number: number as u64,
                parts,
            }
        })
        .collect();
    let (units, sides) = (job.lattice.units(), grid.cells());
    let inside = |cell: &&Cell| {
        (0..3).all(|a| {
            let middle =
                (u64::from(cell.at[a]) * 2 + 1) * u64::from(units[a]) / (2 * u64::from(sides[a]));
            (u64::from(within.lo[a])..u64::from(within.hi[a])).contains(&middle)
        })
    };
    let own: Vec<&Cell> = cells.iter().filter(inside).collect();
    let numbers: Vec<u32> = own.iter().map(|cell| cell.number as u32).collect();
    let (min, max) = grid.bounds();
    let step = (max - min).max_element() * LEAST_STEP;
    let (mut rays, mut all_free) = (0, 0.0);
    for round in 0..rounds {
        if job.is_late() {
            break;
        }
        let before = pairs.copy();
        let (region, seed, before) = (job.region, job.seed, &*before);
        let segments = Segments {
            sight,
            pairs,
            before,
            cells: &cells,
            region,
            step,
            seed,
            round,
        };
        let mut cast = |at: &Cast<'_>, at_any: bool| {
            if let Some(block) = block.as_deref_mut().filter(|block| block.is_on_device()) {
                let most = if at_any { FREE_SEGMENTS } else { MOST_SEGMENTS } as u32;
                let cells = &numbers;
                let found = block.segments_on_device(&SegmentWork {
                    cells,
                    round,
                    at_any,
                    most,
                })?;
                rays += found.iter().map(|f| f.0).sum::<u64>();
                return Ok(found.iter().map(|f| f.1).sum());
            }
            let compute = |item: usize| {
                if watcher.cancelled() {
                    return Err(TileError::Cancelled);
                }
                let found = if job.is_late() {
                    (0, 0.0)
                } else {
                    at(&segments, own[item])?
                };
                watcher.rendered(found.0);
                Ok(found)
            };
            let items = Items {
                count: own.len(),
                prepare: &|| {},
                cost: &|_| 1,
                compute: &compute,
                fits: &|_| true,
            };
            let tables = Tables {
                bits: None,
                pairs: Some(pairs),
            };
            let found: Vec<(u64, f64)> = phase::run(job.crew, tables, items)?;
            let count: u64 = found.iter().map(|f| f.0).sum();
            rays += count;
            tracing::debug!("joining, round {round}: {count} segments");
            // The sum is in the order of the cells, so it is the same on every run.
            Ok::<f64, TileError>(found.iter().map(|f| f.1).sum())
        };
        if round == 0 {
            all_free = cast(&|segments, cell| segments.at_any(cell), true)?;
        }
        let missed = cast(&|segments, cell| segments.at_open(cell), false)?;
        tracing::debug!("joining, round {round}: {missed:.0} of {all_free:.0} missed before");
        if LEFT_AFTER_ROUND * missed <= TOLERANCE * all_free {
            break;
        }
    }
    Ok(rays)
}

/// A function that casts segments from a cell. It returns their number and an estimate of the number of pairs
/// of points that see each other.
type Cast<'a> = dyn Fn(&Segments<'_>, &Cell) -> Result<(u64, f64), TileError> + Sync + 'a;

/// The inputs of a round.
struct Segments<'a> {
    sight: &'a SightLineTracer<'a>,
    pairs: &'a Pairs,
    /// The pairs before the round.
    before: &'a [u64],
    /// All cells of the division, by number.
    cells: &'a [Cell],
    /// The region that contains all viewpoints; `None` if viewpoints are not restricted to a region.
    region: Option<&'a dyn ViewRegion>,
    step: f32,
    seed: u64,
    round: u32,
}

impl Segments<'_> {
    /// Casts segments from a cell at some of the later cells.
    ///
    /// Returns the number of segments, and an estimate of the number of later cells of which a point sees a
    /// point of the cell.
    fn at_any(&self, cell: &Cell) -> Result<(u64, f64), TileError> {
        let later: Vec<&Cell> = self.later(cell).collect();
        self.cast(cell, &later, FREE_SEGMENTS, FREE)
    }

    /// Casts segments from a cell at the later cells that form no pair with the cell yet, or at a part of
    /// these cells.
    ///
    /// Returns the number of segments, and the fraction of free segments times the number of these cells.
    fn at_open(&self, cell: &Cell) -> Result<(u64, f64), TileError> {
        self.cast(cell, &self.open(cell), MOST_SEGMENTS, JOIN)
    }

    fn cast(
        &self,
        cell: &Cell,
        at: &[&Cell],
        most: usize,
        stream: u64,
    ) -> Result<(u64, f64), TileError> {
        let mut random = Hashed::new(&[self.seed, cell.number, u64::from(self.round), stream]);
        // The targets are spread evenly over the cells, beginning at a random cell.
        let every = at.len().div_ceil(most).max(1);
        let first = (random.bits() % every as u64) as usize;
        let times = LEAST_SEGMENTS
            .div_ceil(self.cells.len())
            .div_ceil(at.len().max(1))
            .min(most);
        let drawn = at.iter().skip(first).step_by(every);
        let (mut packets, mut passed): (Vec<Packet>, _) = (Vec::new(), Passed::default());
        let mut count = 0u64;
        for other in drawn.flat_map(|other| std::iter::repeat_n(other, times)) {
            let [mut from, mut to] = [cell, *other].map(|c| viewpoint(c, self.region, &mut random));
            if self.round % 2 == 1 {
                // If triangles have one side, the two directions differ.
                std::mem::swap(&mut from, &mut to);
            }
            let direction = [0, 1, 2].map(|a| to[a] - from[a]);
            if direction == [0.0; 3] {
                continue;
            }
            if packets.last().is_none_or(|p| p.count == LANES) {
                packets.push(Packet::default());
            }
            if let Some(packet) = packets.last_mut() {
                packet.push(from, direction);
                count += 1;
            }
        }
        self.sight
            .trace_each(&mut packets, &mut passed, self.step)?;
        let (mut free, mut crossed) = (0u64, Crossed::new());
        for packet in &packets {
            for lane in 0..packet.count {
                let end = packet.distance[lane];
                self.pairs
                    .join_line(packet.ray(lane), 0.0, end, &mut crossed);
                // The direction is the whole segment, so its end has the distance 1.
                free += u64::from(end >= 1.0);
            }
        }
        Ok((count, free as f64 * at.len() as f64 / count.max(1) as f64))
    }

    /// Returns the later cells that are not pairs with a cell.
    ///
    /// In late rounds, returns only the cells of which a neighbour is a pair with the cell, or that are pairs
    /// with a neighbour of the cell.
    fn open(&self, cell: &Cell) -> Vec<&Cell> {
        let grid = self.pairs.grid();
        let row = self.pairs.row_of(self.before, cell.slot);
        let near = (self.round >= WHOLE_ROUNDS).then(|| {
            let mut near: Vec<u64> = (0..row.len()).map(|word| grid.dilated(row, word)).collect();
            for axis in 0..3 {
                for next in [cell.at[axis].wrapping_sub(1), cell.at[axis] + 1] {
                    let mut at = cell.at;
                    at[axis] = next;
                    if grid.has(at) {
                        let row = self.pairs.row_of(self.before, grid.slot(at));
                        near.iter_mut().zip(row).for_each(|(n, bits)| *n |= bits);
                    }
                }
            }
            near
        });
        let has = |row: &[u64], seen_cell: &Cell| {
            row[seen_cell.slot.word as usize] >> seen_cell.slot.bit & 1 == 1
        };
        self.later(cell)
            .filter(|other| !has(row, other) && near.as_ref().is_none_or(|near| has(near, other)))
            .collect()
    }

    /// Returns the cells with larger numbers than `cell`. For a cell without viewpoints, returns only cells
    /// with viewpoints.
    fn later<'b>(&'b self, cell: &Cell) -> impl Iterator<Item = &'b Cell> + use<'b> {
        let unreached = cell.parts == 0;
        let later = self.cells[cell.number as usize..].iter().skip(1);
        later.filter(move |other| !unreached || other.parts != 0)
    }
}

/// Returns a random point of a cell: a viewpoint, or any point of a cell without viewpoints.
fn viewpoint(cell: &Cell, region: Option<&dyn ViewRegion>, random: &mut Hashed) -> [f32; 3] {
    match cell.parts {
        0 => Cell {
            parts: u64::MAX,
            ..*cell
        }
        .point(random.point()),
        _ => cell.random_origin(region, random),
    }
}
