//! Rounds of sight lines, until the expected error of every cell of a block is within its tolerance.
//!
//! A round casts uniform lines from every open cell, floods from the triangles that they find, and then aims
//! at candidates. The fraction of a round's uniform rays that meet a new triangle is an unbiased estimate of
//! the fraction of sight lines that the cell's set missed when the round began. After the round, about half
//! of this fraction or less remains. A cell is finished when the expected fraction is at most its tolerance:
//! the target, or more for the hardest cells ([`Tolerance`]).

use super::block::Block;
pub use super::pacing::LinePacing;
use super::pacing::steps_from_candidates;
use crate::context::TileError;
use sightline_model::{CellStats, LineKind};

/// The target error above which the first round has [`LinePacing::first_coarse`] tiles along a face.
const COARSE: f64 = 5e-3;
/// Maximum number of tiles along a face in a round: 1.6 million rays, of which one miss is well below the
/// minimum allowed target.
const MOST_TILES: u32 = 128;
/// The missed fraction at the end of a round as a fraction of the missed fraction at its beginning. Measured
/// on scenes of every kind as 0.4 to 0.65.
pub(super) const LEFT_AFTER_ROUND: f64 = 0.5;
/// The missed fraction at the end of a cell's first round as a fraction of the missed fraction at its
/// beginning.
///
/// The first round begins with an almost empty set and floods far. Measured as 0.01 to 0.06.
const LEFT_AFTER_FIRST: f64 = 0.1;
/// The expected number of misses for which a round's size is chosen, so that its estimate is meaningful.
const MISSES_WANTED: f64 = 1.0;
/// The minimum coverage of a candidate, as a fraction of the cell's missed fraction. Smaller candidates are
/// not tried.
const CANDIDATE_PART: f64 = 1e-4;
/// Maximum number of rounds of a cell. A cell that needs more still finds new triangles in every round and is
/// marked as unfinished.
const MOST_ROUNDS: u32 = 24;
/// The multiple of the average cell's work from which a cell's tolerance grows in proportion to its work. The
/// mean error weights all cells equally, and the same work lowers the error of other cells more. See
/// [`Tolerance`].
const HARD_FROM: f64 = 3.0;
/// The factor on the target if items are clusters or objects: a missed line is rarer than with triangles.
/// With the whole target, more small items were missed than a bake of triangles misses
/// (`docs/experiments/items.md`).
const OF_ITEMS: f64 = 0.5;
/// The target error below which seeds are cast, after the second round of uniform lines. For larger targets,
/// seeds cost more than they gain.
const SEEDS_BELOW: f64 = 3e-3;

/// The tolerance of cells that cost far more work than other cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tolerance {
    /// Every cell has the target as its tolerance.
    Equal,
    /// A cell that costs several times the work of the average cell has a larger tolerance, in proportion.
    Raised,
}

