//! The phases of a block whose rounds a device casts ([`sightline_trace::lines::device`]).
//!
//! For the crew, such a phase is one item: the member that computes it sends the newly found triangles to the
//! others, as with any item. The device's table follows the table of the block: at the end of a phase it
//! contains the triangles that the phase found. The device creates its table again if another member has
//! computed the phase.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use sightline_model::{CellStats, LineKind};
use sightline_trace::TracerError;
use sightline_trace::lines::device::{
    AimPlan, AimWork, ContinueCheck, DeviceBlock, DeviceCell, DevicePairs, DevicePhaseResult,
    KernelTime, Rounds, SegmentWork, Traffic, UniformWork,
};
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::lines::tally::Tally;
use sightline_trace::packet::LANES;
use sightline_trace::sequence::Hashed;

use super::block::Block;
use super::cell_table::Cell;
use super::finds::ItemResult;
use super::on_device_state::OnDevice;
use super::pacing::LinePacing;
use super::phase::{self, Items};
use super::yields::YieldTable;
use crate::context::TileError;

/// The name of the stream of random numbers from which cells get their keys.
const KEYS: u64 = 13;

/// The answer of a phase that a device has computed: the counts of all its items.
#[derive(Clone)]
pub(super) struct Whole {
    pub(super) stats: Vec<CellStats>,
    pub(super) tally: Tally,
    /// The number of rays that belong to no cell of the block.
    pub(super) rays: u64,
}

impl ItemResult for Whole {
    fn write(&self, out: &mut Vec<u8>) {
        self.rays.write(out);
        (self.stats.len() as u64).write(out);
        let stats = self.stats.iter().flat_map(CellStats::numbers);
        stats.chain(self.tally.numbers()).for_each(|n| n.write(out));
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        let (rays, count) = (u64::read(bytes)?, u64::read(bytes)?);
        // Each number has at least one byte.
        let count = usize::try_from(count)
            .ok()
            .filter(|n| *n <= bytes.len() / CellStats::NAMES.len())?;
        let mut stats = Vec::with_capacity(count);
        for _ in 0..count {
            let mut numbers = [0; CellStats::NAMES.len()];
            for n in &mut numbers {
                *n = u64::read(bytes)?;
            }
            stats.push(CellStats::from_numbers(numbers)?);
        }
        let mut tally = Tally::default().numbers();
        for n in &mut tally {
            *n = u64::read(bytes)?;
        }
        Some(Self {
            stats,
            tally: Tally::from_numbers(tally),
            rays,
        })
    }

    fn rays(&self) -> u64 {
        self.rays + self.stats.iter().flat_map(|s| s.rays).sum::<u64>()
    }
}

/// The function that computes a phase on a device.
type Compute<'a> =
    &'a (dyn Fn(&dyn Rounds, ContinueCheck<'_>) -> Result<DevicePhaseResult, TracerError> + Sync);

