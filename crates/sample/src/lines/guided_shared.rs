//! The strongest published combination of guided rays, as the baseline of the benchmarks.
//!
//! - **Shared segments.** The free segment of a ray credits both its ends to every cell that it crosses
//!   (Bittner et al. 2009, "Adaptive Global Visibility Sampling").
//! - **Border sampling.** A newly found triangle sends a line past each edge, from the other end of the
//!   segment that found it (Wonka et al. 2006, "Guided Visibility Sampling"). If another triangle is next to
//!   the edge and unseen, the line is aimed at it. Failed lines are repeated from changed places.
//! - **Shifted origins.** The neighbours of a cell that newly saw a triangle send lines to the same point.
//! - **Random lines.** At least [`RANDOM`] of the rays are uniform, with stratified origins.
//!
//! Reverse sampling (Koch and Wimmer 2021, "Guided Visibility Sampling++") found no additional triangles
//! together with shared segments, so it is omitted.
//!
//! The rays are cast in rounds, which are small at first. Decisions read the table of the last barrier and
//! the triangles that the cell's own lines found since then, so that the result does not depend on threads.
//! The queues are not exchanged, so one process computes the whole block.

use glam::Vec3;
use rayon::prelude::*;
use sightline_model::{CellStats, LineKind};
use sightline_scene::TriangleId;
use sightline_trace::TracerError;
use sightline_trace::cube::SKY;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::{Hashed, spread3};
use sightline_trace::surface::point_on;

use super::block::{Block, Scratch};
use super::frontier::{FreeSegment, Frontier, NewTriangle};
use super::seeds::on_sphere;
use crate::context::TileError;

/// The number of rays of a cell in the first round, and its growth from round to round.
const FIRST: f64 = 64.0;
const GROWTH: f64 = 1.5;
/// The number of groups of cells of a round. A group reads the table after the groups before it. With more
/// groups, fewer triangles are found twice; with fewer groups, more threads have work.
const GROUPS: usize = 7;
/// The fraction of random rays, unless more rays follow newly found triangles.
const RANDOM: f64 = 0.3;
/// The number of random lines, and of triangles that are followed, per step.
const RANDOM_LINES: u64 = 32;
const FOLLOWED: usize = 64;
/// The distance of a border ray from its edge, as a fraction of the edge.
const BORDER: f32 = 0.01;
/// The numbers of scales, halved from a cell's size, of the places of shifts and of repeated attempts.
const SHIFT_SCALES: f32 = 6.0;
const RETRY_SCALES: f32 = 10.0;
/// The minimum distance of a shift from the face, as a fraction of its scale.
const LEAST_SHIFT: f32 = 0.02;
/// The names of the streams of random numbers.
const GUIDED_SHARED: u64 = 14;
const ORIGINS: u64 = 15;

/// The lines of a step, by kind.
#[derive(Default)]
struct AimedLines {
    /// Lines past the edges of newly found triangles.
    past: Vec<Packet>,
    /// Lines from the neighbours of cells that newly saw a triangle.
    shifts: Vec<Packet>,
}

/// Appends a ray to packets, unless its direction has no length.
fn push(packets: &mut Vec<Packet>, origin: Vec3, direction: Vec3) {
    let is_ray = direction.length_squared() > 0.0 && direction.is_finite() && origin.is_finite();
    if !is_ray {
        return;
    }
    if packets.last().is_none_or(|packet| packet.count == LANES) {
        packets.push(Packet::default());
    }
    if let Some(last) = packets.last_mut() {
        last.push(origin.to_array(), direction.to_array());
    }
}

fn count(packets: &[Packet]) -> u64 {
    packets.iter().map(|packet| packet.count as u64).sum()
}

