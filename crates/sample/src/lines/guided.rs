//! Guided rays for each cell separately: a second baseline of the benchmarks in addition to
//! [`super::guided_shared`], and the sampler `guided` if lines end at a distance or some triangles have one
//! side.
//!
//! Each cell has a fixed number of rays. Half are aimed at unseen triangles adjacent to seen triangles
//! (across an edge, or close by), a quarter at random unseen triangles, and a quarter have random directions.
//! Cells do not share rays, and every ray is traced separately.

use glam::Vec3;
use sightline_model::{CellStats, LineKind};
use sightline_scene::TriangleId;
use sightline_trace::TracerError;
use sightline_trace::cube::SKY;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::surface::point_on;

use super::block::{Block, Scratch};
use super::seeds::on_sphere;
use crate::context::TileError;

/// The number of rays cast between two updates of the list of unseen neighbours.
const BATCH: u64 = 1024;
/// Maximum number of draws of a random unseen triangle before a random direction is used instead.
const DRAWS: u32 = 8;
/// The name of the stream of random numbers.
const GUIDED: u64 = 6;

impl Block<'_> {
    /// Casts `rays` rays from each cell.
    ///
    /// # Errors
    /// The errors of [`Block::sample`].
    pub fn sample_guided(&mut self, rays: u64) -> Result<(), TileError> {
        let work: Vec<(usize, u64)> = self.table.active().into_iter().map(|c| (c, rays)).collect();
        self.each(&work, |block, s, (cell, rays)| {
            block.guided(s, *cell, *rays)
        })?;
        for cell in self.table.active() {
            let stats = &mut self.table.stats[cell];
            stats.unfinished = stats.rays[LineKind::Uniform as usize] < rays;
        }
        self.publish();
        self.count_done(self.table.cells.len());
        Ok(())
    }

    fn guided(&self, s: &mut Scratch, cell: usize, rays: u64) -> Result<CellStats, TracerError> {
        let c = self.table.cells[cell];
        let mut random = Hashed::new(&[self.inputs.seed, c.number, GUIDED]);
        let all = &self.inputs.surface.morton;
        let mut stats = CellStats::default();
        s.next_tag();
        // Unseen triangles next to seen triangles. Some have been seen in the meantime.
        let mut border: Vec<u32> = Vec::new();
        let mut cast = 0;
        while cast < rays && !self.late() && !self.inputs.watcher.cancelled() {
            let batch = BATCH.min(rays - cast);
            s.packets.clear();
            for first in (0..batch).step_by(LANES) {
                let mut packet = Packet::default();
                for _ in first..batch.min(first + LANES as u64) {
                    let origin = c.random_origin(self.inputs.region, &mut random);
                    let kind = random.unit();
                    let mut target = None;
                    if kind < 0.5 {
                        for _ in 0..DRAWS {
                            if border.is_empty() {
                                break;
                            }
                            let i = (random.bits() % border.len() as u64) as usize;
                            if s.met[self.table.row(border[i]) as usize] == s.tag {
                                border.swap_remove(i);
                            } else {
                                target = Some(border[i]);
                                break;
                            }
                        }
                    }
                    if target.is_none() && kind < 0.75 && !all.is_empty() {
                        target = (0..DRAWS)
                            .map(|_| all[(random.bits() % all.len() as u64) as usize])
                            .find(|t| s.met[self.table.row(*t) as usize] != s.tag);
                    }
                    let direction = match target {
                        Some(t) => {
                            Vec3::from(point_on(self.inputs.scene, TriangleId(t), &mut random))
                                - Vec3::from(origin)
                        }
                        None => on_sphere(&mut random),
                    };
                    packet.push(origin, direction.to_array());
                }
                s.packets.push(packet);
            }
            self.inputs
                .sight
                .trace_each(&mut s.packets, &mut s.passed, self.step)?;
            cast += batch;
            for (k, packet) in s.packets.iter().enumerate() {
                let ends = (0..packet.count)
                    .flat_map(|l| std::iter::once(packet.triangle[l]).chain(s.passed.on(k, l)));
                for triangle in ends {
                    if triangle == SKY || s.met[self.table.row(triangle) as usize] == s.tag {
                        continue;
                    }
                    s.met[self.table.row(triangle) as usize] = s.tag;
                    self.table
                        .credit(triangle, &[(c.slot.word, 1 << c.slot.bit)]);
                    stats.finds[LineKind::Uniform as usize] += 1;
                    let next = self.inputs.surface.neighbours[triangle as usize];
                    let unmet =
                        |n: &&u32| **n != SKY && s.met[self.table.row(**n) as usize] != s.tag;
                    border.extend(next.iter().filter(unmet));
                }
            }
        }
        stats.rays[LineKind::Uniform as usize] = cast;
        Ok(stats)
    }
}
