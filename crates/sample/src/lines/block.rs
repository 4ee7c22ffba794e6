//! A block of cells that share their sight lines: the cells, the table of the triangles each cell sees, and
//! the distribution of work over threads.
//!
//! The order in which lines are cast is in [`super::rounds`].

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec3;
use sightline_model::CellStats;
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_trace::cube::SKY;
use sightline_trace::lines::FLOOD_STEPS;
use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::grid::{CellGrid, Crossed, Slot};
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::lines::tally::Tally;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sequence::{Hashed, spread3};
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::surface::Surface;
use sightline_viewcells::part_mask::PARTS;

use super::items::SeenItems;
use super::ledger::Ledger;
use super::on_device_state::OnDevice;
use super::pace::Pace;
use super::yields::Yields;
use crate::context::{ViewRegion, Watcher};
use crate::crew::Crew;

/// One lane in this many joins the cells that its line crosses: neighbouring lanes cross about the same
/// cells, and joining takes longer than tracing where a line crosses many. In a block that is a part of
/// the division it takes a walk of its own, so only the first lane of a packet does.
pub(super) const JOINED_LANES: usize = 4;
/// The same for aimed lines, which are many and join fewer cells for the first time.
pub(super) const JOINED_AIMED_LANES: usize = 16;

/// Points that are tried as a viewpoint before any point of the region is taken. Where the region fills less
/// of the marked parts than one in so many, its viewpoints are not spread evenly.
const TRIES: usize = 200;

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
    pub sight: &'a SightLineTracer<'a>,
    /// Seed of all choices.
    pub seed: u64,
    /// Receives the progress and can cancel the work.
    pub watcher: &'a dyn Watcher,
    /// When sampling stops with the sets found by then.
    pub deadline: Option<Instant>,
    /// Which cells see which; `None` when the job does not ask.
    pub pairs: Option<&'a Pairs>,
    /// The region that holds all viewpoints, if they are restricted to one.
    pub places: Option<&'a dyn ViewRegion>,
    /// Those who share the work.
    pub crew: &'a dyn Crew,
    /// Who keeps account of the lines, if anybody does.
    pub ledger: Option<&'a dyn Ledger>,
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
    /// The marks of its parts that hold viewpoints ([`sightline_viewcells::PartMask`]); all bits when all do.
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

    /// A viewpoint near fractions of its size: where viewpoints are in a region alone, the first of a spread
    /// sequence of points from there on that the region holds, or any point of the region in the cell.
    pub(super) fn origin(&self, places: Option<&dyn ViewRegion>, f: impl Into<Vec3>) -> [f32; 3] {
        let f: Vec3 = f.into();
        let Some(places) = places else {
            return self.point(f);
        };
        let tries = (1..).map(|number| self.point(spread3(number, f.to_array())));
        self.held(places, std::iter::once(self.point(f)).chain(tries))
            .unwrap_or_else(|| self.point(f))
    }

    /// A random viewpoint, uniform where viewpoints are, unless the region fills hardly any of the marked
    /// parts ([`TRIES`]).
    pub(super) fn random_origin(
        &self,
        places: Option<&dyn ViewRegion>,
        random: &mut Hashed,
    ) -> [f32; 3] {
        let first = self.point(random.point());
        let Some(places) = places else { return first };
        let tries =
            std::iter::once(first).chain(std::iter::repeat_with(|| self.point(random.point())));
        self.held(places, tries).unwrap_or(first)
    }

    fn held(
        &self,
        places: &dyn ViewRegion,
        tries: impl Iterator<Item = [f32; 3]>,
    ) -> Option<[f32; 3]> {
        tries
            .take(TRIES)
            .find(|p| places.hold(Vec3::from(*p)))
            .or_else(|| {
                let own = Aabb::new(self.lo, self.lo + self.size);
                places.any_in(own).map(|p| p.to_array())
            })
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
    /// For each item the last tag under which one of its triangles was met; empty unless rows are finer.
    pub(super) met_items: Vec<u32>,
    pub(super) tag: u32,
    pub(super) packets: Vec<Packet>,
    pub(super) behind: Vec<Packet>,
    /// The see-through triangles on the lines traced last.
    pub(super) passed: Passed,
    pub(super) crossed: Crossed,
    /// The cells of the whole division that a line crosses.
    pub(super) joined: Crossed,
    /// The tries at the candidates of the present cell.
    pub(super) tally: Tally,
}

