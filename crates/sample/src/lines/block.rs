//! A block of cells that share their sight lines: the credits of lines, and the scratch memory of threads.
//!
//! The module [`super::rounds`] determines the order in which lines are cast.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use sightline_model::CellStats;
use sightline_scene::{Scene, TriangleId};
use sightline_trace::cube::SKY;
use sightline_trace::lines::FLOOD_STEPS;
use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::grid::{CellGrid, Crossed, Slot};
use sightline_trace::lines::packet_walk::PacketCrossed;
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::lines::tally::Tally;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::surface::Surface;

use super::cell_table::{Cell, CellTable};
use super::likely_items::Completion;
use super::observer::LineObserver;
use super::on_device_state::OnDevice;
use super::pacing::LinePacing;
use super::yields::YieldTable;
use crate::context::{ViewRegion, Watcher};
use crate::crew::Crew;

/// The joining interval of uniform lines: one lane in this number joins the cells that its line crosses.
///
/// Neighbouring lanes cross about the same cells, and joining is slower than tracing if a line crosses many
/// cells. In a block that is a part of the division, joining needs a separate traversal, so only the first
/// lane of a packet joins cells.
pub(super) const JOINED_LANES: usize = 4;
/// The joining interval of aimed lines, which are many and join fewer new cells.
pub(super) const JOINED_AIMED_LANES: usize = 16;

/// The minimum overlap of the two halves of a line, as a fraction of the block's size ([`Packet::reversed`]).
pub(super) const LEAST_STEP: f32 = 1.0 / (1 << 24) as f32;

/// The inputs of a block's sampling.
pub struct BlockInputs<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The facts about the scene's triangles.
    pub surface: &'a Surface,
    /// The rows of the table: triangles, or other items.
    pub rows: &'a Rows,
    /// The tracer of the lines.
    pub sight: &'a SightLineTracer<'a>,
    /// The seed of all random choices.
    pub seed: u64,
    /// The watcher, which receives the progress and can cancel the work.
    pub watcher: &'a dyn Watcher,
    /// The time at which sampling stops with the sets found so far.
    pub deadline: Option<Instant>,
    /// The pairs of cells that see each other; `None` if the job does not request pairs.
    pub pairs: Option<&'a Pairs>,
    /// The region that contains all viewpoints; `None` if viewpoints are not restricted to a region.
    pub region: Option<&'a dyn ViewRegion>,
    /// The crew that shares the work.
    pub crew: &'a dyn Crew,
    /// The observer of the lines; `None` to record no statistics of lines.
    pub observer: Option<&'a dyn LineObserver>,
}

/// The cells that lines cross.
#[derive(Default)]
pub(super) struct LineCells {
    /// The cells of the block that the lines of a packet cross.
    crossed: PacketCrossed,
    /// The cells of the block that one segment crosses.
    pub(super) segment: Crossed,
    /// The cells of the whole division that a line crosses.
    pub(super) joined: Crossed,
}

/// The scratch memory of a thread.
pub(super) struct Scratch {
    /// For each row of the table, the last tag under which one of its triangles was met.
    pub(super) met: Vec<u32>,
    /// For each item, the last tag under which one of its triangles was met; empty unless rows are finer than
    /// items.
    pub(super) met_items: Vec<u32>,
    pub(super) tag: u32,
    pub(super) packets: Vec<Packet>,
    pub(super) behind: Vec<Packet>,
    /// The see-through triangles on the lines traced last.
    pub(super) passed: Passed,
    pub(super) cells: LineCells,
    /// The attempts at the candidates of the current cell.
    pub(super) tally: Tally,
}

impl Scratch {
    /// Removes all marks of met triangles by starting a new tag.
    pub(super) fn next_tag(&mut self) {
        self.tag = self.tag.wrapping_add(1);
        if self.tag == 0 {
            self.met.fill(0);
            self.met_items.fill(0);
            self.tag = 1;
        }
    }
}

