//! Runs of triangles that lie together, for culling: Morton order of centroids, cut into runs of equal length.
//!
//! A grouping only. It decides nothing about visibility, so its rounding cannot make a result wrong; it is
//! nevertheless the same on every machine.

use glam::DVec3;

use crate::{Aabb, Scene};

/// A run of [`Clusters::order`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// Index in [`Clusters::order`] of its first triangle.
    pub first: u32,
    /// Number of its triangles, at least 1.
    pub count: u32,
    /// The box around its triangles' vertices.
    pub bounds: Aabb,
}

/// Triangles in spatial order and the runs they form.
#[derive(Clone, Debug, Default)]
pub struct Clusters {
    /// Ids of the clustered triangles, each once, in Morton order of their centroids, ties by id.
    pub order: Vec<u32>,
    /// The runs, tiling `order` from its beginning.
    pub clusters: Vec<Cluster>,
}

/// Clusters the triangles `ids` (or all) into runs of at most `max_triangles` (0 is taken as 1). Triangles
/// without area, ids outside the scene and repetitions are left out.
pub fn cluster(scene: &Scene, ids: Option<&[u32]>, max_triangles: u32) -> Clusters {
    let triangles = scene.triangles();
    let mut order: Vec<u32> = match ids {
        Some(ids) => ids.to_vec(),
        None => (0..scene.len()).collect(),
    };
    order.retain(|id| triangles.get(*id as usize).is_some_and(|t| !t.is_degenerate()));
    let centroid = |id: u32| {
        let [a, b, c] = triangles[id as usize].v.map(|v| v.as_dvec3());
        (a + b + c) / 3.0
    };
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for id in &order {
        lo = lo.min(centroid(*id));
        hi = hi.max(centroid(*id));
    }
    // One scale for all axes keeps the cells of the curve cubes.
    let extent = (hi - lo).max_element();
    let mut keys: Vec<u128> = order
        .iter()
        .map(|id| {
            let at = if extent > 0.0 { (centroid(*id) - lo) / extent * GRID } else { DVec3::ZERO };
            u128::from(morton(at.to_array().map(|c| (c as u64).min(GRID as u64 - 1)))) << 32 | u128::from(*id)
        })
        .collect();
    keys.sort_unstable();
    keys.dedup();
    order.clear();
    order.extend(keys.iter().map(|key| *key as u32));
    let mut clusters = Vec::new();
    let mut first = 0;
    for run in order.chunks(max_triangles.max(1) as usize) {
        let bounds = run.iter().fold(Aabb::EMPTY, |b, id| b.union(triangles[*id as usize].bounds()));
        clusters.push(Cluster { first, count: run.len() as u32, bounds });
        first += run.len() as u32;
    }
    Clusters { order, clusters }
}

/// Steps of the grid along the longest axis: 21 bits, so that three fit a `u64`.
const GRID: f64 = 2_097_152.0;

/// Interleaves three 21-bit numbers, the first in the least bits.
fn morton(c: [u64; 3]) -> u64 {
    let spread = |mut x: u64| {
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(c[0]) | spread(c[1]) << 1 | spread(c[2]) << 2
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::{Object, Triangle};

    fn scene(at: &[[i16; 3]]) -> Scene {
        let triangles: Vec<Triangle> = at
            .iter()
            .map(|p| Vec3::from(p.map(f32::from)))
            // Points on the diagonal plane become triangles without area.
            .map(|p| Triangle { v: [p, p + Vec3::X, if p.x == p.y { p } else { p + Vec3::Y }] })
            .collect();
        let count = triangles.len() as u32;
        Scene::new("test", triangles, vec![Object { name: "all".into(), first: 0, count }]).unwrap()
    }

    #[test]
    fn neighbours_end_up_in_one_run() {
        // Two far groups, interleaved by id.
        let s = scene(&[[0, 9, 0], [900, 0, 0], [1, 9, 1], [901, 0, 1], [0, 10, 1], [900, 1, 0]]);
        let c = cluster(&s, None, 3);
        let mut runs: Vec<Vec<u32>> = c.order.chunks(3).map(<[u32]>::to_vec).collect();
        runs.iter_mut().for_each(|r| r.sort_unstable());
        assert_eq!(runs, [[0, 2, 4], [1, 3, 5]]);
    }

    #[test]
    fn morton_interleaves() {
        assert_eq!(morton([1, 0, 0]), 1);
        assert_eq!(morton([0b11, 0b10, 0b01]), 0b011_101);
        assert_eq!(morton([(1 << 21) - 1; 3]), (1 << 63) - 1);
    }

    proptest! {
        #[test]
        fn runs_tile_the_triangles_with_area(
            at in prop::collection::vec(prop::array::uniform3(-20i16..20), 1..60),
            ids in prop::option::of(prop::collection::vec(0u32..70, 0..40)),
            max in 0u32..9,
        ) {
            let s = scene(&at);
            let c = cluster(&s, ids.as_deref(), max);
            let mut expected: Vec<u32> = ids.unwrap_or_else(|| (0..s.len()).collect());
            expected.retain(|id| s.triangles().get(*id as usize).is_some_and(|t| !t.is_degenerate()));
            expected.sort_unstable();
            expected.dedup();
            let mut got = c.order.clone();
            got.sort_unstable();
            prop_assert_eq!(got, expected);
            let mut next = 0;
            for run in &c.clusters {
                prop_assert!(run.first == next && run.count >= 1 && run.count <= max.max(1));
                let members = &c.order[run.first as usize..][..run.count as usize];
                let bounds = members.iter().fold(Aabb::EMPTY, |b, id| b.union(s.triangles()[*id as usize].bounds()));
                prop_assert_eq!(run.bounds, bounds);
                next += run.count;
            }
            prop_assert_eq!(next as usize, c.order.len());
        }
    }
}
