//! The bound on missed sight lines, from held-out lines.
//!
//! From a cell, n independent sight lines are cast that took no part in the search: origins are uniform in
//! the cell, directions uniform in the pixels of a visibility cube. When m of them meet a triangle outside
//! the cell's set, the fraction of all such lines is at most [`sightline_model::bound::upper_bound`] with
//! confidence 1 − α (Clopper and Pearson 1934). The bound holds for the average over the cell, not for the
//! worst viewpoint.
//!
//! A cell that does not pass is sampled further and tested again with new lines. Test k has the error
//! probability α·2⁻ᵏ, so over any number of tests the probability of a wrong bound stays below α. Triangles
//! found by a test are added to the set, which only lowers the error.

use super::block::{Block, Scratch};
use super::pairs::Pairs;
use super::rounds::{LEFT_AFTER_ROUND, Tolerance};
use crate::context::TileError;
use crate::cube::{SKY, face_basis};
use crate::error::BackendError;
use crate::packet::{LANES, Packet};
use crate::sequence::Hashed;
use sightline_model::params::BOUND_AIM;
use sightline_model::{CellStats, LineKind};

/// Number of tests after which a cell keeps the bound it has.
const MOST_LOOKS: u32 = 12;
/// Sight lines of the first test, in units of one over the required bound. Each later test takes one unit
/// more, because its confidence is higher. With six units a cell passes with one miss.
const LINES: f64 = 6.0;
/// Lines traced between two checks of the clock.
const BATCH: usize = 1 << 14;
/// Name of the stream of random numbers.
const CHECK: u64 = 5;