impl Block<'_> {
    /// Casts about `rays` rays from each cell, and credits every cell that their free segments cross.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn sample_guided_shared(&mut self, rays: u64) -> Result<(), TileError> {
        let active = self.table.active();
        let mut frontiers: Vec<Frontier> = Vec::new();
        frontiers.resize_with(active.len(), Frontier::default);
        let (mut cast, mut size) = (0, FIRST);
        while cast < rays && !self.late() {
            let next = (size as u64).min(rays - cast);
            for group in 0..GROUPS {
                let this = &*self;
                let cells = active.par_iter().zip(&mut frontiers).skip(group);
                let done: Result<Vec<(usize, CellStats)>, TileError> = cells
                    .step_by(GROUPS)
                    .map(|(cell, frontier)| {
                        let stats =
                            this.with_scratch(|s| this.guided_round(s, frontier, *cell, next))?;
                        if this.inputs.watcher.cancelled() {
                            return Err(TileError::Cancelled);
                        }
                        this.inputs.watcher.rendered(stats.rays.iter().sum());
                        Ok((*cell, stats))
                    })
                    .collect();
                done?
                    .iter()
                    .for_each(|(cell, stats)| self.count(*cell, stats));
                self.publish();
            }
            if self.late() {
                break;
            }
            (cast, size) = (cast + next, size * GROWTH);
        }
        for cell in active {
            self.table.stats[cell].unfinished = cast < rays;
        }
        self.count_done(self.table.cells.len());
        Ok(())
    }

    /// Casts about `size` rays from a cell, of which at least the fraction [`RANDOM`] are random.
    fn guided_round(
        &self,
        s: &mut Scratch,
        frontier: &mut Frontier,
        cell: usize,
        size: u64,
    ) -> Result<CellStats, TracerError> {
        let number = self.table.cells[cell].number;
        let before: u64 = self.table.stats[cell].rays.iter().sum();
        let mut random = Hashed::new(&[self.inputs.seed, number, before, GUIDED_SHARED]);
        let mut stats = CellStats::default();
        frontier.forget_added();
        loop {
            let all: u64 = stats.rays.iter().sum();
            if all >= size || self.late() || self.inputs.watcher.cancelled() {
                break;
            }
            let of_random = stats.rays[LineKind::Uniform as usize] as f64;
            if frontier.is_empty() || of_random < RANDOM * all as f64 {
                self.random_lines(s, frontier, cell, &mut random, &mut stats)?;
            } else {
                self.follow(s, frontier, &mut random, &mut stats)?;
            }
        }
        Ok(stats)
    }

    fn random_lines(
        &self,
        s: &mut Scratch,
        frontier: &mut Frontier,
        cell: usize,
        random: &mut Hashed,
        stats: &mut CellStats,
    ) -> Result<(), TracerError> {
        let c = self.table.cells[cell];
        let mut fixed = Hashed::new(&[self.inputs.seed, c.number, ORIGINS]);
        let shift = [fixed.unit(), fixed.unit(), fixed.unit()];
        let uniform = LineKind::Uniform as usize;
        let first = (self.table.stats[cell].rays[uniform] + stats.rays[uniform]) / 2;
        let mut lines = Vec::new();
        for number in first..first + RANDOM_LINES {
            let origin = c.origin(self.inputs.region, spread3(number, shift));
            push(&mut lines, origin.into(), on_sphere(random));
        }
        let found = self.cast_lines(s, frontier, &lines, true)?;
        stats.rays[uniform] += 2 * count(&lines);
        stats.finds[uniform] += found;
        Ok(())
    }

    /// Follows the next new triangles: casts lines past their edges, and shifts.
    fn follow(
        &self,
        s: &mut Scratch,
        frontier: &mut Frontier,
        random: &mut Hashed,
        stats: &mut CellStats,
    ) -> Result<(), TracerError> {
        let mut aimed = AimedLines::default();
        for _ in 0..FOLLOWED {
            let Some((tries, new)) = frontier.pop() else {
                break;
            };
            let is_aimed = self.aim_past_edges(frontier, &new, tries, random, &mut aimed.past);
            if tries == 0 && new.shifts {
                self.aim_shifts(frontier, &new, random, &mut aimed.shifts);
            }
            if is_aimed {
                frontier.queue(tries + 1, new);
            }
        }
        let (flood, candidate) = (LineKind::Flood as usize, LineKind::Candidate as usize);
        stats.rays[flood] += 2 * count(&aimed.past);
        stats.finds[flood] += self.cast_lines(s, frontier, &aimed.past, false)?;
        stats.rays[candidate] += 2 * count(&aimed.shifts);
        stats.finds[candidate] += self.cast_lines(s, frontier, &aimed.shifts, true)?;
        Ok(())
    }

    /// Aims past each edge of a new triangle whose neighbour is new to a cell that the segment crosses.
    /// Returns true if the triangle has such an edge.
    fn aim_past_edges(
        &self,
        frontier: &Frontier,
        new: &NewTriangle,
        tries: usize,
        random: &mut Hashed,
        lines: &mut Vec<Packet>,
    ) -> bool {
        let v = self.inputs.scene.triangles()[new.triangle as usize].v;
        let segment = new.hit - new.other;
        let mut is_aimed = false;
        for (edge, next) in self.inputs.surface.neighbours[new.triangle as usize]
            .into_iter()
            .enumerate()
        {
            let target = match next {
                SKY if tries > 0 => continue,
                SKY => {
                    let [a, b, c] = [v[edge], v[(edge + 1) % 3], v[(edge + 2) % 3]];
                    let inwards = c - (a + b) * 0.5;
                    a + (b - a) * random.unit() - inwards * BORDER
                }
                next => {
                    let row = self.table.row(next);
                    let is_new = new.cells().iter().any(|(word, bits)| {
                        frontier.new_bits(self.table.bits.row(row), row, *word, *bits) != 0
                    });
                    if !is_new {
                        continue;
                    }
                    is_aimed = true;
                    Vec3::from(point_on(self.inputs.scene, TriangleId(next), random))
                }
            };
            // The first attempt starts where the segment starts, so it crosses nearly the same cells.
            let eye = match tries {
                0 => match new.start() {
                    Some(start) => start,
                    None => continue,
                },
                _ => {
                    let at = self.table.grid.cell_in(new.new_cell());
                    let (lo, size) = self.table.grid.cell_box(at);
                    let place = new.other + segment * random.unit();
                    let scale = 0.5f32.powi((random.unit() * RETRY_SCALES) as i32);
                    let moved = place + size * scale * (random.point() - 0.5);
                    moved.clamp(lo, lo + size)
                }
            };
            if self.inputs.region.is_none_or(|region| region.hold(eye)) {
                push(lines, eye, target - eye);
            }
        }
        is_aimed
    }

    /// Aims at the place of a new triangle from the neighbours of a cell that newly saw it. The origin is a
    /// point of the segment in this cell, moved across the face.
    fn aim_shifts(
        &self,
        frontier: &Frontier,
        new: &NewTriangle,
        random: &mut Hashed,
        lines: &mut Vec<Packet>,
    ) {
        let at = self.table.grid.cell_in(new.new_cell());
        let (lo, size) = self.table.grid.cell_box(at);
        let row = self.table.row(new.triangle);
        for face in 0..6 {
            let Some(beyond) = self.beyond(at, face) else {
                continue;
            };
            let (word, bit) = (beyond.word, 1 << beyond.bit);
            let is_new = frontier.new_bits(self.table.bits.row(row), row, word, bit) != 0;
            if !is_new || !self.table.has_viewpoints(beyond) {
                continue;
            }
            let axis = face / 2;
            let mut eye = new.point_in(lo, size, random.unit());
            let scale = 0.5f32.powi((random.unit() * SHIFT_SCALES) as i32);
            let depth = size[axis] * scale * (LEAST_SHIFT + (1.0 - LEAST_SHIFT) * random.unit());
            eye[axis] = match face.is_multiple_of(2) {
                true => lo[axis] + size[axis] + depth,
                false => lo[axis] - depth,
            };
            if self.inputs.region.is_none_or(|region| region.hold(eye)) {
                push(lines, eye, new.hit - eye);
            }
        }
    }

    /// Casts lines in both directions, credits all cells that they cross, and queues new triangles. Returns
    /// their number.
    fn cast_lines(
        &self,
        s: &mut Scratch,
        frontier: &mut Frontier,
        lines: &[Packet],
        shifts: bool,
    ) -> Result<u64, TracerError> {
        s.packets.clear();
        for line in lines {
            s.packets.push(line.clone());
            s.packets.push(line.reversed(self.step));
        }
        self.inputs
            .sight
            .trace_lines(&mut s.packets, &mut s.passed, self.step, false)?;
        let mut found = 0;
        let Scratch {
            packets,
            passed,
            cells,
            ..
        } = &mut *s;
        for pair in 0..lines.len() {
            let halves = [2 * pair, 2 * pair + 1];
            let [ahead, behind] = halves.map(|k| &packets[k]);
            self.credit_lines(
                packets,
                passed,
                halves,
                None,
                cells,
                |lane, ends, crossed| {
                    let (origin, direction) = ahead.ray(lane);
                    let (from, to) = ahead.free(behind, lane, self.step);
                    let segment = FreeSegment {
                        origin: origin.into(),
                        direction: direction.into(),
                        from,
                        to,
                    };
                    for (triangle, is_ahead) in ends.into_iter().zip([true, false]) {
                        let new =
                            self.new_triangle(frontier, &segment, is_ahead, triangle, crossed);
                        if let Some(new) = new {
                            frontier.queue(0, NewTriangle { shifts, ..new });
                            found += 1;
                        }
                    }
                },
            );
        }
        Ok(found)
    }

    /// Returns the triangle at an end of a segment if it is new to a crossed cell.
    fn new_triangle(
        &self,
        frontier: &mut Frontier,
        segment: &FreeSegment,
        is_ahead: bool,
        triangle: u32,
        crossed: &[(u32, u64)],
    ) -> Option<NewTriangle> {
        if triangle == SKY {
            return None;
        }
        let row = self.table.row(triangle);
        let cells = frontier.add(self.table.bits.row(row), row, crossed)?;
        let (lo, hi) = self.table.grid.bounds();
        let new = NewTriangle::new(segment, is_ahead, triangle, [lo, hi], cells);
        Some(new)
    }
}
