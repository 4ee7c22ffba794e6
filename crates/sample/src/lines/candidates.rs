//! The candidates of a cell: triangles that a neighbouring cell sees and this cell does not.
//!
//! A candidate is adjacent to a triangle that this cell sees, and large enough as seen from the cell. If
//! items are clusters or objects, candidates are triangles of an item that this cell does not see, adjacent
//! to a seen triangle or not.
//!
//! Sixteen nearby candidates share an origin close to the face through which the neighbours see them: a point
//! of that face belongs to both cells. Each line is traced in both directions. The sampler then aims from the
//! same origin at the neighbours of the triangles that such lines find ([`super::flood`]).

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use glam::Vec3;
use rayon::prelude::*;
use sightline_model::{CellStats, LineKind};
use sightline_scene::TriangleId;
use sightline_trace::TracerError;
use sightline_trace::cube::SKY;
use sightline_trace::lines::grid::Slot;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::surface::point_on;

use super::block::{Block, JOINED_AIMED_LANES, Scratch};
use super::flood::Find;
use super::observer::Attempt;
use crate::context::TileError;

/// The number of triangles that a thread examines at a time.
const STRIPE: usize = 4096;
/// Maximum distance of an origin from its face, as a fraction of the cell's size.
const DEPTH: f32 = 0.1;
/// Minimum cosine in a triangle's solid angle: a triangle seen edge-on from the cell's centre may face
/// another point of the cell.
const LEAST_FACING: f32 = 0.25;
/// Maximum number of candidates of an item per round, unless items are triangles.
const TRIES_OF_ITEM: usize = 8;
/// The name of the stream of random numbers.
const AIM: u64 = 3;

/// A triangle to aim at.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub(super) triangle: u32,
    /// The fraction of the sphere around the cell's centre that the triangle would cover.
    pub(super) part: f32,
}

/// The lines that a cell aims in a round.
struct Aiming {
    cell: usize,
    round: u32,
    random: Hashed,
    stats: CellStats,
    /// The time of the floods, if an observer records it.
    flooding: Duration,
}

