//! What portals and exact queries list in random buildings, straight and turned by half a radian. Corners of
//! these walls lie on the edges of others, so turning opens cracks.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "this program's output is its purpose")]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod common;

use glam::Vec3;
use sightline_exact::{Cell, ExactScene, Task, decide};
use sightline_numbers::Aabb;
use sightline_portals::{Limits, Partition, sights};

fn main() {
    println!("building, angle: parts of space, triangles listed by portals and by exact queries, on average");
    for seed in 0..4 {
        for angle in [0.0, 0.5] {
            let scene = common::building(seed, angle);
            let partition =
                Partition::new(&scene, None, scene.bounds(), Limits::default(), &|| false).unwrap();
            let prepared = ExactScene::prepare(&scene).unwrap();
            let places =
                (0..12u8).map(|k| Vec3::new(f32::from(k % 3), f32::from(k / 3 % 2), f32::from(k / 6)));
            let mut sums = [0, 0];
            for place in places {
                let middle = common::turned(place + 0.5, angle);
                let cell = Aabb::new(middle - 0.1, middle + 0.1);
                let listed = sights(&partition, cell, false, &|| false).unwrap();
                let decided = decide(&Task {
                    scene: &prepared,
                    cell: Cell::new(cell.min, cell.max).unwrap(),
                    places: None,
                    seen: &[],
                    above: &[],
                    listed: Some(&listed),
                    limits: sightline_exact::Limits::default(),
                    seed: 1,
                    keep: false,
                    stop: &|| false,
                    asked: &|| {},
                });
                sums[0] += listed.len();
                sums[1] += decided.visible.len() + decided.undecided.len();
            }
            let [portals, exact] = sums.map(|sum| f64::from(sum as u32) / 12.0);
            println!("{seed}, {angle}: {} {portals:.0} {exact:.0}", partition.leaves());
        }
    }
}
