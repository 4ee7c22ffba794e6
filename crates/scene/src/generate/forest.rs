//! A forest: trees with an exact number of triangles each, on a jittered grid over uneven ground.
//!
//! A tree has a trunk, branches with twigs (closed tubes, at most a quarter of its triangles), and leaves of
//! two triangles. Such fine, scattered geometry is the hardest case for from-region methods.

use glam::Vec3;

use super::build::{Builder, tube_size};
use super::params::{
    GenerateError, MAX_TRIANGLES, SceneKind, SceneParams, contradiction, isqrt, within,
};
use super::random::{Random, turn};

/// The average distance between trees, in metres.
const SPACING: f32 = 6.0;
/// The number of ground cells along a side of a tree's plot.
const GROUND: u64 = 4;
/// The number of triangles of the smallest tree: eight of the trunk, and two leaves of two triangles each.
const LEAST_TREE: u64 = 12;

pub(super) fn build(b: &mut Builder, params: &SceneParams) -> Result<(), GenerateError> {
    const KIND: SceneKind = SceneKind::Forest;
    let (trees, each) = match (params.triangles, params.trees, params.triangles_per_tree) {
        (Some(_), Some(_), Some(_)) => {
            return Err(contradiction(
                KIND,
                "--trees and --triangles-per-tree already determine the number",
            ));
        }
        (Some(total), trees, each) => {
            within(KIND, "--triangles", total, 100, MAX_TRIANGLES)?;
            if let Some(each) = each {
                let each = within(
                    KIND,
                    "--triangles-per-tree",
                    u64::from(each),
                    LEAST_TREE,
                    MAX_TRIANGLES,
                )?;
                ((total / (each + 2 * GROUND * GROUND)).max(1), each)
            } else {
                let trees =
                    trees.map_or((total / 25_000).max((total / 1_000).clamp(1, 8)), u64::from);
                within(KIND, "--trees", trees, 1, MAX_TRIANGLES / LEAST_TREE)?;
                let side = ground_side(trees);
                (
                    trees,
                    (total.saturating_sub(2 * side * side) / trees).max(LEAST_TREE),
                )
            }
        }
        (None, trees, each) => (trees.map_or(200, u64::from), each.map_or(25_000, u64::from)),
    };
    within(KIND, "--trees", trees, 1, MAX_TRIANGLES / LEAST_TREE)?;
    within(
        KIND,
        "--triangles-per-tree",
        each,
        LEAST_TREE,
        MAX_TRIANGLES,
    )?;
    let all = trees
        .saturating_mul(each)
        .saturating_add(2 * ground_side(trees).pow(2));
    within(
        KIND,
        "triangles of all trees and the ground",
        all,
        LEAST_TREE,
        MAX_TRIANGLES,
    )?;

    let columns = isqrt(trees - 1) + 1;
    b.object("ground".into(), |b| {
        ground(b, params.seed, ground_side(trees), columns as f32 * SPACING)
    });
    for tree in 0..trees {
        let mut r = Random::new(params.seed, 1 + tree);
        // At least a fifth of the spacing remains between trunks.
        let mut jitter = |cell: u64| (cell as f32 + r.range(0.1, 0.9)) * SPACING;
        let at = Vec3::new(jitter(tree % columns), -0.5, jitter(tree / columns));
        b.object(format!("tree {tree}"), |b| grow(b, &mut r, at, each));
    }
    Ok(())
}

/// Returns the number of ground cells along a side.
fn ground_side(trees: u64) -> u64 {
    GROUND * (isqrt(trees - 1) + 1)
}

/// Adds an uneven sheet of 2·side² triangles over the square [0, size]² in x and z.
fn ground(b: &mut Builder, seed: u64, side: u64, size: f32) {
    let mut r = Random::new(seed, 0);
    let row = side + 1;
    let heights: Vec<f32> = (0..row * row).map(|_| r.range(-0.2, 0.2)).collect();
    let p = |i: u64, j: u64| {
        let at = |k: u64| k as f32 / side as f32 * size;
        Vec3::new(at(i), heights[(j * row + i) as usize], at(j))
    };
    for j in 0..side {
        for i in 0..side {
            b.quad([p(i, j), p(i, j + 1), p(i + 1, j + 1), p(i + 1, j)], false);
        }
    }
}

