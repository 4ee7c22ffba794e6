//! Flooding: from the origin that saw a new triangle, aim at the neighbours of the triangle that the cell has
//! not seen: the triangles across its edges, or close by where an edge has no other triangle.
//!
//! A point that sees one triangle of a surface mostly sees the next one too; other origins in the cell were
//! tried and find far less. Each line is traced in both directions, so the triangles behind the origin are
//! credited as well.

use sightline_model::{CellStats, LineKind};
use sightline_trace::BackendError;
use sightline_trace::cube::SKY;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::surface::point_on;

use super::block::{Block, JOINED_AIMED_LANES, Scratch};

/// A triangle new to the cell, and the origin that saw it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Find {
    /// Number of the packet whose line it was; lines of a packet have one origin.
    pub(super) packet: u32,
    pub(super) origin: [f32; 3],
    pub(super) triangle: u32,
}

/// A packet aimed at triangles.
struct Aimed {
    packet: Packet,
    /// The packet of the finds that have the same origin.
    eye: u32,
    targets: [u32; LANES],
}

impl Block<'_> {
    /// Floods from `finds` in so many steps at most, and leaves the finds of the last one in their place.
    pub(super) fn flood(
        &self,
        s: &mut Scratch,
        cell: usize,
        (finds, steps): (&mut Vec<Find>, u32),
        random: &mut Hashed,
        stats: &mut CellStats,
    ) -> Result<(), BackendError> {
        let slot = self.cells[cell].slot;
        for _ in 0..steps {
            let mut aimed: Vec<Aimed> = Vec::new();
            for find in finds.iter() {
                for next in self.tools.surface.neighbours[find.triangle as usize] {
                    if next == SKY {
                        continue;
                    }
                    let row = self.row(next);
                    if s.met[row as usize] == s.tag || self.bits.seen(row, slot) {
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
                    let to = point_on(self.tools.scene, next, random);
                    last.packet.push(eye, [0, 1, 2].map(|a| to[a] - eye[a]));
                }
            }
            if aimed.is_empty() {
                break;
            }
            s.behind.clear();
            s.behind.extend(aimed.iter().map(|a| a.packet.clone()));
            s.behind
                .extend(aimed.iter().map(|a| a.packet.reversed(self.step)));
            self.tools
                .sight
                .trace_each(&mut s.behind, &mut s.passed, self.step)?;
            finds.clear();
            let Scratch {
                behind: traced,
                passed,
                crossed,
                joined,
                met,
                tag,
                ..
            } = &mut *s;
            for (k, a) in aimed.iter().enumerate() {
                let ahead = &traced[k];
                stats.rays[LineKind::Flood as usize] += 2 * ahead.count as u64;
                for lane in 0..ahead.count {
                    let (end, target) = (ahead.triangle[lane], a.targets[lane]);
                    let found = end == target || passed.on(k, lane).any(|t| t == target);
                    if !found {
                        // Another triangle obstructs it; from another origin it may be visible.
                        met[self.row(target) as usize] = 0;
                    }
                    let origin = ahead.ray(lane).0;
                    let joins = lane.is_multiple_of(JOINED_AIMED_LANES);
                    self.credit_line(
                        traced,
                        passed,
                        [k, k + aimed.len()],
                        lane,
                        (crossed, joined),
                        joins,
                    );
                    let mut meet = |hit| {
                        if hit == SKY {
                            return;
                        }
                        let row = self.row(hit);
                        if !self.bits.seen(row, slot)
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
                        passed.on(k, lane).for_each(meet);
                    }
                }
            }
            stats.finds[LineKind::Flood as usize] += finds.len() as u64;
        }
        Ok(())
    }
}
