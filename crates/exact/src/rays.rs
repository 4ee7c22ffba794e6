//! Witnesses by rays: for each of many triangles that are likely visible, segments from random points of the cell to random
//! points of it; whatever wanted triangle such a segment meets first has its witness.
//!
//! Every segment is checked exactly before it counts ([`shows`]). What a few rays do not show is left to the queries.

use std::collections::BTreeMap;

use glam::Vec3;

use crate::cell::Cell;
use crate::occluder::Occluders;
use crate::segment::{first, shows};

/// Segments tried for one triangle before it is left to a query, which costs far more than all of them.
const TRIES: u32 = 48;
/// How far beyond the point it meets a witness reaches, in parts of its length: floats near the point have to be well beyond
/// the triangle, and what is right behind it in the way as rarely as can be.
const BEYOND: [f64; 2] = [1e-4, 1e-6];

/// Numbers from a seed: SplitMix64 (Steele et al. 2014).
pub struct Random(u64);

impl Random {
    /// Numbers of their own for each pair.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut r = Self(seed);
        Self(r.next() ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In 0 to 1, without 1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn point_in(&mut self, cell: &Cell) -> Vec3 {
        let [min, max] = cell.corners();
        let r = glam::DVec3::new(self.unit(), self.unit(), self.unit());
        let p = (min.as_dvec3() + (max.as_dvec3() - min.as_dvec3()) * r).as_vec3();
        p.clamp(min, max)
    }
}

/// Looks for witnesses of the `wanted` triangles (ascending) and gives those found.
///
/// The answer depends on the scene, the cell, `wanted` and `seed` alone. `stop` is asked now and then; once it says so, what was
/// found by then is the answer.
pub fn witnesses(
    scene: &Occluders,
    cell: &Cell,
    wanted: &[u32],
    seed: u64,
    stop: &dyn Fn() -> bool,
) -> (BTreeMap<u32, [Vec3; 2]>, u64) {
    let mut found = BTreeMap::new();
    let (mut scratch, mut cast) = (Vec::new(), 0);
    for id in wanted {
        let mut random = Random::new(seed, u64::from(*id));
        let [a, b, c] = scene.triangle(*id).map(|v| v.as_dvec3());
        for _ in 0..TRIES {
            if found.contains_key(id) {
                break;
            }
            let p = random.point_in(cell);
            // Evenly over the triangle.
            let (s, t) = (random.unit().sqrt(), random.unit());
            let to = a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t);
            let origin = p.as_dvec3();
            cast += 1;
            let Some((met, at)) = first(scene, origin, to - origin) else { continue };
            if found.contains_key(&met) || wanted.binary_search(&met).is_err() {
                continue;
            }
            for beyond in BEYOND {
                let q = (origin + (to - origin) * (at * (1.0 + beyond))).as_vec3();
                if q.is_finite() && shows(scene, p, q, met, &mut scratch) {
                    found.insert(met, [p, q]);
                    break;
                }
            }
        }
        if stop() {
            break;
        }
    }
    (found, cast)
}