impl Scratch {
    /// Forgets all marks of triangles.
    pub(super) fn next_tag(&mut self) {
        self.tag = self.tag.wrapping_add(1);
        if self.tag == 0 {
            self.met.fill(0);
            self.met_items.fill(0);
            self.tag = 1;
        }
    }
}

/// The cells of a block and the triangles seen from each.
pub struct Block<'a> {
    pub(super) tools: Tools<'a>,
    pub(super) grid: CellGrid,
    pub(super) bits: SeenBits,
    /// The items seen from each, where rows are finer than items.
    pub(super) items: SeenItems,
    pub(super) cells: Vec<Cell>,
    /// One for each of `cells`.
    pub(super) stats: Vec<CellStats>,
    /// Row of each triangle; empty when it is the triangle's id. Copied here because every line asks.
    rows: &'a [u32],
    /// The words of a row without the cells that have no viewpoint; empty when all have one.
    reached: Vec<u64>,
    /// The pairs before the held-out lines that are being cast.
    pub(super) held: Vec<u64>,
    /// Whether the block is the whole division.
    is_whole: bool,
    /// Whether lines end at a distance or some triangles have one side, so that the halves of a line are
    /// credited by themselves.
    in_halves: bool,
    pub(super) seeded: bool,
    /// Uniform rays after which a cell is finished, whatever they met; `None` when the expected error
    /// decides.
    pub(super) enough: Option<u64>,
    /// What suits the tracer.
    pub(super) pace: Pace,
    /// The yields of aiming at candidates.
    pub(super) yields: Yields,
    /// Whether the caller of the sampling, not the sampling itself, reports finished cells.
    pub(super) silent: bool,
    /// Number of cells reported as finished.
    told: usize,
    /// Least distance between the origin of a line and the start of its other half, in world units.
    pub(super) step: f32,
    /// Most steps of the flood from what candidates find.
    pub(super) flood_steps: u32,
    /// Phases in which a device has aimed at candidates.
    pub(super) aims: u32,
    /// The device that casts whole rounds, if the tracer has one.
    pub(super) device: OnDevice<'a>,
    scratch: Mutex<Vec<Scratch>>,
}

