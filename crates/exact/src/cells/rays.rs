//! Witnesses from random rays: segments from random points of the cell to random points of likely visible
//! triangles.
//!
//! The first triangle that a segment meets gets a witness if it is wanted. Every segment is checked exactly
//! before it counts ([`shows`]). Triangles that a few rays do not show are left to queries.

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};

use crate::arithmetic::random::Random;
use crate::cells::sources::Sources;
use crate::occluders::Occluders;
use crate::occluders::segment::{first, shows};

/// Segments tried for one triangle before it is left to a query, which costs far more than all of them.
pub const TRIES: u32 = 48;
/// How far a witness extends beyond the triangle, as fractions of its length, in the order tried: far enough
/// that its rounded end is beyond the triangle, not so far that it often meets another triangle.
const BEYOND: [f64; 2] = [1e-4, 1e-6];

/// Segments tried around a witness that a query found.
const AROUND: u32 = 32;
/// The first distance of these segments from the witness, as a fraction of the cell and of the target, and
/// the factor by which it shrinks.
const SPREAD: [f64; 2] = [0.25, 0.6];

/// Looks for witnesses near an unobstructed segment from the cell to a target of width `wide`. Nearby lines
/// often show the same triangle, or triangles behind the face of a box. Returns witnesses for `wanted`
/// triangles and the number of rays cast.
pub fn around(
    scene: &Occluders,
    sources: &Sources<'_>,
    [p, q]: [DVec3; 2],
    wide: f64,
    wanted: &dyn Fn(u32) -> bool,
    mut random: Random,
) -> (Vec<(u32, [Vec3; 2])>, u64) {
    let mut found: Vec<(u32, [Vec3; 2])> = Vec::new();
    let mut scratch = Vec::new();
    let [min, max] = sources.cell().corners();
    let mut spread = 0.0;
    for _ in 0..AROUND {
        let mut off = || DVec3::new(random.unit(), random.unit(), random.unit()) * 2.0 - 1.0;
        let near = (p + off() * (max - min).as_dvec3() * spread)
            .as_vec3()
            .clamp(min, max);
        let origin = near.as_dvec3();
        let to = q + off() * wide * spread;
        // The segment itself comes first.
        spread = if spread == 0.0 {
            SPREAD[0]
        } else {
            spread * SPREAD[1]
        };
        if !sources.holds(near) {
            continue;
        }
        let Some((met, at)) = first(scene, origin, to - origin) else {
            continue;
        };
        if !wanted(met) || found.iter().any(|f| f.0 == met) {
            continue;
        }
        if let Some(ends) = segment(scene, near, to - origin, (met, at), &mut scratch) {
            found.push((met, ends));
        }
    }
    (found, u64::from(AROUND))
}

/// The segment from `p` along a direction to just beyond the triangle it meets there, if it is a witness.
fn segment(
    scene: &Occluders,
    p: Vec3,
    direction: DVec3,
    (met, at): (u32, f64),
    scratch: &mut Vec<u32>,
) -> Option<[Vec3; 2]> {
    BEYOND.iter().find_map(|beyond| {
        let q = (p.as_dvec3() + direction * (at * (1.0 + beyond))).as_vec3();
        (q.is_finite() && shows(scene, p, q, met, scratch)).then_some([p, q])
    })
}

/// Looks for witnesses of the `wanted` triangles (ascending), with some tries each, and gives those found.
///
/// The answer depends on the scene, the cell, `wanted` and `seed` alone. `stop` is called after each
/// triangle; when it returns true, the answer is the witnesses found so far.
pub fn witnesses(
    scene: &Occluders,
    sources: &Sources<'_>,
    (wanted, tries): (&[u32], u32),
    seed: u64,
    stop: &dyn Fn() -> bool,
) -> (BTreeMap<u32, [Vec3; 2]>, u64) {
    let mut found = BTreeMap::new();
    let (mut scratch, mut cast) = (Vec::new(), 0);
    for id in wanted {
        let mut random = Random::new(seed, u64::from(*id));
        let [a, b, c] = scene.triangle(*id).map(|v| v.as_dvec3());
        for _ in 0..tries {
            if found.contains_key(id) {
                break;
            }
            let Some(p) = sources.viewpoint(&mut random) else {
                continue;
            };
            // Uniform over the triangle.
            let (s, t) = (random.unit().sqrt(), random.unit());
            let to = a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t);
            let origin = p.as_dvec3();
            cast += 1;
            // A triangle that does not block is met where the segment was aimed.
            let met = if scene.of(*id).is_some() {
                first(scene, origin, to - origin)
            } else {
                Some((*id, 1.0))
            };
            let Some((met, at)) = met else { continue };
            if found.contains_key(&met) || wanted.binary_search(&met).is_err() {
                continue;
            }
            if let Some(ends) = segment(scene, p, to - origin, (met, at), &mut scratch) {
                found.insert(met, ends);
            }
        }
        if stop() {
            break;
        }
    }
    (found, cast)
}