impl Block<'_> {
    /// Samples until every cell is expected to miss at most `target` and its bound is at most `most`, until
    /// the time is up, or until a cell has had its most tests. The statistics of a cell hold its bound.
    ///
    /// # Errors
    /// As [`Block::sample`].
    pub fn sample_to_bound(&mut self, target: f64, most: f64) -> Result<(), TileError> {
        let mut aim = target.min(most * BOUND_AIM);
        // A cell is finished when its bound holds.
        self.silent = true;
        // The bound has no per-cell tolerance.
        self.sample(aim, &[], Tolerance::Equal)?;
        let mut open: Vec<usize> = self.active();
        for look in 1..=MOST_LOOKS {
            let lines = ((LINES + f64::from(look - 1)) / most).ceil() as u64;
            self.look_at(&open, look, lines)?;
            let before = open.len();
            open.retain(|c| !self.is_bounded(*c, most));
            self.tell_done(before - open.len());
            if open.is_empty() || self.late() {
                break;
            }
            aim *= 0.5;
            let again = open.clone();
            self.sample(aim, &again, Tolerance::Equal)?;
        }
        self.tell_done(open.len());
        for cell in self.active() {
            // Sampling may have aimed below both limits; a missed aim does not matter then.
            let bounded = self.is_bounded(cell, most);
            let missed = self.stats[cell].unfinished && self.left(cell, LEFT_AFTER_ROUND) > target;
            self.stats[cell].unfinished = !bounded || missed;
        }
        Ok(())
    }

    /// Whether the bounds of a cell are at most `most`: on its missed sight lines, and on those that join it
    /// with a cell that is no pair with it.
    fn is_bounded(&self, cell: usize, most: f64) -> bool {
        let stats = &self.stats[cell];
        let within = |bound: Option<f64>| bound.is_some_and(|b| b <= most);
        within(stats.bound()) && (self.pairs.is_none() || within(stats.cell_bound()))
    }

    /// Test number `look`: casts `lines` held-out lines from every cell.
    ///
    /// # Errors
    /// As [`Block::sample`].
    pub fn look(&mut self, look: u32, lines: u64) -> Result<(), TileError> {
        let all = self.active();
        self.look_at(&all, look, lines)
    }

    fn look_at(&mut self, cells: &[usize], look: u32, lines: u64) -> Result<(), TileError> {
        self.held = self.pairs.as_ref().map_or_else(Vec::new, Pairs::copy);
        let work: Vec<(usize, u64)> = cells.iter().map(|c| (*c, lines)).collect();
        self.each(&work, |block, s, (cell, lines)| block.check(s, *cell, *lines, look))?;
        self.bits.publish();
        Ok(())
    }

    /// Casts `lines` held-out lines from `cell` and counts those that meet a triangle outside its set.
    fn check(&self, s: &mut Scratch, cell: usize, lines: u64, look: u32) -> Result<CellStats, BackendError> {
        let c = self.cells[cell];
        let mut random = Hashed::new(&[self.tools.seed, c.number, u64::from(look), CHECK]);
        let mut stats = CellStats::default();
        let (mut left, mut misses, mut cell_misses) = (lines, 0, 0);
        let pairs = self.pairs.as_ref().zip(self.pair_slot(&c));
        while left > 0 {
            if self.late() {
                // An incomplete test gives no bound.
                return Ok(CellStats { rays: stats.rays, ..CellStats::default() });
            }
            let batch = left.min(BATCH as u64) as usize;
            left -= batch as u64;
            // Drawn independently, then sorted so that consecutive lines have similar directions; the order
            // changes no count.
            let side = ((batch as f32 / 96.0).sqrt() as u32).max(1);
            let mut drawn: Vec<(u32, [f32; 6])> = (0..batch)
                .map(|_| {
                    let face = (random.bits() % 6) as u32;
                    let [u, v] = [random.unit(), random.unit()];
                    let [forward, right, up] = face_basis(face);
                    let d = forward + right * (2.0 * u - 1.0) + up * (2.0 * v - 1.0);
                    let o = c.point(random.point());
                    let key = (face * side + (v * side as f32) as u32) * side + (u * side as f32) as u32;
                    (key, [o[0], o[1], o[2], d.x, d.y, d.z])
                })
                .collect();
            drawn.sort_by_key(|(key, _)| *key);
            s.packets.clear();
            for group in drawn.chunks(LANES) {
                let mut packet = Packet::default();
                for (_, [ox, oy, oz, dx, dy, dz]) in group {
                    packet.push([*ox, *oy, *oz], [*dx, *dy, *dz]);
                }
                s.packets.push(packet);
            }
            self.tools.sight.trace_each(&mut s.packets, &mut s.passed, self.step)?;
            for (k, packet) in s.packets.iter().enumerate() {
                for lane in 0..packet.count {
                    if let Some((pairs, slot)) = pairs {
                        let to = packet.distance[lane];
                        pairs.join_line(packet.ray(lane), 0.0, to, &mut s.joined);
                        cell_misses += u64::from(pairs.is_new(&self.held, slot.index(), &s.joined));
                    }
                    let end = (packet.triangle[lane], packet.distance[lane]);
                    let shown = std::iter::once(end).chain(s.passed.on_at(k, lane));
                    let mut new = shown.filter(|(t, _)| *t != SKY && !self.seen(*t, c.slot)).peekable();
                    if new.peek().is_some() {
                        misses += 1;
                        let (origin, direction) = packet.ray(lane);
                        for (triangle, at) in new {
                            // A triangle of one side is not seen from beyond it.
                            let to = if self.tools.sight.is_one_way() { at } else { end.1 };
                            self.grid.walk(origin, direction, 0.0, to, &mut s.crossed);
                            self.only_reached(&mut s.crossed);
                            self.credit(triangle, &s.crossed);
                        }
                    }
                }
            }
            stats.rays[LineKind::Check as usize] += batch as u64;
        }
        stats.finds[LineKind::Check as usize] = misses;
        (stats.bound_lines, stats.bound_misses, stats.bound_look) = (lines, misses, look);
        stats.bound_cell_misses = cell_misses;
        Ok(stats)
    }
}
