//! Which cells see which, by segments between random points of two cells that no segment has joined yet.
//!
//! A segment is free up to the first triangle that blocks it, and joins all cells that it crosses until then,
//! beyond its target as well. The first two rounds cast at all open pairs, the later ones at those of which a
//! neighbour is joined, because what is missed lies there. Some segments at any cells tell how many pairs of
//! points see each other; those at open pairs that reach their target tell which part of these the relation
//! still misses. It ends when that part is small.
//!
//! Lines that look for triangles have joined the cells that they cross before. They find narrow openings, but
//! few of them lead from one end of a flat division to the other (`docs/experiments/cell-to-cell.md`).

use sightline_trace::lines::device::SegmentWork;
use sightline_trace::lines::grid::{CellGrid, Crossed};
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_viewcells::CellBox;

use super::block::{Block, Cell, LEAST_STEP};
use super::phase::{self, Items, Tables};
use super::rounds::LEFT_AFTER_ROUND;
use crate::context::{JobContext, TileError, ViewRegion, Watcher};

/// Most segments from a cell in a round; of more open pairs a part is drawn.
const MOST_SEGMENTS: usize = 512;
/// Least segments in a round from all cells together; fewer open pairs are cast at more than once.
const LEAST_SEGMENTS: usize = 1 << 16;
/// Segments from each cell at any later cell, which estimate how many pairs of points see each other.
const FREE_SEGMENTS: usize = 32;
/// Rounds that cast at all open pairs.
const WHOLE_ROUNDS: u32 = 2;
/// Most rounds after lines that have joined cells.
pub const FEW_ROUNDS: u32 = 8;
/// Most rounds after other rays.
pub const MANY_ROUNDS: u32 = 32;
/// The part of the free pairs of points that may be missed after the last round, and the least that is
/// searched for.
const TOLERANCE: f64 = 1e-4;
/// Names of the streams of random numbers.
const JOIN: u64 = 7;
const FREE: u64 = 12;

/// An empty table for the pairs of a job; `None` when it does not ask.
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

/// Joins the cells of the part `within` of the division with those that they see, in at most `rounds` rounds.
/// Of two cells, the one with the lower number casts; where the rounds of `block` are a device's, that does.
/// Returns the number of rays.
///
/// # Errors
/// [`TileError`] when it is cancelled or the backend fails.
pub fn search(
    job: &JobContext<'_>,
    sight: &SightLineTracer<'_>,
    pairs: &Pairs,
    (within, rounds): (&CellBox, u32),
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
        let (places, seed, before) = (job.places, job.seed, &*before);
        let segments = Segments {
            sight,
            pairs,
            before,
            cells: &cells,
            places,
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
            // In the order of the cells, so the sum is the same on every run.
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

/// Casts segments from a cell; their number, and how many pairs of points see each other as far as these
/// tell.
type Cast<'a> = dyn Fn(&Segments<'_>, &Cell) -> Result<(u64, f64), TileError> + Sync + 'a;

/// The inputs of a round.
struct Segments<'a> {
    sight: &'a SightLineTracer<'a>,
    pairs: &'a Pairs,
    /// The pairs before the round.
    before: &'a [u64],
    /// All cells of the division, by number.
    cells: &'a [Cell],
    /// The region that holds all viewpoints, if they are restricted to one.
    places: Option<&'a dyn ViewRegion>,
    step: f32,
    seed: u64,
    round: u32,
}

impl Segments<'_> {
    /// Casts segments from a cell at some of the later cells. Returns their number, and of how many later
    /// cells a point sees a point of the cell, as far as these tell.
    fn at_any(&self, cell: &Cell) -> Result<(u64, f64), TileError> {
        let later: Vec<&Cell> = self.later(cell).collect();
        self.cast(cell, &later, FREE_SEGMENTS, FREE)
    }

    /// Casts segments from a cell at the later cells that it is no pair with, or at a part of them. Returns
    /// their number, and how many of these pairs of points see each other, as far as these tell.
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
        // Evenly among them, beginning at a random one.
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
            let [mut from, mut to] = [cell, *other].map(|c| viewpoint(c, self.places, &mut random));
            if self.round % 2 == 1 {
                // Where triangles have one side, the two directions differ.
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
                // The direction is the segment.
                free += u64::from(end >= 1.0);
            }
        }
        Ok((count, free as f64 * at.len() as f64 / count.max(1) as f64))
    }

    /// The later cells that are no pair with a cell; in late rounds, only those of which a neighbour is a
    /// pair with the cell, or that are pairs with a neighbour of the cell.
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
        let has = |row: &[u64], of: &Cell| row[of.slot.word as usize] >> of.slot.bit & 1 == 1;
        self.later(cell)
            .filter(|other| !has(row, other) && near.as_ref().is_none_or(|near| has(near, other)))
            .collect()
    }

    /// The cells with greater numbers; without viewpoints in a cell, those that have some.
    fn later<'b>(&'b self, cell: &Cell) -> impl Iterator<Item = &'b Cell> + use<'b> {
        let unreached = cell.parts == 0;
        let later = self.cells[cell.number as usize..].iter().skip(1);
        later.filter(move |other| !unreached || other.parts != 0)
    }
}

/// A random point of a cell: where viewpoints are, or anywhere in a cell without viewpoints.
fn viewpoint(cell: &Cell, places: Option<&dyn ViewRegion>, random: &mut Hashed) -> [f32; 3] {
    match cell.parts {
        0 => Cell {
            parts: u64::MAX,
            ..*cell
        }
        .point(random.point()),
        _ => cell.random_origin(places, random),
    }
}