/// The cells of a block, and the triangles seen from each cell.
pub struct Block<'a> {
    pub(super) inputs: BlockInputs<'a>,
    pub(super) table: CellTable<'a>,
    /// The completion of the sets with likely items; `None` if the sets contain only seen items.
    pub(super) completion: Option<Completion<'a>>,
    /// A copy of the pairs from before the held-out lines of the current look.
    pub(super) held: Vec<u64>,
    /// True if the block is the whole division.
    is_whole: bool,
    /// True if lines end at a distance or some triangles have one side, so that the halves of a line are
    /// credited separately.
    in_halves: bool,
    pub(super) seeded: bool,
    /// The number of uniform rays after which a cell is finished, independent of their hits; `None` if the
    /// expected error decides.
    pub(super) enough: Option<u64>,
    /// The round sizes and ray costs that suit the tracer.
    pub(super) pace: LinePacing,
    /// The yields of aiming at candidates.
    pub(super) yields: YieldTable,
    /// True if the caller of the sampling, not the sampling itself, reports finished cells.
    pub(super) caller_reports_cells: bool,
    /// The number of cells reported as finished.
    told: usize,
    /// The minimum distance between the origin of a line and the start of its other half, in world units.
    pub(super) step: f32,
    /// The maximum number of flood steps from triangles that candidate lines found.
    pub(super) flood_steps: u32,
    /// The number of phases in which a device has aimed at candidates.
    pub(super) aims: u32,
    /// The device that casts whole rounds, if the tracer has one.
    pub(super) device: OnDevice<'a>,
    scratch: Mutex<Vec<Scratch>>,
}

impl<'a> Block<'a> {
    /// Creates a block in which no cell has seen a triangle.
    ///
    /// `number` returns a number of a cell that no other cell of the job has. `parts` returns the parts of a
    /// cell that contain viewpoints.
    pub fn new(
        inputs: BlockInputs<'a>,
        grid: CellGrid,
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
    ) -> Self {
        let (min, max) = grid.bounds();
        let step = (max - min).max_element() * LEAST_STEP;
        let same = |d: &CellGrid| d.bounds() == grid.bounds() && d.cells() == grid.cells();
        let is_whole = inputs.pairs.is_some_and(|pairs| same(pairs.grid()));
        let in_halves = inputs.sight.far() < f32::INFINITY || inputs.sight.is_one_way();
        Self {
            table: CellTable::new(inputs.rows, grid, number, parts),
            inputs,
            completion: None,
            held: Vec::new(),
            is_whole,
            in_halves,
            seeded: false,
            enough: None,
            // An attempt casts one ray in each of two opposite directions.
            yields: YieldTable::new(2 * LinePacing::HOST.aimed),
            pace: LinePacing::HOST,
            caller_reports_cells: false,
            told: 0,
            step,
            aims: 0,
            flood_steps: FLOOD_STEPS,
            device: OnDevice::Unknown,
            scratch: Mutex::default(),
        }
    }

    /// Finishes cells by their number of uniform rays instead of their expected error.
    ///
    /// A cell is finished when its rays meet an item with the share `share` of the cell's sight lines with a
    /// probability of 95 %. The probability that n independent rays all miss the item is (1 − share)ⁿ.
    pub fn search_for_share(&mut self, share: f64) {
        const MISSED: f64 = 0.05;
        self.enough = Some((MISSED.ln() / (-share).ln_1p()).ceil() as u64);
    }

    /// Returns the table of the triangles seen from each cell.
    pub fn bits(&self) -> &SeenBits {
        &self.table.bits
    }

    /// Returns the table of the triangles seen from each cell, for writing.
    pub fn bits_mut(&mut self) -> &mut SeenBits {
        &mut self.table.bits
    }

    /// Returns the grid of the block's cells.
    pub fn grid(&self) -> &CellGrid {
        &self.table.grid
    }

    /// Returns true if a cell has a viewpoint. `cell` is the cell's index in [`CellGrid::each`].
    pub fn is_reached(&self, cell: usize) -> bool {
        self.table.is_reached(cell)
    }

