//! Flooding: aiming from the origin that saw a new triangle at the triangle's neighbours that the cell has
//! not seen. Neighbours are the triangles across its edges, or close by if an edge has no other triangle.
//!
//! A point that sees one triangle of a surface mostly also sees the next one. In experiments, other origins
//! in the cell found far fewer triangles. Each line is traced in both directions, so the triangles behind the
//! origin are also credited.

use sightline_model::{CellStats, LineKind};
use sightline_scene::TriangleId;
use sightline_trace::TracerError;
use sightline_trace::cube::SKY;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::surface::point_on;

use super::block::{Block, JOINED_AIMED_LANES, Scratch};

/// A triangle that is new to the cell, and the origin that saw it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Find {
    /// The number of the packet of the line. The lines of a packet have one origin.
    pub(super) packet: u32,
    pub(super) origin: [f32; 3],
    pub(super) triangle: u32,
}

/// A packet aimed at triangles.
struct Aimed {
    packet: Packet,
    /// The number of the packet whose newly found triangles have the same origin.
    eye: u32,
    targets: [u32; LANES],
}

impl Block<'_> {
    /// Floods from `finds` in at most `steps` steps, and replaces `finds` by the triangles of the last step.
    pub(super) fn flood(
        &self,
        s: &mut Scratch,
        cell: usize,
        finds: &mut Vec<Find>,
        steps: u32,
        random: &mut Hashed,
        stats: &mut CellStats,
    ) -> Result<(), TracerError> {
        let slot = self.table.cells[cell].slot;
        for _ in 0..steps {
            let mut aimed: Vec<Aimed> = Vec::new();
            for find in finds.iter() {
                for next in self.inputs.surface.neighbours[find.triangle as usize] {
                    if next == SKY {
                        continue;
                    }
                    let row = self.table.row(next);
                    if s.met[row as usize] == s.tag || self.table.bits.seen(row, slot) {
                        continue;
                    }
                    s.met[row as usize] = s.tag;
                    let eye = find.origin;
                    let full = aimed
                        .last()
                        .is_none_or(|a| a.eye != find.packet || a.packet.count == LANES);
                    if full {
                        let packet = Packet::default();
                        aimed.push(Aimed {
                            packet,
                            eye: find.packet,
                            targets: [SKY; LANES],
                        });
                    }
                    let Some(last) = aimed.last_mut() else {
                        continue;
                    };
                    last.targets[last.packet.count] = next;
                    let to = point_on(self.inputs.scene, TriangleId(next), random);
                    last.packet.push(eye, [0, 1, 2].map(|a| to[a] - eye[a]));
                }
            }
            if aimed.is_empty() {
                break;
            }
            s.behind.clear();
            for a in &aimed {
                s.behind.push(a.packet.clone());
                s.behind.push(a.packet.reversed(self.step));
            }
            self.inputs
                .sight
                .trace_lines(&mut s.behind, &mut s.passed, self.step, false)?;
            finds.clear();
            let Scratch {
                behind: traced,
                passed,
                cells,
                met,
                tag,
                ..
            } = &mut *s;
            for (k, a) in aimed.iter().enumerate() {
                let halves = [2 * k, 2 * k + 1];
                let ahead = &traced[halves[0]];
                stats.rays[LineKind::Flood as usize] += 2 * ahead.count as u64;
                let joins = Some(JOINED_AIMED_LANES);
                self.credit_lines(traced, passed, halves, joins, cells, |lane, ends, _| {
                    let (end, target) = (ends[0], a.targets[lane]);
                    let found = end == target || passed.on(halves[0], lane).any(|t| t == target);
                    if !found {
                        // Another triangle obstructs the target; from another origin it may be visible.
                        met[self.table.row(target) as usize] = 0;
                    }
                    let origin = ahead.ray(lane).0;
                    let mut meet = |hit| {
                        if hit == SKY {
                            return;
                        }
                        let row = self.table.row(hit);
                        if !self.table.bits.seen(row, slot)
                            && (hit == target || met[row as usize] != *tag)
                        {
                            met[row as usize] = *tag;
                            finds.push(Find {
                                packet: a.eye,
                                origin,
                                triangle: hit,
                            });
                        }
                    };
                    meet(end);
                    if !passed.is_empty() {
                        passed.on(halves[0], lane).for_each(meet);
                    }
                });
            }
            stats.finds[LineKind::Flood as usize] += finds.len() as u64;
        }
        Ok(())
    }
}
