//! Witnesses from random rays: segments from random points of the cell to random points of likely visible
//! triangles.
//!
//! If the caller needs a witness for the first triangle that a segment meets, the segment is tested exactly
//! with [`shows`] and becomes its witness. Queries decide the triangles that a few rays do not show.

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use sightline_scene::TriangleId;

use crate::arithmetic::random::Random;
use crate::cells::sources::Sources;
use crate::occluders::Occluders;
use crate::occluders::segment::{first, shows};

/// The number of segments tried per triangle before a query. A query costs far more than all these segments.
pub const TRIES: u32 = 48;
/// The lengths by which a witness extends beyond the triangle, as fractions of the length from viewpoint to
/// triangle, in the order tried.
///
/// A length must be large enough that the rounded end is beyond the triangle, and small enough that the
/// segment rarely meets another triangle.
const BEYOND: [f64; 2] = [1e-4, 1e-6];

/// The number of segments that [`around`] tries near a witness that a query found.
const AROUND: u32 = 32;
/// The initial distance of these segments from the witness, and its shrinking factor per segment.
///
/// The distance is a fraction of the cell's size at the start of a segment, and of the target's width at the
/// end.
const SPREAD: [f64; 2] = [0.25, 0.6];

/// Searches for witnesses near an unobstructed segment from `p` in the cell to `q` in a target of width
/// `wide`.
///
/// Nearby lines often show the same triangle, or triangles behind the face of a box. The function returns
/// witnesses for triangles that `wanted` accepts, and the number of rays cast.
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
        // The first segment tried is the unobstructed segment without an offset.
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
        if let Some(ends) = segment(scene, near, to - origin, met, at, &mut scratch) {
            found.push((met, ends));
        }
    }
    (found, u64::from(AROUND))
}

/// Returns the segment from `p` to just beyond the triangle `met`, if the segment is a witness.
///
/// The ray meets the triangle at the parameter `at`.
fn segment(
    scene: &Occluders,
    p: Vec3,
    direction: DVec3,
    met: u32,
    at: f64,
    scratch: &mut Vec<u32>,
) -> Option<[Vec3; 2]> {
    BEYOND.iter().find_map(|beyond| {
        let q = (p.as_dvec3() + direction * (at * (1.0 + beyond))).as_vec3();
        (q.is_finite() && shows(scene, p, q, met, scratch)).then_some([p, q])
    })
}

/// Searches for witnesses of the `wanted` triangles, whose ids must be in ascending order, with at most
/// `tries` segments per triangle.
///
/// The function returns the witness of each triangle found, by triangle id, and the number of rays cast.
///
/// The result depends only on the scene, the cell, `wanted`, `tries` and `seed`. The function calls `stop`
/// after each triangle. If `stop` returns true, the result contains the witnesses found so far.
pub fn witnesses(
    scene: &Occluders,
    sources: &Sources<'_>,
    wanted: &[u32],
    tries: u32,
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
            // The point is uniformly distributed over the triangle.
            let (s, t) = (random.unit().sqrt(), random.unit());
            let to = a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t);
            let origin = p.as_dvec3();
            cast += 1;
            // A segment meets a triangle that does not block at the point at which the segment was aimed.
            let met = if scene.occluder_id(TriangleId(*id)).is_some() {
                first(scene, origin, to - origin)
            } else {
                Some((*id, 1.0))
            };
            let Some((met, at)) = met else { continue };
            if found.contains_key(&met) || wanted.binary_search(&met).is_err() {
                continue;
            }
            if let Some(ends) = segment(scene, p, to - origin, met, at, &mut scratch) {
                found.insert(met, ends);
            }
        }
        if stop() {
            break;
        }
    }
    (found, cast)
}