    /// Returns true if the halves of a line are credited separately, because lines end at a distance or some
    /// triangles have one side.
    pub(super) fn credits_halves(&self) -> bool {
        self.in_halves
    }

    /// Publishes all credits since the last barrier.
    pub(super) fn publish(&mut self) {
        self.table.publish(self.inputs.rows);
    }

    /// Returns true if a triangle's item was seen from a cell at the last barrier.
    pub(super) fn shown(&self, triangle: u32, slot: Slot) -> bool {
        match self.inputs.rows.are_finer() {
            true => self
                .table
                .items
                .seen(self.inputs.rows.item(TriangleId(triangle)), slot),
            false => self.table.seen(triangle, slot),
        }
    }

    /// Returns the statistics of each cell, in the order of [`CellGrid::each`].
    pub fn stats(&self) -> &[CellStats] {
        &self.table.stats
    }

    /// Reports `cells` more finished cells, unless the caller of the sampling reports them.
    pub(super) fn count_done(&mut self, cells: usize) {
        if !self.caller_reports_cells {
            self.tell_done(cells);
        }
    }

    /// Reports `cells` more finished cells, but never more than the block has.
    pub(super) fn tell_done(&mut self, cells: usize) {
        let more = cells.min(self.table.cells.len() - self.told);
        self.told += more;
        (0..more).for_each(|_| self.inputs.watcher.cell_done());
    }

    /// Credits every cell that the free part of a line crosses with the triangles on the line, for each line
    /// of a packet.
    ///
    /// These are the triangles at both ends and the see-through triangles in between. `halves` are the
    /// indices in `packets` of both halves ([`Packet::reversed`]), and `passed` contains the see-through
    /// triangles on them. The cells that one in `joins` lines crosses are joined. Calls `each` with each
    /// lane, the triangles at the ends, or [`SKY`] if a half of the line meets no triangle that shows, and
    /// the crossed cells with viewpoints. `each` gets no cells if both ends are [`SKY`], or if the halves are
    /// credited separately.
    #[inline(always)]
    pub(super) fn credit_lines(
        &self,
        packets: &[Packet],
        passed: &Passed,
        halves: [usize; 2],
        joins: Option<usize>,
        cells: &mut LineCells,
        mut each: impl FnMut(usize, [u32; 2], &[(u32, u64)]),
    ) {
        let LineCells {
            crossed,
            segment,
            joined,
        } = cells;
        let [ahead, behind] = halves.map(|k| &packets[k]);
        if !self.in_halves {
            let grid = &self.table.grid;
            grid.walk_packet(ahead, behind, self.step, crossed);
        }
        for lane in 0..ahead.count {
            let ends = [ahead.triangle[lane], behind.triangle[lane]];
            let is_joined = joins.is_some_and(|joins| lane.is_multiple_of(joins));
            if self.in_halves {
                self.credit_halves(packets, passed, halves, lane, segment);
                if is_joined {
                    self.join_halves([ahead, behind], lane, joined);
                }
                each(lane, ends, &[]);
                continue;
            }
            if ends == [SKY; 2] && !is_joined && passed.is_empty() {
                each(lane, ends, &[]);
                continue;
            }
            let crossed = &mut crossed.lanes[lane];
            if is_joined && (self.is_whole || lane == 0) {
                let (from, to) = ahead.free(behind, lane, self.step);
                self.join(ahead.ray(lane), from, to, crossed, joined);
            }
            self.table.only_reached(crossed);
            ends.into_iter()
                .filter(|t| *t != SKY)
                .for_each(|t| self.table.credit(t, crossed));
            passed.each_on_both(halves, lane, |t| self.table.credit(t, crossed));
            each(lane, ends, crossed);
        }
    }

    /// Joins the cells of the division that a line crosses. `crossed` are the crossed cells of the block.
    #[inline(never)]
    fn join(
        &self,
        line: ([f32; 3], [f32; 3]),
        from: f32,
        to: f32,
        crossed: &Crossed,
        joined: &mut Crossed,
    ) {
        match self.inputs.pairs {
            Some(pairs) if self.is_whole => pairs.join(crossed),
            Some(pairs) => pairs.join_line(line, from, to, joined),
            None => {}
        }
    }

