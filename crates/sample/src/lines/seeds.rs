//! Seeds: one line from every second triangle of the scene, so that every surface has a line near it.
//!
//! A triangle that is visible only from a hidden corner has no seen neighbour from which it could be found.
//! Seeds begin at such triangles and lower the worst errors most. Eight consecutive triangles in Morton order
//! share direction and distance, which keeps packets coherent. The distance of the origin from the surface is
//! log-uniform, because gaps have all sizes.

use glam::{DVec3, Vec3};
use sightline_scene::TriangleId;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::surface::point_on;

use super::block::{Block, JOINED_AIMED_LANES, Scratch};
use super::phase::{self, Items};
use crate::context::TileError;

/// The number of triangles per seed.
const ONE_IN: usize = 2;
/// The number of triangles of an item of the phase.
const STRIPE: usize = 1024;
/// The number of scales of the distance between a seed's triangle and the seed's origin: a quarter of the
/// block's diagonal, halved 0 to 15 times at random.
const HALVINGS: f32 = 16.0;
/// The name of the stream of random numbers.
const SEEDS: u64 = 4;

impl Block<'_> {
    /// Casts the seeds of the whole scene whose lines cross the block.
    pub(super) fn seeds(&self) -> Result<(), TileError> {
        let (min, max) = self.table.grid.bounds();
        let extent = (max - min).length();
        let first = self.table.cells.first().map_or(0, |c| c.number);
        let stripes: Vec<&[u32]> = self.inputs.surface.morton.chunks(STRIPE).collect();
        let compute = |number: usize| {
            let stripe = stripes[number];
            if self.inputs.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            if self.late() {
                return Ok(0);
            }
            self.with_scratch(|s| {
                let mut random = Hashed::new(&[self.inputs.seed, first, number as u64, SEEDS]);
                s.packets.clear();
                for group in stripe.chunks(LANES * ONE_IN) {
                    let direction = on_sphere(&mut random);
                    let halvings = (random.unit() * HALVINGS) as i32;
                    let distance =
                        extent * 0.25 * 2f32.powi(-halvings) * (0.5 + 0.5 * random.unit());
                    let front = random.unit() < 0.5;
                    let skip = (random.unit() * ONE_IN as f32) as usize;
                    let mut down = Packet::default();
                    for triangle in group.iter().skip(skip).step_by(ONE_IN).take(LANES) {
                        let up = if self.is_up(*triangle, direction, front) {
                            direction
                        } else {
                            -direction
                        };
                        let at = Vec3::from(point_on(
                            self.inputs.scene,
                            TriangleId(*triangle),
                            &mut random,
                        ));
                        let origin = at + up * distance;
                        // A free segment is in the viewpoints' region as a whole or not at all.
                        if self.inputs.region.is_none_or(|region| region.hold(origin)) {
                            down.push(origin.to_array(), (-up).to_array());
                        }
                    }
                    let up = down.reversed(self.step);
                    s.packets.push(down);
                    s.packets.push(up);
                }
                self.inputs
                    .sight
                    .trace_lines(&mut s.packets, &mut s.passed, self.step, true)?;
                let Scratch {
                    packets,
                    passed,
                    cells,
                    ..
                } = &mut *s;
                let mut rays = 0;
                for pair in 0..packets.len() / 2 {
                    let halves = [2 * pair, 2 * pair + 1];
                    rays += 2 * packets[halves[0]].count as u64;
                    let joins = Some(JOINED_AIMED_LANES);
                    self.credit_lines(packets, passed, halves, joins, cells, |_, _, _| {});
                }
                self.inputs.watcher.rendered(rays);
                Ok(rays)
            })
        };
        let cost = |_| 1;
        let items = Items {
            count: stripes.len(),
            prepare: &|| {},
            cost: &cost,
            compute: &compute,
            fits: &|_| true,
        };
        phase::run(self.inputs.crew, self.tables(), items).map(|_| ())
    }
}

impl Block<'_> {
    /// Returns true if a direction points to the side of a triangle on which its seed begins.
    ///
    /// This is the front of a triangle with one side, and otherwise the side that `front` selects.
    fn is_up(&self, triangle: u32, direction: Vec3, front: bool) -> bool {
        let one_sided = self.inputs.scene.front(TriangleId(triangle));
        if one_sided != DVec3::ZERO {
            return one_sided.dot(direction.as_dvec3()) > 0.0;
        }
        let v = self.inputs.scene.triangles()[triangle as usize].v;
        let normal = (v[1] - v[0]).cross(v[2] - v[0]);
        (normal.dot(direction) > 0.0) == front
    }
}

/// Returns a uniform direction, by rejection from the cube. The computation does not use functions whose last
/// bit differs between machines.
pub(super) fn on_sphere(random: &mut Hashed) -> Vec3 {
    loop {
        let v = random.point() * 2.0 - 1.0;
        let length = v.length_squared();
        if length <= 1.0 && length > 1e-4 {
            return v / length.sqrt();
        }
    }
}