impl<'a> Block<'a> {
    /// A block with nothing seen. `number` gives each of its cells a number that no other cell of the job
    /// has, and `parts` the parts of the cell that hold viewpoints.
    pub fn new(
        tools: Tools<'a>,
        grid: CellGrid,
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
    ) -> Self {
        let cells: Vec<Cell> = grid
            .each()
            .map(|at| {
                let (lo, size) = grid.cell_box(at);
                Cell {
                    at,
                    slot: grid.slot(at),
                    lo,
                    size,
                    number: number(at),
                    parts: parts(at),
                }
            })
            .collect();
        let mut reached = Vec::new();
        if cells.iter().any(|c| c.parts == 0) {
            reached.resize(grid.words(), 0u64);
            let with = cells.iter().filter(|c| c.parts != 0);
            with.for_each(|c| reached[c.slot.word as usize] |= 1 << c.slot.bit);
        }
        let (min, max) = grid.bounds();
        let step = (max - min).max_element() * LEAST_STEP;
        let bits = SeenBits::new(tools.rows.count(), grid.words());
        let same = |d: &CellGrid| d.bounds() == grid.bounds() && d.cells() == grid.cells();
        let is_whole = tools.pairs.is_some_and(|pairs| same(pairs.grid()));
        let in_halves = tools.sight.far() < f32::INFINITY || tools.sight.is_one_way();
        let count = cells.len();
        let stats = vec![CellStats::default(); count];
        Self {
            rows: tools.rows.of_triangles(),
            tools,
            grid,
            bits,
            items: SeenItems::default(),
            cells,
            stats,
            reached,
            held: Vec::new(),
            is_whole,
            in_halves,
            seeded: false,
            enough: None,
            // A try casts one ray in each of two opposite directions.
            yields: Yields::new(2 * Pace::HOST.aimed),
            pace: Pace::HOST,
            silent: false,
            told: 0,
            step,
            aims: 0,
            flood_steps: FLOOD_STEPS,
            device: OnDevice::Unknown,
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

    /// Whether a viewpoint is in a cell, by its place in [`CellGrid::each`].
    pub fn is_reached(&self, cell: usize) -> bool {
        self.cells[cell].parts != 0
    }

    /// The words of a row without the cells that have no viewpoint; empty when all have one.
    pub(super) fn reached(&self) -> &[u64] {
        &self.reached
    }

    /// The cells with viewpoints, by their places in [`CellGrid::each`].
    pub(super) fn active(&self) -> Vec<usize> {
        (0..self.cells.len())
            .filter(|c| self.is_reached(*c))
            .collect()
    }

    /// The row of a triangle.
    #[inline]
    pub(super) fn row(&self, triangle: u32) -> u32 {
        if self.rows.is_empty() {
            triangle
        } else {
            self.rows[triangle as usize]
        }
    }

    /// Publishes all credits since the last barrier.
    pub(super) fn publish(&mut self) {
        self.bits.publish();
        self.items.gather(self.tools.rows, &self.bits);
    }

    /// Returns true if a triangle's item was seen from a cell at the last barrier.
    pub(super) fn shown(&self, triangle: u32, slot: Slot) -> bool {
        match self.tools.rows.are_finer() {
            true => self.items.seen(self.tools.rows.item(triangle), slot),
            false => self.seen(triangle, slot),
        }
    }

    /// Returns true if a triangle's row was credited to a cell at the last barrier.
    pub(super) fn seen(&self, triangle: u32, slot: Slot) -> bool {
        self.bits.seen(self.row(triangle), slot)
    }

    /// Credits cells with a triangle's row; those without viewpoints must have been taken out.
    pub(super) fn credit(&self, triangle: u32, crossed: &[(u32, u64)]) {
        self.bits.credit(self.row(triangle), crossed);
    }

    /// Credits a cell, if it has viewpoints, with a triangle's row.
    pub(super) fn credit_one(&self, triangle: u32, slot: Slot) {
        if self.reached.is_empty() || self.reached[slot.word as usize] >> slot.bit & 1 == 1 {
            self.credit(triangle, &[(slot.word, 1 << slot.bit)]);
        }
    }

    /// Takes out of the crossed cells those without viewpoints.
    pub(super) fn only_reached(&self, crossed: &mut Crossed) {
        if !self.reached.is_empty() {
            crossed
                .iter_mut()
                .for_each(|(word, bits)| *bits &= self.reached[*word as usize]);
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
    /// meets nothing that shows. `halves` are the places in `packets` of both halves ([`Packet::reversed`]),
    /// and `passed` holds the see-through triangles on them. If `joins`, the cells that the line crosses are
    /// joined.
    #[inline(always)]
    pub(super) fn credit_line(
        &self,
        packets: &[Packet],
        passed: &Passed,
        halves: [usize; 2],
        lane: usize,
        (crossed, joined): (&mut Crossed, &mut Crossed),
        joins: bool,
    ) -> [u32; 2] {
        let [ahead, behind] = halves.map(|k| &packets[k]);
        let ends = [ahead.triangle[lane], behind.triangle[lane]];
        if self.in_halves {
            self.credit_halves(packets, passed, halves, lane, crossed);
            if joins {
                self.join_halves([ahead, behind], lane, joined);
            }
        } else if ends != [SKY; 2] || joins || !passed.is_empty() {
            let (origin, direction) = ahead.ray(lane);
            let (from, to) = ahead.free(behind, lane, self.step);
            self.grid.walk(origin, direction, from, to, crossed);
            if joins && (self.is_whole || lane == 0) {
                self.join((origin, direction), (from, to), crossed, joined);
            }
            self.only_reached(crossed);
            ends.into_iter()
                .filter(|t| *t != SKY)
                .for_each(|t| self.credit(t, crossed));
            passed.each_on_both(halves, lane, |t| self.credit(t, crossed));
        }
        ends
    }

    /// Joins the cells of the division that a line crosses; `crossed` are the cells of the block.
    #[inline(never)]
    fn join(
        &self,
        (origin, direction): ([f32; 3], [f32; 3]),
        (from, to): (f32, f32),
        crossed: &Crossed,
        joined: &mut Crossed,
    ) {
        match self.tools.pairs {
            Some(pairs) if self.is_whole => pairs.join(crossed),
            Some(pairs) => pairs.join_line((origin, direction), from, to, joined),
            None => {}
        }
    }

    /// As [`Self::credit_line`] where lines end at a distance or some triangles have one side. Each
    /// triangle shows up to that distance on both sides of it. With triangles of one side, each half is
    /// free in its own direction alone: what lies ahead is seen from the origin on, what lies behind from
    /// the origin back, and a triangle that is passed is not seen from beyond it.
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
        let far = self.tools.sight.far() / ahead.length(lane);
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
            let (least, most) = match (self.tools.sight.is_one_way(), is_ahead) {
                (false, _) => (from, to),
                (true, true) => (from.max(0.0), at),
                (true, false) => (at, to.min(0.0)),
            };
            self.grid.walk(
                origin,
                direction,
                least.max(at - far),
                most.min(at + far),
                crossed,
            );
            self.only_reached(crossed);
            self.credit(triangle, crossed);
        }
    }

    /// Joins the cells that each half of a line crosses by itself.
    #[cold]
    fn join_halves(&self, [ahead, behind]: [&Packet; 2], lane: usize, joined: &mut Crossed) {
        let Some(pairs) = self.tools.pairs else {
            return;
        };
        let (from, to) = ahead.free(behind, lane, self.step);
        let far = self.tools.sight.far() / ahead.length(lane);
        for (from, to) in [(from.max(-far), to.min(0.0)), (from.max(0.0), to.min(far))] {
            pairs.join_line(ahead.ray(lane), from, to, joined);
        }
    }

    /// The pairs, and the slot of one of its cells in their grid; `None` when the job does not ask for pairs.
    pub(super) fn pairs_of(&self, cell: &Cell) -> Option<(&Pairs, Slot)> {
        let pairs = self.tools.pairs?;
        let at = pairs.grid().cell_at(cell.lo + cell.size * 0.5);
        Some((pairs, pairs.grid().slot(at)))
    }

    /// One line in so many joins the cells of the division: of uniform lines, of others.
    pub(super) fn joined_lines(&self) -> [u32; 2] {
        [
            if self.is_whole { JOINED_LANES } else { LANES },
            JOINED_AIMED_LANES,
        ]
        .map(|lanes| lanes as u32)
    }

    /// Whether the time is up.
    pub(super) fn late(&self) -> bool {
        self.tools.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Lends a thread's scratch memory.
    pub(super) fn with_scratch<R>(&self, f: impl FnOnce(&mut Scratch) -> R) -> R {
        let taken = self
            .scratch
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        let mut scratch = taken.unwrap_or_else(|| Scratch {
            met: vec![0; self.tools.rows.count()],
            met_items: vec![0; self.tools.rows.members().len()],
            tag: 0,
            packets: Vec::new(),
            behind: Vec::new(),
            passed: Passed::default(),
            crossed: Vec::new(),
            joined: Vec::new(),
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