impl Block<'_> {
    /// Requests the tracer's device at the first call, and sets the pace of the device if there is one.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    pub fn ask_for_device(&mut self) -> Result<(), TracerError> {
        if !matches!(self.device, OnDevice::Unknown) {
            return Ok(());
        }
        // A device does not support regions or observers.
        let inputs = &self.inputs;
        let plain = inputs.region.is_none() && inputs.observer.is_none();
        self.device = OnDevice::No;
        if !plain {
            return Ok(());
        }
        let cells: Vec<DeviceCell> = self
            .table
            .cells
            .iter()
            .map(|c| self.device_cell(c))
            .collect();
        let first = self.table.cells.first().map_or(0, |c| c.number);
        let division = inputs.pairs.map(|pairs| self.division(pairs));
        let pairs = inputs
            .pairs
            .zip(division.as_ref())
            .map(|(pairs, (cells, slots))| DevicePairs {
                grid: pairs.grid(),
                cells,
                reached: pairs.reached(),
                slots,
                joins: self.joined_lines(),
            });
        let block = DeviceBlock {
            scene: inputs.scene,
            surface: inputs.surface,
            rows: inputs.rows.of_triangles(),
            row_count: inputs.rows.count(),
            grid: &self.table.grid,
            cells: &cells,
            reached: self.table.reached(),
            step: self.step,
            far: inputs.sight.far(),
            one_way: inputs.sight.is_one_way(),
            key: Hashed::new(&[inputs.seed, first, KEYS, 1]).bits(),
            pairs,
        };
        let sight = inputs.sight;
        if let Some(rounds) = sight.rounds(&block)? {
            self.device = OnDevice::Yes {
                rounds,
                stale: true,
            };
            self.set_pace(LinePacing::DEVICE);
        }
        Ok(())
    }

    /// Sets the pace of a block that has not cast lines yet.
    pub fn set_pace(&mut self, pace: LinePacing) {
        self.pace = pace;
        self.yields = YieldTable::new(2 * pace.aimed);
    }

    /// Returns the cells of the division, and the slots of the block's cells in the division.
    fn division(&self, pairs: &Pairs) -> (Vec<DeviceCell>, Vec<u32>) {
        let grid = pairs.grid();
        let cells = grid.each().enumerate().map(|(number, at)| {
            let (low, size) = grid.cell_box(at);
            let key = Hashed::new(&[self.inputs.seed, number as u64, KEYS, 2]).bits();
            DeviceCell {
                low,
                size,
                at,
                slot: grid.slot(at),
                parts: pairs.parts(number),
                key,
            }
        });
        let slot = |c: &Cell| grid.slot(grid.cell_at(c.lo + c.size * 0.5)).index() as u32;
        (cells.collect(), self.table.cells.iter().map(slot).collect())
    }

    fn device_cell(&self, c: &Cell) -> DeviceCell {
        let key = Hashed::new(&[self.inputs.seed, c.number, KEYS]).bits();
        DeviceCell {
            low: c.lo,
            size: c.size,
            at: c.at,
            slot: c.slot,
            parts: c.parts,
            key,
        }
    }

    /// Returns the traffic between host and device, or `None` if the host casts the rounds.
    pub fn traffic(&self) -> Option<Traffic> {
        match &self.device {
            OnDevice::Yes { rounds, .. } => Some(rounds.traffic()),
            _ => None,
        }
    }

    /// Returns the time of each kernel of the device. The list is empty unless the backend measures the
    /// times.
    pub fn kernel_times(&self) -> Vec<KernelTime> {
        match &self.device {
            OnDevice::Yes { rounds, .. } => rounds.kernel_times(),
            _ => Vec::new(),
        }
    }

    /// Returns true if a device casts the rounds.
    pub(super) fn is_on_device(&self) -> bool {
        matches!(self.device, OnDevice::Yes { .. })
    }

    /// Casts a round of uniform lines from each cell, with the given number of tiles along a cube face.
    pub(super) fn uniform_on_device(&mut self, work: &[(usize, u32)]) -> Result<(), TileError> {
        if work.is_empty() {
            return Ok(());
        }
        let base =
            |c: usize| self.table.stats[c].rays[LineKind::Uniform as usize] / (2 * LANES as u64);
        let lines = |(cell, tiles): &(usize, u32)| UniformWork {
            cell: *cell,
            tiles: *tiles,
            base: base(*cell),
        };
        let wanted: Vec<UniformWork> = work.iter().map(lines).collect();
        let answer = |found: &DevicePhaseResult| {
            let counted = found.counts.iter().zip(work);
            counted
                .map(|([misses, finds, flood, flood_finds], (_, tiles))| {
                    let last_rays = 2 * LANES as u64 * 3 * u64::from(*tiles) * u64::from(*tiles);
                    let last_misses = u64::from(*misses);
                    let mut s = CellStats {
                        last_rays,
                        last_misses,
                        ..CellStats::default()
                    };
                    s.rays[LineKind::Uniform as usize] = s.last_rays;
                    s.finds[LineKind::Uniform as usize] = u64::from(*finds);
                    s.rays[LineKind::Flood as usize] = u64::from(*flood);
                    s.finds[LineKind::Flood as usize] = u64::from(*flood_finds);
                    s
                })
                .collect()
        };
        let cells: Vec<usize> = work.iter().map(|w| w.0).collect();
        self.phase_on_device(&cells, &|rounds, on| rounds.uniform(&wanted, on), &answer)
    }

    /// Casts lines from each cell of `open` at the candidates that cover at least the fraction of the sphere
    /// in `least`, which has one number per cell.
    pub(super) fn aim_on_device(&mut self, open: &[usize], least: &[f64]) -> Result<(), TileError> {
        if open.is_empty() {
            return Ok(());
        }
        let rays = |c: usize| self.table.stats[c].rays[LineKind::Uniform as usize];
        let lines = |(c, least): (&usize, &f64)| AimWork {
            cell: *c,
            least: *least,
            rays: rays(*c),
        };
        let wanted: Vec<AimWork> = open.iter().zip(least).map(lines).collect();
        let [times, so_far] = self.yields.plan_for_device();
        // The phase is counted over all searches, so that two searches do not draw the same lines.
        let phase = self.aims;
        self.aims += 1;
        let plan = AimPlan {
            phase,
            times,
            so_far,
            flood_steps: self.flood_steps,
        };
        let answer = |found: &DevicePhaseResult| {
            let to_stats = |[rays, finds, flood, flood_finds]: &[u32; 4]| {
                let mut s = CellStats::default();
                s.rays[LineKind::Candidate as usize] = u64::from(*rays);
                s.finds[LineKind::Candidate as usize] = u64::from(*finds);
                s.rays[LineKind::Flood as usize] = u64::from(*flood);
                s.finds[LineKind::Flood as usize] = u64::from(*flood_finds);
                s
            };
            found.counts.iter().map(to_stats).collect()
        };
        self.phase_on_device(open, &|rounds, on| rounds.aim(&wanted, &plan, on), &answer)
    }

    /// Casts the seeds of the whole scene.
    pub(super) fn seeds_on_device(&mut self) -> Result<(), TileError> {
        self.phase_on_device(&[], &|rounds, on| rounds.seeds(on), &|_| Vec::new())
    }

    /// Performs look number `look`: casts the given number of held-out lines from each cell.
    pub(super) fn check_on_device(
        &mut self,
        work: &[(usize, u64)],
        look: u32,
    ) -> Result<(), TileError> {
        let with_pairs = self.inputs.pairs.is_some();
        let answer = |found: &DevicePhaseResult| {
            let counted = found.counts.iter().zip(work);
            counted
                .map(|([misses, cell_misses, ..], (_, lines))| {
                    let mut s = CellStats::default();
                    s.rays[LineKind::Check as usize] = *lines;
                    s.finds[LineKind::Check as usize] = u64::from(*misses);
                    (s.bound_lines, s.bound_misses, s.bound_look) =
                        (*lines, u64::from(*misses), look);
                    if with_pairs {
                        (s.bound_cell_lines, s.bound_cell_misses, s.bound_cell_look) =
                            (*lines, u64::from(*cell_misses), look);
                    }
                    s
                })
                .collect()
        };
        let cells: Vec<usize> = work.iter().map(|w| w.0).collect();
        self.phase_on_device(&cells, &|rounds, on| rounds.check(work, look, on), &answer)
    }

    /// Casts a round of segments from some cells of the division, which join the cells that they cross.
    ///
    /// Returns for each cell the number of segments, and an estimate of the number of later cells of which a
    /// point sees a point of the cell.
    pub(super) fn segments_on_device(
        &mut self,
        work: &SegmentWork<'_>,
    ) -> Result<Vec<(u64, f64)>, TileError> {
        let estimates = Mutex::default();
        let answer = |found: &DevicePhaseResult| {
            let stats = |[segments, free, at, _]: &[u32; 4]| {
                // Store the three counts in any fields of the statistics, which the answer carries to the
                // other members.
                let [last_rays, last_misses, bound_lines] = [*segments, *free, *at].map(u64::from);
                CellStats {
                    last_rays,
                    last_misses,
                    bound_lines,
                    ..CellStats::default()
                }
            };
            found.counts.iter().map(stats).collect()
        };
        let count = work.cells.len();
        let take = |stats: &[CellStats]| {
            let estimate = |s: &CellStats| {
                let part = s.last_misses as f64 / s.last_rays.max(1) as f64;
                (s.last_rays, part * s.bound_lines as f64)
            };
            *estimates.lock().unwrap_or_else(PoisonError::into_inner) =
                stats.iter().map(estimate).collect();
        };
        self.any_phase_on_device(
            count,
            &|rounds, on| rounds.segments(work, on),
            &answer,
            &mut |_, s| take(s),
        )?;
        Ok(estimates
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner))
    }

    /// Ensures that a device computes a phase, here or on another member, and adds the counts to the cells'
    /// statistics.
    fn phase_on_device(
        &mut self,
        cells: &[usize],
        compute: Compute<'_>,
        answer: &(dyn Fn(&DevicePhaseResult) -> Vec<CellStats> + Sync),
    ) -> Result<(), TileError> {
        self.any_phase_on_device(cells.len(), compute, answer, &mut |block, stats| {
            cells
                .iter()
                .zip(stats)
                .for_each(|(cell, s)| block.count(*cell, s));
        })
    }

    /// Works like [`Self::phase_on_device`] for any `count` items. `take` receives their counts.
    fn any_phase_on_device(
        &mut self,
        count: usize,
        compute: Compute<'_>,
        answer: &(dyn Fn(&DevicePhaseResult) -> Vec<CellStats> + Sync),
        take: &mut dyn FnMut(&mut Self, &[CellStats]),
    ) -> Result<(), TileError> {
        let this = &*self;
        let OnDevice::Yes { rounds, stale } = &this.device else {
            return Ok(());
        };
        let watcher = this.inputs.watcher;
        // The copy is made before the phase, because results of another member may arrive during the
        // computation.
        let pairs = this.inputs.pairs.filter(|_| *stale).map(Pairs::copy);
        // The device publishes the triangles that it found, so it must not compute the phase twice.
        let own: Mutex<Option<Whole>> = Mutex::default();
        let work = |_| {
            let mut own = own.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(whole) = &*own {
                return Ok(whole.clone());
            }
            if watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            if *stale {
                rounds.restart(&this.table.bits, pairs.as_deref())?;
            }
            let told = AtomicU64::new(0);
            let found = compute(&**rounds, &|rays| {
                told.fetch_add(rays, Relaxed);
                watcher.rendered(rays);
                !watcher.cancelled() && !this.late()
            })?;
            if watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            let mut stats = answer(&found);
            // Interrupted work has zero counts.
            stats.resize_with(count, CellStats::default);
            found
                .words
                .par_iter()
                .with_min_len(4096)
                .for_each(|(at, word)| this.table.bits.add(*at as usize, *word));
            if let Some(pairs) = this.inputs.pairs {
                found
                    .pair_words
                    .iter()
                    .for_each(|(at, word)| pairs.add(*at as usize, *word));
            }
            let whole = Whole {
                stats,
                tally: found.tally,
                rays: found.rays,
            };
            watcher.rendered(whole.rays().saturating_sub(told.into_inner()));
            *own = Some(whole.clone());
            Ok(whole)
        };
        let fits = |whole: &Whole| whole.stats.len() == count;
        let items = Items {
            count: 1,
            prepare: &|| {},
            cost: &|_| 1,
            compute: &work,
            fits: &fits,
        };
        let done = phase::run(this.inputs.crew, this.tables(), items)?;
        let is_here = own
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
            .is_some();
        if let OnDevice::Yes { stale, .. } = &mut self.device {
            *stale = !is_here;
        }
        for whole in done {
            self.yields.add(&whole.tally);
            take(self, &whole.stats);
        }
        Ok(())
    }
}
