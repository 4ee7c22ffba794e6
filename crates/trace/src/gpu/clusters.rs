//! The drawing order of triangles, and the culling of clusters (runs of that order) against the faces of a
//! cube.
//!
//! The order is a property of the scene: large triangles first, because they hide most, then along a Morton
//! curve, then by id. A superset is drawn in the same order, so that the winner of two coincident triangles
//! does not depend on the superset.

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::{Aabb, Scene, Triangle};

/// The number of triangles in a cluster; the last cluster may have fewer. The number is small, because most
/// triangles of a cluster at the border of a face are drawn in vain. Of the sizes from 32 to 256, 64 was the
/// fastest.
pub(super) const CLUSTER: usize = 64;

/// The number of bits of the Morton code for each axis.
const BITS: u32 = 20;

/// Returns the ids of the triangles that are not degenerate, in drawing order.
pub(super) fn drawing_order(scene: &Scene) -> Vec<u32> {
    let bounds = scene.bounds();
    let mut keyed: Vec<(u64, u32)> = scene
        .triangles()
        .par_iter()
        .zip(0..scene.len())
        .filter(|(t, _)| !t.is_degenerate())
        .map(|(t, id)| (key(t, bounds), id))
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, id)| id).collect()
}

/// Computes the sort key: the size class, then the Morton code of the centre of the triangle's box. Without
/// classes, a few large triangles would enlarge the boxes of clusters of small triangles.
fn key(triangle: &Triangle, bounds: Aabb) -> u64 {
    let to_double = |v: Vec3| v.as_dvec3();
    let (size, b) = (
        to_double(bounds.max) - to_double(bounds.min),
        triangle.bounds(),
    );
    let extent = (to_double(b.max) - to_double(b.min)).max_element()
        / size.max_element().max(f64::MIN_POSITIVE);
    let class = [0.25, 1.0 / 16.0, 1.0 / 64.0, 1.0 / 256.0]
        .iter()
        .filter(|limit| extent < **limit)
        .count();
    let centre = (to_double(b.min) + to_double(b.max)) * 0.5 - to_double(bounds.min);
    let cells = f64::from((1u32 << BITS) - 1);
    let code = (0..3).fold(0, |code, axis| {
        // The float-to-integer cast saturates. An axis without extent results in 0 or NaN, which becomes 0.
        let cell = (centre[axis] / size[axis] * cells) as u64;
        code | (spread(cell.min((1 << BITS) - 1)) << axis)
    });
    ((class as u64) << (3 * BITS)) | code
}

/// Inserts two zero bits above each of the low 20 bits of `x` (the usual Morton masks).
fn spread(x: u64) -> u64 {
    let x = (x | (x << 32)) & 0x001f_0000_0000_ffff;
    let x = (x | (x << 16)) & 0x001f_0000_ff00_00ff;
    let x = (x | (x << 8)) & 0x100f_00f0_0f00_f00f;
    let x = (x | (x << 4)) & 0x10c3_0c30_c30c_30c3;
    (x | (x << 2)) & 0x1249_2492_4924_9249
}

/// Returns the faces on which a box may be visible from `eye`; bit f is face f.
///
/// The test is conservative: rounding is monotone, so the differences here bound the differences of the
/// vertex shader. A vertex that the shader places inside a face's pyramid is also inside by this test.
pub(super) fn faces_touched(bounds: &Aabb, eye: Vec3) -> u32 {
    let (lo, hi) = (bounds.min - eye, bounds.max - eye);
    let mut faces = 0;
    for axis in 0..3 {
        let (r, u) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, forward) in [hi[axis], -lo[axis]].into_iter().enumerate() {
            // The largest forward distance is compared with the smallest |right| and |up|, for the four sides
            // of the pyramid.
            let inside = forward > 0.0
                && forward >= lo[r]
                && forward >= -hi[r]
                && forward >= lo[u]
                && forward >= -hi[u];
            faces |= u32::from(inside) << (2 * axis + side);
        }
    }
    faces
}

#[cfg(test)]
mod tests {
    use sightline_scene::Object;

    use super::*;

    #[test]
    fn spread_leaves_two_gaps() {
        for bit in 0..BITS {
            assert_eq!(spread(1 << bit), 1 << (3 * bit));
        }
    }

    #[test]
    fn small_box_touches_only_its_face() {
        for face in 0..6u32 {
            let [forward, right, _] = crate::cube::face_basis(face);
            let at = |p: Vec3| Aabb {
                min: p - 0.01,
                max: p + 0.01,
            };
            let eye = Vec3::new(3.0, -2.0, 5.0);
            assert_eq!(faces_touched(&at(eye + forward), eye), 1 << face);
            assert_eq!(
                faces_touched(&at(eye + forward + right), eye).count_ones(),
                2
            );
            assert_eq!(faces_touched(&at(eye), eye), 0x3f);
        }
    }

    proptest::proptest! {
        /// Checks that the box of a vertex that the shader places in a face's pyramid is drawn for that face.
        #[test]
        fn no_visible_vertex_is_culled(
            eye in proptest::array::uniform3(-1e3f32..1e3),
            vertex in proptest::array::uniform3(-1e3f32..1e3),
            other in proptest::array::uniform3(-1e3f32..1e3),
            scale in -20i32..20,
        ) {
            let scale = (scale as f32).exp2();
            let [eye, vertex, other] = [eye, vertex, other].map(|v| Vec3::from(v) * scale);
            let bounds = Aabb { min: vertex.min(other), max: vertex.max(other) };
            let faces = faces_touched(&bounds, eye);
            let d = vertex - eye;
            for face in 0..6 {
                let [f, r, u] = crate::cube::face_basis(face).map(|axis| axis.dot(d));
                if f > 0.0 && r.abs() <= f && u.abs() <= f {
                    proptest::prop_assert!(faces & (1 << face) != 0, "face {face} misses {vertex}");
                }
            }
        }

        /// Checks that every triangle that is not degenerate is drawn once, and coincident triangles in id
        /// order.
        #[test]
        fn drawing_order_is_permutation(
            points in proptest::collection::vec(proptest::array::uniform3(-2i8..3), 3..60),
        ) {
            let vertex = |i: usize| Vec3::from(points[i % points.len()].map(f32::from));
            let triangles: Vec<_> = (0..points.len())
                .map(|i| Triangle { v: [vertex(i), vertex(i * 7 + 1), vertex(i * 5 + 2)] })
                .collect();
            let objects =
                vec![Object { name: String::new(), first: 0, count: triangles.len() as u32 }];
            let scene = Scene::new("test", triangles.clone(), objects).unwrap();
            let order = drawing_order(&scene);
            let mut sorted = order.clone();
            sorted.sort_unstable();
            let area = |i: &u32| !triangles[*i as usize].is_degenerate();
            let visible: Vec<u32> = (0..scene.len()).filter(area).collect();
            proptest::prop_assert_eq!(sorted, visible);
            let place = |id: u32| order.iter().position(|o| *o == id);
            for (a, b) in (0..scene.len()).flat_map(|a| (0..a).map(move |b| (b, a))) {
                if triangles[a as usize] == triangles[b as usize] {
                    proptest::prop_assert!(place(a) <= place(b));
                }
            }
        }
    }
}
