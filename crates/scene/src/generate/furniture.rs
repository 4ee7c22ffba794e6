//! Furniture: tables, and turned pieces (vases, lamps, columns) with any number of triangles.

use glam::Vec3;

use super::build::{Builder, tube_size};
use super::random::Random;

/// The number of triangles of the smallest piece: a turned piece with three sides and one segment.
pub(super) const LEAST: u64 = 8;
/// The number of triangles of a table: a top and four legs.
const TABLE: u64 = 60;

/// Returns the part of the floor from `min` to `max` for piece `k` of `n`: one of `n` strips along z.
pub(super) fn strip([min, max]: [Vec3; 2], k: u64, n: u64) -> [Vec3; 2] {
    let x = |k: u64| min.x + (max.x - min.x) * (k as f32 / n as f32);
    [min.with_x(x(k)), max.with_x(x(k + 1))]
}

/// Adds a piece of about `budget` triangles (at least [`LEAST`]) at a random position on the floor between
/// `min` and `max`. The piece does not touch the borders of the floor.
pub(super) fn piece(b: &mut Builder, r: &mut Random, [min, max]: [Vec3; 2], budget: u64) {
    let room = (max - min).with_y(0.0);
    let size = room.x.min(room.z) * r.range(0.12, 0.2);
    let place = |r: &mut Random, lo: f32, hi: f32| r.range(lo + 2.0 * size, hi - 2.0 * size);
    let at = Vec3::new(place(r, min.x, max.x), min.y, place(r, min.z, max.z));
    if budget < TABLE + LEAST || r.below(3) == 0 {
        turned(b, r, at, size, r_height(size), budget);
    } else {
        let top = 0.75;
        table(b, at, size * 1.5, top);
        turned(b, r, at + Vec3::Y * top, size * 0.8, 0.6, budget - TABLE);
    }
}

/// Returns the height in metres of a free-standing piece of radius `size`: five radii, at most 1.8 m.
fn r_height(size: f32) -> f32 {
    (size * 5.0).min(1.8)
}

/// Adds a top on four legs. The boxes touch and do not overlap.
fn table(b: &mut Builder, at: Vec3, half: f32, height: f32) {
    let (leg, plate) = (half * 0.12, height * 0.08);
    let under = height - plate;
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let centre = at + Vec3::new(x * half * 0.8, 0.0, z * half * 0.8);
        let half_leg = Vec3::new(leg, 0.0, leg);
        b.cuboid(centre - half_leg, centre + half_leg + Vec3::Y * under);
    }
    let wide = Vec3::new(half, 0.0, half);
    b.cuboid(at - wide + Vec3::Y * under, at + wide + Vec3::Y * height);
}

/// Adds a solid of revolution about a vertical axis with a random, smooth outline.
fn turned(b: &mut Builder, r: &mut Random, at: Vec3, radius: f32, height: f32, budget: u64) {
    // The numbers of sides and segments are about equal, so that triangles are not needles.
    let sides = (((budget / 2).isqrt()).clamp(3, 4_000)) as u32;
    let segments = ((budget.saturating_sub(2 * u64::from(sides - 2)) / (2 * u64::from(sides)))
        .clamp(1, 1 << 20)) as u32;
    debug_assert!(tube_size(sides, segments) <= budget.max(LEAST));
    let knots: Vec<f32> = (0..7).map(|_| r.range(0.35, 1.0)).collect();
    let rings: Vec<(Vec3, f32)> = (0..=segments)
        .map(|k| {
            let f = k as f32 / segments as f32;
            let x = f * 6.0;
            let knot = (x as usize).min(5);
            let t = x - knot as f32;
            // Interpolates smoothly between knots: 3t² − 2t³.
            let blend = t * t * (3.0 - 2.0 * t);
            let outline = knots[knot] + (knots[knot + 1] - knots[knot]) * blend;
            (at + Vec3::Y * (height * f), radius * outline)
        })
        .collect();
    b.tube(&rings, sides);
}