    /// Credits cells like [`Self::credit_lines`], if lines end at a distance or some triangles have one side.
    ///
    /// Each triangle shows up to that distance on both sides of it. With triangles of one side, each half is
    /// free only in its own direction: triangles ahead are seen from the origin onward, and triangles behind
    /// from the origin backward. A passed triangle is not seen from beyond it.
    #[cold]
    fn credit_halves(
        &self,
        packets: &[Packet],
        passed: &Passed,
        halves: [usize; 2],
        lane: usize,
        crossed: &mut Crossed,
    ) {
        let [ahead, behind] = halves.map(|k| &packets[k]);
        let (origin, direction) = ahead.ray(lane);
        let (from, to) = ahead.free(behind, lane, self.step);
        let far = self.inputs.sight.far() / ahead.length(lane);
        let half = ahead.advance(lane, self.step);
        let on = [
            (ahead.triangle[lane], to, true),
            (behind.triangle[lane], from, false),
        ]
        .into_iter();
        let on = on.chain(passed.on_at(halves[0], lane).map(|(t, d)| (t, d, true)));
        let on = on.chain(
            passed
                .on_at(halves[1], lane)
                .map(|(t, d)| (t, half - d, false)),
        );
        for (triangle, at, is_ahead) in on.filter(|(t, ..)| *t != SKY) {
            let (least, most) = match (self.inputs.sight.is_one_way(), is_ahead) {
                (false, _) => (from, to),
                (true, true) => (from.max(0.0), at),
                (true, false) => (at, to.min(0.0)),
            };
            self.table.grid.walk(
                origin,
                direction,
                least.max(at - far),
                most.min(at + far),
                crossed,
            );
            self.table.only_reached(crossed);
            self.table.credit(triangle, crossed);
        }
    }

    /// Joins the cells that each half of a line crosses separately.
    #[cold]
    fn join_halves(&self, [ahead, behind]: [&Packet; 2], lane: usize, joined: &mut Crossed) {
        let Some(pairs) = self.inputs.pairs else {
            return;
        };
        let (from, to) = ahead.free(behind, lane, self.step);
        let far = self.inputs.sight.far() / ahead.length(lane);
        for (from, to) in [(from.max(-far), to.min(0.0)), (from.max(0.0), to.min(far))] {
            pairs.join_line(ahead.ray(lane), from, to, joined);
        }
    }

    /// Returns the pairs and the slot of a cell in their grid, or `None` if the job does not request pairs.
    pub(super) fn pairs_of(&self, cell: &Cell) -> Option<(&Pairs, Slot)> {
        let pairs = self.inputs.pairs?;
        let at = pairs.grid().cell_at(cell.lo + cell.size * 0.5);
        Some((pairs, pairs.grid().slot(at)))
    }

    /// Returns the joining intervals of uniform lines and of other lines: one line in this number joins
    /// cells.
    pub(super) fn joined_lines(&self) -> [u32; 2] {
        [
            if self.is_whole { JOINED_LANES } else { LANES },
            JOINED_AIMED_LANES,
        ]
        .map(|lanes| lanes as u32)
    }

    /// Returns true if the deadline has passed.
    pub(super) fn late(&self) -> bool {
        self.inputs.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Calls `f` with the scratch memory of a thread.
    pub(super) fn with_scratch<R>(&self, f: impl FnOnce(&mut Scratch) -> R) -> R {
        let taken = self
            .scratch
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        let mut scratch = taken.unwrap_or_else(|| Scratch {
            met: vec![0; self.inputs.rows.count()],
            met_items: vec![0; self.inputs.rows.members().len()],
            tag: 0,
            packets: Vec::new(),
            behind: Vec::new(),
            passed: Passed::default(),
            cells: LineCells::default(),
            tally: Tally::default(),
        });
        let result = f(&mut scratch);
        self.scratch
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(scratch);
        result
    }
}