impl Block<'_> {
    /// Aims from each cell of `open` at the candidates that cover at least the fraction `least` of the
    /// sphere.
    pub(super) fn aim_at_candidates(
        &mut self,
        open: &[usize],
        least: &[f64],
        round: u32,
    ) -> Result<(), TileError> {
        // Members of the crew that compute no cell of the round need no candidates.
        let lists: OnceLock<Vec<Vec<Candidate>>> = OnceLock::new();
        let list = |item: usize| lists.get().map_or(&[][..], |lists| &lists[item]);
        self.each_prepared(
            open,
            &|block| drop(lists.set(block.candidates(open, least))),
            &|item| 1 + list(item).len() as u64,
            &|block, scratch, item| block.aim(scratch, open[item], list(item), round),
        )
    }

    /// Finds the candidates of each cell of `open`, in Morton order. A candidate covers at least the fraction
    /// `least` of the sphere around the cell's centre.
    pub(super) fn candidates(&self, open: &[usize], least: &[f64]) -> Vec<Vec<Candidate>> {
        let words = self.table.grid.words();
        let mut wanted = vec![0u64; words];
        let mut place = vec![u32::MAX; words * 64];
        for (i, cell) in open.iter().enumerate() {
            let slot = self.table.cells[*cell].slot;
            wanted[slot.word as usize] |= 1 << slot.bit;
            place[slot.index()] = i as u32;
        }
        let is_finer = self.inputs.rows.are_finer();
        let stripes: Vec<Vec<(u32, Candidate)>> = self
            .inputs
            .surface
            .morton
            .par_chunks(STRIPE)
            .map(|stripe| {
                let mut found = Vec::new();
                let mut near = vec![0u64; words];
                for &triangle in stripe {
                    let row = self.table.bits.row(self.table.row(triangle));
                    if row.iter().all(|w| *w == 0) {
                        continue;
                    }
                    let seen = if is_finer {
                        // The cells that lack the item. Below, a neighbour must see the triangle.
                        near.fill(u64::MAX);
                        self.table
                            .items
                            .row(self.inputs.rows.item(TriangleId(triangle)))
                    } else {
                        // The cells that see a neighbour of the triangle and not the triangle itself: mostly
                        // none.
                        near.fill(0);
                        for beside in self.inputs.surface.neighbours[triangle as usize] {
                            if beside != SKY {
                                near.iter_mut()
                                    .zip(self.table.bits.row(self.table.row(beside)))
                                    .for_each(|(n, seen)| *n |= seen);
                            }
                        }
                        row
                    };
                    let mut any = 0;
                    for ((n, seen), w) in near.iter_mut().zip(seen).zip(&wanted) {
                        *n &= w & !seen;
                        any |= *n;
                    }
                    if any == 0 {
                        continue;
                    }
                    any = 0;
                    for (word, n) in near.iter_mut().enumerate().filter(|(_, n)| **n != 0) {
                        *n &= self.table.grid.dilated(row, word);
                        any |= *n;
                    }
                    if any == 0 {
                        continue;
                    }
                    let v = self.inputs.scene.triangles()[triangle as usize].v;
                    let area = (v[1] - v[0]).cross(v[2] - v[0]) * 0.5;
                    let (centre, size) = ((v[0] + v[1] + v[2]) / 3.0, area.length());
                    for (word, bits) in near.iter().enumerate() {
                        let mut rest = *bits;
                        while rest != 0 {
                            let index = word * 64 + rest.trailing_zeros() as usize;
                            rest &= rest - 1;
                            let i = place[index] as usize;
                            let cell = &self.table.cells[open[i]];
                            let to = cell.lo + cell.size * 0.5 - centre;
                            // In the cell's own extent, the distance from the cell's centre has no meaning.
                            let far = to.length_squared().max(cell.size.length_squared() / 12.0);
                            let facing = (to.dot(area).abs() / far.sqrt()).max(LEAST_FACING * size);
                            let part = facing / far / (4.0 * std::f32::consts::PI);
                            if f64::from(part) >= least[i] {
                                found.push((i as u32, Candidate { triangle, part }));
                            }
                        }
                    }
                }
                found
            })
            .collect();
        let mut lists = vec![Vec::new(); open.len()];
        for (i, candidate) in stripes.into_iter().flatten() {
            lists[i as usize].push(candidate);
        }
        if !self.inputs.rows.of_triangles().is_empty() {
            lists
                .par_iter_mut()
                .for_each(|list| self.largest_of_each(list));
        }
        lists
    }

    /// Keeps only the largest few candidates of each item, in the same order.
    fn largest_of_each(&self, list: &mut Vec<Candidate>) {
        let mut order: Vec<u32> = (0..list.len() as u32).collect();
        let candidate_at = |i: &u32| &list[*i as usize];
        order.sort_by(|a, b| {
            let (a, b) = (candidate_at(a), candidate_at(b));
            self.table
                .row(a.triangle)
                .cmp(&self.table.row(b.triangle))
                .then(b.part.total_cmp(&a.part))
        });
        let mut kept: Vec<u32> = Vec::new();
        for item in order.chunk_by(|a, b| {
            self.table.row(candidate_at(a).triangle) == self.table.row(candidate_at(b).triangle)
        }) {
            kept.extend(item.iter().take(TRIES_OF_ITEM));
        }
        kept.sort_unstable();
        *list = kept.iter().map(|i| list[*i as usize]).collect();
    }

    /// Aims from `cell` at each candidate of `list`, [`YieldTable::times`] times but at least once, until a
    /// line meets it.
    ///
    /// [`YieldTable::times`]: super::yields::YieldTable::times
    pub(super) fn aim(
        &self,
        s: &mut Scratch,
        cell: usize,
        list: &[Candidate],
        round: u32,
    ) -> Result<CellStats, TracerError> {
        let start = self
            .inputs
            .observer
            .map(|observer| (observer, Instant::now()));
        let rays = self.table.stats[cell].rays[LineKind::Candidate as usize];
        let number = self.table.cells[cell].number;
        let random = Hashed::new(&[self.inputs.seed, number, u64::from(round), rays, AIM]);
        let mut aiming = Aiming {
            cell,
            round,
            random,
            stats: CellStats::default(),
            flooding: Duration::ZERO,
        };
        self.aim_at_all(s, &mut aiming, list)?;
        let Aiming {
            stats, flooding, ..
        } = aiming;
        if let Some((observer, start)) = start {
            let all = start.elapsed();
            for (kind, time) in [
                (LineKind::Candidate, all - flooding),
                (LineKind::Flood, flooding),
            ] {
                let [rays, finds] = [stats.rays, stats.finds].map(|counts| counts[kind as usize]);
                observer.spent(round, kind, rays, finds, time);
            }
        }
        Ok(stats)
    }

    fn aim_at_all(
        &self,
        s: &mut Scratch,
        aiming: &mut Aiming,
        list: &[Candidate],
    ) -> Result<(), TracerError> {
        s.next_tag();
        let chunk = (self.inputs.sight.batch() / 2).max(1);
        let mut wanted = list.to_vec();
        for time in 0.. {
            if time > 0 {
                wanted.retain(|candidate| {
                    let more = self.yields.times(candidate.part) - f64::from(time);
                    self.is_unmet(s, candidate) && more > f64::from(aiming.random.unit())
                });
            }
            if wanted.is_empty() {
                break;
            }
            for some in wanted.chunks(LANES * chunk) {
                if self.late() {
                    return Ok(());
                }
                // An earlier line may have met the candidate.
                let unmet = |c: &&Candidate| self.is_unmet(s, c);
                let some: Vec<Candidate> = some.iter().filter(unmet).copied().collect();
                self.try_some(s, aiming, &some, time)?;
            }
        }
        Ok(())
    }

    /// Returns true if no line of this aiming has met the item of a candidate.
    fn is_unmet(&self, s: &Scratch, candidate: &Candidate) -> bool {
        match self.inputs.rows.are_finer() {
            true => {
                s.met_items[self.inputs.rows.item(TriangleId(candidate.triangle)) as usize] != s.tag
            }
            false => s.met[self.table.row(candidate.triangle) as usize] != s.tag,
        }
    }

    /// Makes attempt number `time` at each of `some`, and floods from the triangles that the lines find.
    fn try_some(
        &self,
        s: &mut Scratch,
        aiming: &mut Aiming,
        some: &[Candidate],
        time: u32,
    ) -> Result<(), TracerError> {
        let Aiming {
            cell,
            round,
            random,
            stats,
            flooding,
        } = aiming;
        let (cell, round) = (*cell, *round);
        let c = self.table.cells[cell];
        let uniform = self.table.stats[cell].rays[LineKind::Uniform as usize];
        s.packets.clear();
        for group in some.chunks(LANES) {
            let origin = c.origin(self.inputs.region, self.eye_for(cell, group, random));
            let mut ahead = Packet::default();
            for candidate in group {
                let to = Vec3::from(point_on(
                    self.inputs.scene,
                    TriangleId(candidate.triangle),
                    random,
                ));
                ahead.push(origin, (to - Vec3::from(origin)).to_array());
            }
            let behind = ahead.reversed(self.step);
            s.packets.push(ahead);
            s.packets.push(behind);
        }
        // The directions to sixteen nearby candidates still differ too much for a packet.
        self.inputs
            .sight
            .trace_lines(&mut s.packets, &mut s.passed, self.step, false)?;
        let Scratch {
            packets,
            passed,
            cells,
            met,
            met_items,
            tag,
            tally,
            ..
        } = &mut *s;
        let mut finds = Vec::new();
        for (pair, group) in some.chunks(LANES).enumerate() {
            let halves = [2 * pair, 2 * pair + 1];
            let ahead = &packets[halves[0]];
            let origin = ahead.ray(0).0;
            stats.rays[LineKind::Candidate as usize] += 2 * ahead.count as u64;
            let joins = Some(JOINED_AIMED_LANES);
            self.credit_lines(packets, passed, halves, joins, cells, |lane, ends, _| {
                let candidate = &group[lane];
                let found = ahead.triangle[lane] == candidate.triangle
                    || !passed.is_empty()
                        && passed.on(halves[0], lane).any(|t| t == candidate.triangle);
                self.yields
                    .count(tally, candidate.part, time, uniform, found);
                if let Some(observer) = self
                    .inputs
                    .observer
                    .filter(|observer| observer.wants_attempts())
                {
                    observer.attempted(round, self.account(cell, candidate, time, found));
                }
                let mut meet = |triangle| {
                    if triangle == SKY {
                        return;
                    }
                    let row = self.table.row(triangle);
                    if self.inputs.rows.are_finer() {
                        met_items[self.inputs.rows.item(TriangleId(triangle)) as usize] = *tag;
                    }
                    if !self.table.bits.seen(row, c.slot) && met[row as usize] != *tag {
                        met[row as usize] = *tag;
                        finds.push(Find {
                            packet: pair as u32,
                            origin,
                            triangle,
                        });
                    }
                };
                ends.into_iter().for_each(&mut meet);
                passed.each_on_both(halves, lane, meet);
            });
        }
        stats.finds[LineKind::Candidate as usize] += finds.len() as u64;
        let start = self.inputs.observer.map(|_| Instant::now());
        self.flood(s, cell, &mut finds, self.flood_steps, random, stats)?;
        *flooding += start.map_or(Duration::ZERO, |start| start.elapsed());
        Ok(())
    }

    /// Returns the record of an attempt for an observer.
    fn account(&self, cell: usize, candidate: &Candidate, time: u32, found: bool) -> Attempt {
        let Candidate { triangle, part } = *candidate;
        Attempt {
            cell,
            triangle: TriangleId(triangle),
            part,
            time,
            faces: self.faces_that_show(cell, triangle),
            beside: self.seen_neighbours(cell, triangle),
            found,
        }
    }

    /// Returns the number of faces of a cell beyond which a cell sees the triangle.
    pub(super) fn faces_that_show(&self, cell: usize, triangle: u32) -> u32 {
        let at = self.table.cells[cell].at;
        let faces = (0..6).filter(|face| {
            let beyond = self.beyond(at, *face);
            beyond.is_some_and(|slot| self.table.seen(triangle, slot))
        });
        faces.count() as u32
    }

    /// Returns the number of neighbours of the triangle that a cell sees.
    pub(super) fn seen_neighbours(&self, cell: usize, triangle: u32) -> u32 {
        let slot = self.table.cells[cell].slot;
        let neighbours = self.inputs.surface.neighbours[triangle as usize].iter();
        let seen = neighbours.filter(|t| **t != SKY && self.table.seen(**t, slot));
        seen.count() as u32
    }

    /// Returns the cell beyond a face: along axis `face / 2`, in positive direction if `face` is even.
    pub(super) fn beyond(&self, at: [u32; 3], face: usize) -> Option<Slot> {
        let mut next = at;
        next[face / 2] = if face.is_multiple_of(2) {
            at[face / 2] + 1
        } else {
            at[face / 2].wrapping_sub(1)
        };
        self.table
            .grid
            .has(next)
            .then(|| self.table.grid.slot(next))
    }

    /// Returns the origin of a group's lines, in fractions of the cell.
    ///
    /// The origin is close to a face through which neighbours see the group. The face is drawn with weights:
    /// the numbers of candidates that the neighbours see.
    fn eye_for(&self, cell: usize, group: &[Candidate], random: &mut Hashed) -> [f32; 3] {
        let at = self.table.cells[cell].at;
        let mut eye = random.point().to_array();
        if !self.table.cells[cell].is_whole() {
            // The viewpoints of such a cell need not reach its faces.
            return eye;
        }
        let mut votes = [0u32; 6];
        for (face, vote) in votes.iter_mut().enumerate() {
            if let Some(slot) = self.beyond(at, face) {
                *vote = group
                    .iter()
                    .filter(|t| self.table.seen(t.triangle, slot))
                    .count() as u32;
            }
        }
        let mut pick = (random.unit() * votes.iter().sum::<u32>() as f32) as u32;
        for (face, vote) in votes.into_iter().enumerate() {
            if pick < vote {
                let depth = eye[face / 2] * DEPTH;
                eye[face / 2] = if face % 2 == 0 { 1.0 - depth } else { depth };
                break;
            }
            pick -= vote;
        }
        eye
    }
}
