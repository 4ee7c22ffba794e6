//! The bound on missed sight lines, from held-out lines.
//!
//! From a cell, n independent sight lines are cast that the search does not use: origins are uniform in the
//! cell, directions uniform in the pixels of a visibility cube. If m of the lines meet a triangle outside the
//! cell's set, the fraction of all such lines is at most [`sightline_model::bound::upper_bound`] with
//! confidence 1 − α (Clopper and Pearson 1934). The bound holds for the average over the cell, not for the
//! worst viewpoint.
//!
//! With completion (module `completion`), a line that meets a likely item is not a miss. The likely items
//! of a cell are determined before its look.
//!
//! A cell that exceeds the bound is sampled further and has another look with new lines. Look k has the error
//! probability α·2⁻ᵏ, so over any number of looks the probability of a wrong bound stays below α. A look adds
//! the triangles that it finds to the set, which only lowers the error.

use sightline_model::numbers::BOUND_AIM;
use sightline_model::{CellStats, LineKind};
use sightline_trace::TracerError;
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;

use super::block::{Block, Scratch};
use super::rounds::{LEFT_AFTER_ROUND, Tolerance};
use crate::context::TileError;

/// Maximum number of looks at a cell.
const MOST_LOOKS: u32 = 12;
/// The number of sight lines of the first look, in units of one over the required bound. Each later look has
/// one unit more, because its confidence is higher. With six units a cell passes with one miss.
const LINES: f64 = 6.0;
/// The number of lines traced between two checks of the deadline.
const BATCH: usize = 1 << 14;
/// The names of the streams of random numbers.
const CHECK: u64 = 5;
const CHECK_CELLS: u64 = 10;
const JOIN_MORE: u64 = 11;

/// Returns the expected error at which the looks begin.
fn first_aim(target: f64, most: f64) -> f64 {
    target.min(most * BOUND_AIM)
}