impl Block<'_> {
    /// Samples the cells `wanted` until each is expected to miss at most its tolerance. `wanted` contains
    /// indices in `CellGrid::each`; an empty list selects all cells with viewpoints.
    ///
    /// The tolerance is a fraction of the sight lines from the cell: `target`, raised for some cells by
    /// [`Tolerance::Raised`].
    ///
    /// # Errors
    /// [`TileError`] if the tile is cancelled or the tracer fails. A passed deadline is not an error.
    pub fn sample(
        &mut self,
        target: f64,
        wanted: &[usize],
        hard: Tolerance,
    ) -> Result<(), TileError> {
        self.ask_for_device()?;
        let mut open: Vec<usize> = if wanted.is_empty() {
            self.table.active()
        } else {
            wanted.to_vec()
        };
        for cell in &open {
            (
                self.table.stats[*cell].unfinished,
                self.table.stats[*cell].raised_tolerance,
            ) = (false, false);
        }
        let enough = self.enough;
        // A device counts the misses of triangles.
        let by_items = self.inputs.rows.are_finer() && !self.is_on_device();
        let target = match by_items {
            true => target * OF_ITEMS,
            false => self.error_before_completion(target),
        };
        self.flood_steps = steps_from_candidates(target);
        for round in 0..MOST_ROUNDS {
            if open.is_empty() || self.late() {
                break;
            }
            let sizes: Vec<u32> = match enough {
                None => open
                    .iter()
                    .map(|c| self.tiles_for(*c, target, round))
                    .collect(),
                Some(rays) => open.iter().map(|c| self.tiles_up_to(*c, rays)).collect(),
            };
            let work: Vec<(usize, u32)> = open.iter().copied().zip(sizes).collect();
            if self.is_on_device() {
                self.uniform_on_device(&work)?;
            } else {
                self.each(&work, |block, scratch, (cell, tiles)| {
                    block.uniform(scratch, *cell, *tiles)
                })?;
            }
            self.publish();
            if round == 1 && !self.seeded && target < SEEDS_BELOW {
                self.seeded = true;
                if self.is_on_device() {
                    self.seeds_on_device()?;
                } else {
                    self.seeds()?;
                }
                self.publish();
            }
            if self.late() {
                break;
            }
            if enough.is_none() {
                // A cell that the first round has finished needs no candidates.
                let before = open.len();
                open.retain(|c| {
                    self.table.stats[*c].rounds > 1 || self.left(*c, LEFT_AFTER_FIRST) > target
                });
                self.count_done(before - open.len());
            }
            let least = self.least_parts(&open);
            self.plan_tries(&open);
            if self.is_on_device() {
                self.aim_on_device(&open, &least)?;
            } else {
                self.aim_at_candidates(&open, &least, round)?;
            }
            self.publish();
            if self.late() {
                // The deadline ended the aiming early, so the rule below does not hold.
                break;
            }
            let before = open.len();
            let average = self.work() / self.table.active().len().max(1) as f64;
            let mut spared = Vec::new();
            open.retain(|c| {
                let granted = match hard {
                    Tolerance::Equal => 1.0,
                    Tolerance::Raised => (self.work_of(*c) / (average * HARD_FROM)).max(1.0),
                };
                if let Some(rays) = enough {
                    return self.table.stats[*c].rays[LineKind::Uniform as usize] < rays;
                }
                let left = self.left(*c, LEFT_AFTER_ROUND);
                if left > target && left <= target * granted {
                    spared.push(*c);
                }
                left > target * granted
            });
            spared
                .into_iter()
                .for_each(|c: usize| self.table.stats[c].raised_tolerance = true);
            tracing::debug!("round {round}: {before} cells, {} left", open.len());
            self.count_done(before - open.len());
        }
        for cell in &open {
            self.table.stats[*cell].unfinished = true;
        }
        self.count_done(open.len());
        Ok(())
    }

    /// Plans the number of attempts at the candidates of `open` from the misses of its uniform rays and the
    /// gains of the last attempts.
    fn plan_tries(&mut self, open: &[usize]) {
        let sum = |count: fn(&CellStats) -> u64| {
            open.iter()
                .map(|c| count(&self.table.stats[*c]))
                .sum::<u64>()
        };
        let (misses, cast) = (sum(|s| s.last_misses), sum(|s| s.last_rays));
        let rays = sum(|s| s.rays[LineKind::Uniform as usize]) as f64 / open.len().max(1) as f64;
        self.yields.plan(misses, cast, rays);
    }

    /// Returns the fraction of sight lines that a cell is expected to miss after its last round. `part` is
    /// the ratio of the missed fractions after and before a round.
    pub(super) fn left(&self, cell: usize, part: f64) -> f64 {
        let s = &self.table.stats[cell];
        // One miss is added to the count, because no miss in a few rays is weak evidence.
        part * (s.last_misses as f64 + 1.0) / s.last_rays.max(1) as f64
    }

    /// Returns for each of `cells` the minimum fraction of the sphere that a candidate has to cover.
    pub(super) fn least_parts(&self, cells: &[usize]) -> Vec<f64> {
        let least = |c: &usize| (self.missing(*c) * CANDIDATE_PART).max(1e-12);
        cells.iter().map(least).collect()
    }

    /// Estimates the missed fraction at the beginning of the cell's last round, from that round.
    fn missing(&self, cell: usize) -> f64 {
        let s = &self.table.stats[cell];
        (s.last_misses as f64 + 0.5) / s.last_rays.max(1) as f64
    }

    /// Returns the work of a cell so far, in units of a uniform ray.
    fn work_of(&self, cell: usize) -> f64 {
        let [uniform, flood, candidate, _] = self.table.stats[cell].rays;
        (uniform + self.pace.aimed * (flood + candidate)) as f64
    }

    /// Returns the work of all cells so far, in units of a uniform ray.
    fn work(&self) -> f64 {
        (0..self.table.cells.len()).map(|c| self.work_of(c)).sum()
    }

    /// Returns the number of tiles along a cube face for a cell's next round towards `enough` uniform rays.
    ///
    /// The first round casts a third of the rays, so that candidates of its newly found triangles are tried
    /// before the rest. The next round casts all remaining rays.
    fn tiles_up_to(&self, cell: usize, enough: u64) -> u32 {
        let cast = self.table.stats[cell].rays[LineKind::Uniform as usize];
        let wanted = if cast == 0 {
            enough / 3
        } else {
            enough.saturating_sub(cast)
        };
        ((wanted as f64 / 96.0).sqrt().ceil() as u32).clamp(self.pace.first, MOST_TILES)
    }

    /// Returns the number of tiles along a cube face for a cell's next round, with [`MISSES_WANTED`] expected
    /// misses.
    fn tiles_for(&self, cell: usize, target: f64, round: u32) -> u32 {
        let s = &self.table.stats[cell];
        if s.last_rays == 0 {
            return if target > COARSE {
                self.pace.first_coarse
            } else {
                self.pace.first
            };
        }
        let expected = (self.missing(cell) * LEFT_AFTER_ROUND).max(target);
        let rays = MISSES_WANTED / expected;
        // A round has 3·tiles² pairs of packets with sixteen rays.
        let least = f64::from(self.pace.first) * self.pace.growth.powi(round as i32);
        ((rays / 96.0).sqrt().max(least).ceil() as u32).clamp(self.pace.first, MOST_TILES)
    }
}
