//! Random meshes whose triangles share points and edges.

use proptest::prelude::*;

type Triangle = [[f32; 3]; 3];

/// Generates triangles over few points: many share an edge, and some are repeated or reversed.
pub fn few_points() -> impl Strategy<Value = Vec<Triangle>> {
    let points = prop::collection::vec(prop::array::uniform3(-3..=3i8), 4..9);
    let triangles = prop::collection::vec(prop::array::uniform3(0..64usize), 4..28);
    (points, triangles).prop_map(|(points, triangles)| {
        let point = |k: usize| points[k % points.len()].map(f32::from);
        triangles.into_iter().map(|t| t.map(point)).collect()
    })
}

/// Generates sheets of squares over a lattice that cross one another.
///
/// Many of the heights agree. Some squares are skipped, and some are divided at the middle of an edge.
pub fn sheets() -> impl Strategy<Value = Vec<Triangle>> {
    let sheet = (
        prop::collection::vec(-2..=2i8, 25),
        any::<u16>(),
        any::<u16>(),
        0..3usize,
        any::<bool>(),
    );
    prop::collection::vec(sheet, 1..4).prop_map(|sheets| {
        let mut all = Vec::new();
        for (heights, kept, split, axis, fine) in sheets {
            let by = if fine { 0.37 } else { 1.0 };
            let point = |u: f32, v: f32, h: f32| {
                let mut p = [0.0; 3];
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (h * by, u - 2.0, v - 2.0);
                p
            };
            let at = |u: usize, v: usize| point(u as f32, v as f32, f32::from(heights[u * 5 + v]));
            for square in 0..16usize {
                let (u, v) = (square / 4, square % 4);
                if kept >> square & 1 == 0 && kept & 3 != 0 {
                    continue;
                }
                let [a, b, c, d] = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
                all.push([a, b, c]);
                if split >> square & 1 == 0 {
                    all.push([a, c, d]);
                } else {
                    let middle = std::array::from_fn(|k| (a[k] + c[k]) / 2.0);
                    all.extend([[a, middle, d], [d, c, middle]]);
                }
            }
        }
        all
    })
}