impl Block<'_> {
    /// Samples all cells before the first look of [`Self::sample_to_bound`]. `target` is the target error,
    /// and `most` the maximum bound; both are fractions of the sight lines.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn sample_before_bound(&mut self, target: f64, most: f64) -> Result<(), TileError> {
        // A cell is finished when its bound holds.
        self.caller_reports_cells = true;
        // The bound has no per-cell tolerance.
        self.sample(first_aim(target, most), &[], Tolerance::Equal)
    }

    /// Samples until every cell is expected to miss at most `target` and its bound is at most `most`.
    ///
    /// Sampling also ends at the deadline, or when a cell has had the maximum number of looks. The statistics
    /// of a cell contain its bound. Call [`Self::sample_before_bound`] first.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn sample_to_bound(&mut self, target: f64, most: f64) -> Result<(), TileError> {
        let mut aim = first_aim(target, most);
        let target = self.error_before_completion(target);
        let mut open: Vec<usize> = self.table.active();
        for look in 1..=MOST_LOOKS {
            let lines = ((LINES + f64::from(look - 1)) / most).ceil() as u64;
            let earlier = self.likely_items();
            self.complete(&open);
            self.look_at(&open, look, lines)?;
            // A bound holds with the likely items that the cell had before the look. At the deadline, a look
            // can end early, and the bound of the cell's earlier look remains.
            if let Some(completion) = &mut self.completion {
                for (cell, earlier) in earlier.into_iter().enumerate() {
                    if open.contains(&cell) && self.table.stats[cell].bound_look != look {
                        completion.likely[cell] = earlier;
                    }
                }
            }
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
        for cell in self.table.active() {
            // Sampling may have aimed below both limits. A missed aim is then irrelevant.
            let bounded = self.is_bounded(cell, most);
            let missed =
                self.table.stats[cell].unfinished && self.left(cell, LEFT_AFTER_ROUND) > target;
            self.table.stats[cell].unfinished = !bounded || missed;
        }
        Ok(())
    }

    fn is_bounded(&self, cell: usize, most: f64) -> bool {
        self.table.stats[cell].bound().is_some_and(|b| b <= most)
    }

    /// Joins cells until the bound on unjoined sight lines of every cell is at most `most`.
    ///
    /// An unjoined sight line crosses a cell that is not a pair with its own cell. The work also ends at the
    /// deadline, or when a cell has had the maximum number of looks. The looks of [`Self::sample_to_bound`]
    /// also counted these lines, so few cells remain. The sets of triangles do not change.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn join_to_bound(&mut self, most: f64) -> Result<(), TileError> {
        if self.inputs.pairs.is_none() {
            return Ok(());
        }
        let mut open = self.table.active();
        for _ in 1..MOST_LOOKS {
            let above = |b: Option<f64>| b.is_some_and(|b| b > most);
            open.retain(|c| {
                above(self.table.stats[*c].cell_bound())
                    && self.table.stats[*c].bound_cell_look < MOST_LOOKS
            });
            if open.is_empty() || self.late() {
                break;
            }
            let plan_look = |c: &usize| {
                let look = self.table.stats[*c].bound_cell_look + 1;
                (
                    *c,
                    (look, ((LINES + f64::from(look - 1)) / most).ceil() as u64),
                )
            };
            let work: Vec<(usize, (u32, u64))> = open.iter().map(plan_look).collect();
            self.each(&work, |block, s, (cell, (look, lines))| {
                block.join_more(s, *cell, *look, *lines)
            })?;
            self.held = self.inputs.pairs.map_or_else(Vec::new, Pairs::copy);
            self.each(&work, |block, s, (cell, (look, lines))| {
                block.check_cells(s, *cell, *look, *lines)
            })?;
        }
        for cell in self.table.active() {
            self.table.stats[cell].unfinished |=
                self.table.stats[cell].cell_bound().is_none_or(|b| b > most);
        }
        Ok(())
    }

    /// Casts lines from a cell that only join cells.
    fn join_more(
        &self,
        s: &mut Scratch,
        cell: usize,
        look: u32,
        lines: u64,
    ) -> Result<CellStats, TracerError> {
        let Some((pairs, _)) = self.pairs_of(&self.table.cells[cell]) else {
            return Ok(CellStats::default());
        };
        self.cast(s, cell, look, JOIN_MORE, lines, |_, s, packet, lane| {
            let (line, end) = (
                s.packets[packet].ray(lane),
                s.packets[packet].distance[lane],
            );
            pairs.join_line(line, 0.0, end, &mut s.cells.joined);
        })?;
        Ok(CellStats::default())
    }

    /// Casts held-out lines from a cell and counts the lines that cross a cell that is not a pair with this
    /// cell.
    fn check_cells(
        &self,
        s: &mut Scratch,
        cell: usize,
        look: u32,
        lines: u64,
    ) -> Result<CellStats, TracerError> {
        let mut stats = CellStats::default();
        let Some((pairs, slot)) = self.pairs_of(&self.table.cells[cell]) else {
            return Ok(stats);
        };
        let cast = self.cast(s, cell, look, CHECK_CELLS, lines, |_, s, packet, lane| {
            let (line, end) = (
                s.packets[packet].ray(lane),
                s.packets[packet].distance[lane],
            );
            pairs.join_line(line, 0.0, end, &mut s.cells.joined);
            stats.bound_cell_misses += u64::from(pairs.is_new(&self.held, slot, &s.cells.joined));
        })?;
        stats.rays[LineKind::Check as usize] = cast;
        if cast < lines {
            // An incomplete look has no bound.
            return Ok(CellStats {
                rays: stats.rays,
                ..CellStats::default()
            });
        }
        (stats.bound_cell_lines, stats.bound_cell_look) = (lines, look);
        Ok(stats)
    }

    /// Performs look number `look`: casts `lines` held-out lines from every cell.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn look(&mut self, look: u32, lines: u64) -> Result<(), TileError> {
        let all = self.table.active();
        self.look_at(&all, look, lines)
    }

    fn look_at(&mut self, cells: &[usize], look: u32, lines: u64) -> Result<(), TileError> {
        self.held = self.inputs.pairs.map_or_else(Vec::new, Pairs::copy);
        let work: Vec<(usize, u64)> = cells.iter().map(|c| (*c, lines)).collect();
        self.ask_for_device()?;
        if self.is_on_device() {
            self.check_on_device(&work, look)?;
        } else {
            self.each(&work, |block, s, (cell, lines)| {
                block.check(s, *cell, *lines, look)
            })?;
        }
        self.publish();
        Ok(())
    }

    /// Casts `lines` held-out lines from `cell`. Counts the lines that meet a triangle outside the cell's
    /// set, and the lines that cross a cell that is not a pair with this cell.
    fn check(
        &self,
        s: &mut Scratch,
        cell: usize,
        lines: u64,
        look: u32,
    ) -> Result<CellStats, TracerError> {
        let c = self.table.cells[cell];
        let (mut misses, mut cell_misses) = (0, 0);
        let pairs = self.pairs_of(&c);
        let cast = self.cast(s, cell, look, CHECK, lines, |block, s, k, lane| {
            let packet = &s.packets[k];
            if let Some((pairs, slot)) = pairs {
                pairs.join_line(
                    packet.ray(lane),
                    0.0,
                    packet.distance[lane],
                    &mut s.cells.joined,
                );
                cell_misses += u64::from(pairs.is_new(&block.held, slot, &s.cells.joined));
            }
            let end = (packet.triangle[lane], packet.distance[lane]);
            let shown = std::iter::once(end).chain(s.passed.on_at(k, lane));
            let new = shown.filter(|(t, _)| *t != SKY && !block.shown(*t, c.slot));
            let new: Vec<(u32, f32)> = new.collect();
            if !new.is_empty() {
                // Likely items are drawn. The lines that meet them are their witnesses.
                misses += u64::from(new.iter().any(|(t, _)| !block.is_likely(cell, *t)));
                let (origin, direction) = packet.ray(lane);
                for (triangle, at) in new {
                    // A triangle with one side is not seen from beyond it.
                    let to = if block.inputs.sight.is_one_way() {
                        at
                    } else {
                        end.1
                    };
                    let segment = &mut s.cells.segment;
                    block.table.grid.walk(origin, direction, 0.0, to, segment);
                    block.table.only_reached(segment);
                    block.table.credit(triangle, segment);
                }
            }
        })?;
        let mut stats = CellStats::default();
        stats.rays[LineKind::Check as usize] = cast;
        if cast < lines {
            // An incomplete look has no bound.
            return Ok(stats);
        }
        stats.finds[LineKind::Check as usize] = misses;
        (stats.bound_lines, stats.bound_misses, stats.bound_look) = (lines, misses, look);
        if pairs.is_some() {
            (
                stats.bound_cell_lines,
                stats.bound_cell_misses,
                stats.bound_cell_look,
            ) = (lines, cell_misses, look);
        }
        Ok(stats)
    }

    /// Casts `lines` independent lines from `cell`. `test` (the number of the look) and `stream` select the
    /// random numbers.
    ///
    /// Calls `each` with the packet and the lane of each line. Returns the number of lines, which is smaller
    /// if the deadline passes.
    fn cast(
        &self,
        s: &mut Scratch,
        cell: usize,
        test: u32,
        stream: u64,
        lines: u64,
        mut each: impl FnMut(&Self, &mut Scratch, usize, usize),
    ) -> Result<u64, TracerError> {
        let c = self.table.cells[cell];
        let mut random = Hashed::new(&[self.inputs.seed, c.number, u64::from(test), stream]);
        let mut cast = 0;
        while cast < lines && !self.late() {
            let batch = (lines - cast).min(BATCH as u64) as usize;
            // The lines are drawn independently, then sorted so that consecutive lines have similar
            // directions. The order does not affect the counts.
            let side = ((batch as f32 / 96.0).sqrt() as u32).max(1);
            let mut drawn: Vec<(u32, [f32; 6])> = (0..batch)
                .map(|_| {
                    let face = (random.bits() % 6) as u32;
                    let [u, v] = [random.unit(), random.unit()];
                    let [forward, right, up] = face_basis(face);
                    let d = forward + right * (2.0 * u - 1.0) + up * (2.0 * v - 1.0);
                    let o = c.random_origin(self.inputs.region, &mut random);
                    let key =
                        (face * side + (v * side as f32) as u32) * side + (u * side as f32) as u32;
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
            self.inputs
                .sight
                .trace_each(&mut s.packets, &mut s.passed, self.step)?;
            for k in 0..s.packets.len() {
                for lane in 0..s.packets[k].count {
                    each(self, s, k, lane);
                }
            }
            cast += batch as u64;
        }
        Ok(cast)
    }
}
