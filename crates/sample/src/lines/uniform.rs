//! Uniform lines: visibility cubes in which each 4×4 tile of directions has its own origin in the cell.
//!
//! Directions are uniform in the pixels of a cube, as in the error measure. Each direction is traced both
//! ways, so that each line is a maximal free segment. Sixteen directions share an origin, which keeps the
//! packets coherent. A new origin for each tile keeps the samples independent.

use std::time::{Duration, Instant};

use sightline_model::{CellStats, LineKind};
use sightline_trace::TracerError;
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::lines::FLOOD_STEPS;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::{Hashed, spread3};

use super::block::{Block, JOINED_LANES, Scratch};
use super::flood::Find;

/// The names of the streams of random numbers.
const SHIFT: u64 = 1;
const JITTER: u64 = 2;

/// The number of tiles along a face up to which the rays of a tile differ too much for a packet.
const WIDE_TILES: u32 = 4;

impl Block<'_> {
    /// Casts a round of uniform lines from `cell` and floods from the newly found triangles.
    ///
    /// The lines are in `tiles`² tiles on each of three pairs of cube faces.
    pub(super) fn uniform(
        &self,
        s: &mut Scratch,
        cell: usize,
        tiles: u32,
    ) -> Result<CellStats, TracerError> {
        let c = self.table.cells[cell];
        let round = u64::from(self.table.stats[cell].rounds);
        let mut fixed = Hashed::new(&[self.inputs.seed, c.number, SHIFT]);
        let shift = [fixed.unit(), fixed.unit(), fixed.unit()];
        let mut random = Hashed::new(&[self.inputs.seed, c.number, round, JITTER]);
        // Each round continues the sequence of origins of the previous round.
        let base = self.table.stats[cell].rays[LineKind::Uniform as usize] / (2 * LANES as u64);
        let mut stats = CellStats::default();
        s.next_tag();
        let total = 3 * tiles * tiles;
        let pixel = 2.0 / (4 * tiles) as f32;
        let mut finds = Vec::new();
        let (start, mut flooding) = (self.inputs.observer.map(|_| Instant::now()), Duration::ZERO);
        // The number of tiles that are traced before their hits are processed.
        let chunk = (self.inputs.sight.batch() / 2).max(1) as u32;
        for first in (0..total).step_by(chunk as usize) {
            if self.late() {
                break;
            }
            s.packets.clear();
            for k in first..(first + chunk).min(total) {
                let (pair, tile) = (k / (tiles * tiles), k % (tiles * tiles));
                let origin = c.origin(self.inputs.region, spread3(base + u64::from(k), shift));
                let [forward, right, up] = face_basis(pair * 2);
                let mut ahead = Packet::default();
                for lane in 0..LANES as u32 {
                    let x = ((tile % tiles * 4 + lane % 4) as f32 + random.unit()) * pixel - 1.0;
                    let y = ((tile / tiles * 4 + lane / 4) as f32 + random.unit()) * pixel - 1.0;
                    ahead.push(origin, (forward + right * x + up * y).to_array());
                }
                let behind = ahead.reversed(self.step);
                s.packets.push(ahead);
                s.packets.push(behind);
            }
            let coherent = tiles > WIDE_TILES;
            self.inputs
                .sight
                .trace_lines(&mut s.packets, &mut s.passed, self.step, coherent)?;
            finds.clear();
            let Scratch {
                packets,
                passed,
                cells,
                met,
                tag,
                ..
            } = &mut *s;
            for pair in 0..packets.len() / 2 {
                let halves = [2 * pair, 2 * pair + 1];
                let joins = Some(JOINED_LANES);
                self.credit_lines(packets, passed, halves, joins, cells, |lane, ends, _| {
                    let mut meet = |triangle| {
                        if triangle == SKY || self.table.seen(triangle, c.slot) {
                            return;
                        }
                        stats.last_misses += u64::from(!self.shown(triangle, c.slot));
                        let met = &mut met[self.table.row(triangle) as usize];
                        if *met != *tag {
                            *met = *tag;
                            let origin = packets[2 * pair].ray(0).0;
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
            stats.last_rays += (s.packets.len() * LANES) as u64;
            stats.finds[LineKind::Uniform as usize] += finds.len() as u64;
            let before = start.map(|start| start.elapsed());
            self.flood(s, cell, &mut finds, FLOOD_STEPS, &mut random, &mut stats)?;
            flooding += start
                .zip(before)
                .map_or(Duration::ZERO, |(start, before)| start.elapsed() - before);
        }
        stats.rays[LineKind::Uniform as usize] = stats.last_rays;
        if let (Some(observer), Some(start)) = (self.inputs.observer, start) {
            let all = start.elapsed();
            for (kind, time) in [
                (LineKind::Uniform, all - flooding),
                (LineKind::Flood, flooding),
            ] {
                let [rays, finds] = [stats.rays, stats.finds].map(|counts| counts[kind as usize]);
                observer.spent(self.table.stats[cell].rounds, kind, rays, finds, time);
            }
        }
        Ok(stats)
    }
}