/// Adds one tree of exactly `budget` triangles with its foot at `at`.
fn grow(b: &mut Builder, r: &mut Random, at: Vec3, budget: u64) {
    let start = b.len();
    let wood = budget / 4;
    let height = r.range(7.0, 14.0);
    let girth = height * r.range(0.015, 0.025);
    let lean = r.direction() * Vec3::new(0.6, 0.0, 0.6);
    let stem = |f: f32| at + Vec3::Y * (height * f) + lean * (f * f);
    let (sides, segments) = match wood {
        0..40 => (3, 1),
        40..400 => (5, 2),
        _ => (9, 10),
    };
    let rings: Vec<(Vec3, f32)> = (0..=segments)
        .map(|k| k as f32 / segments as f32)
        .map(|f| (stem(f), girth * (1.0 - 0.85 * f)))
        .collect();
    b.tube(&rings, sides);
    // The branches and twigs, around which the leaves are placed.
    let mut tips = Vec::new();
    let bough = tube_size(4, 3) + 4 * tube_size(3, 1);
    let boughs = (wood.saturating_sub(tube_size(sides, segments)) / bough).min(120);
    for k in 0..boughs {
        let f = 0.3 + 0.68 * (k as f32 + r.range(0.0, 1.0)) / boughs as f32;
        // Each branch is rotated by about the golden angle from the previous branch.
        let (c, s) = turn(0.382 * k as f32 + r.range(-0.05, 0.05));
        let reach = height * 0.35 * (1.1 - f) * r.range(0.7, 1.2);
        let end = stem(f) + Vec3::new(c * reach, reach * r.range(0.2, 0.7), s * reach);
        let thick = girth * 0.5 * (1.1 - f);
        let along = |g: f32| stem(f).lerp(end, g) + Vec3::Y * (reach * 0.15 * g * (1.0 - g));
        let rings = [0.0f32, 0.33, 0.66, 1.0].map(|g| (along(g), thick * (1.0 - 0.8 * g)));
        b.tube(&rings, 4);
        tips.push((along(0.4), end));
        for twig in 1u8..5 {
            let from = along(0.2 * f32::from(twig));
            let to = from + r.direction() * (reach * 0.35);
            b.tube(&[(from, thick * 0.3), (to, thick * 0.1)], 3);
            tips.push((from, to));
        }
    }
    if tips.is_empty() {
        tips.push((stem(0.5), stem(1.05)));
    }
    let spread = height * if boughs == 0 { 0.2 } else { 0.04 };
    while b.len() - start < budget {
        let (from, to) = tips[r.below(tips.len() as u32) as usize];
        let p = from.lerp(to, r.range(0.2, 1.1)) + r.direction() * (spread * r.range(0.1, 1.0));
        let along = r.direction();
        let across = along.cross(r.direction()).normalize_or(Vec3::X) * r.range(0.02, 0.05);
        let along = along.normalize_or(Vec3::Z) * r.range(0.06, 0.12);
        b.triangle(p, p + along * 0.5 + across, p + along);
        if b.len() - start < budget {
            b.triangle(p, p + along, p + along * 0.5 - across);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::generate;

    #[test]
    fn every_tree_has_exactly_its_triangles() {
        for each in [12u32, 13, 100, 999, 25_000] {
            let p = SceneParams {
                trees: Some(3),
                triangles_per_tree: Some(each),
                ..SceneParams::default()
            };
            let s = generate(SceneKind::Forest, &p).unwrap();
            assert_eq!(s.objects().len(), 4);
            assert!(s.objects()[1..].iter().all(|o| o.count == each));
            assert!(s.triangles().iter().all(|t| !t.is_degenerate()));
        }
    }
}
