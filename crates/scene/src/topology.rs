//! Topology of a triangle soup: its closed solids, the directions they face, and duplicate triangles.
//!
//! Vertices are equal if their coordinates are equal bit for bit (−0 = 0). Near vertices are not welded, and
//! intersections of solids are not detected.

use std::cmp::Ordering;

use glam::Vec3;
use rayon::prelude::*;
use sightline_geometry::predicates::{Sum, det3, det3_terms, orient3d_sign};
use sightline_numbers::ids::TriangleId;
use sightline_numbers::random::mix;
use sightline_numbers::union_find::UnionFind;

use crate::{Scene, SceneError, Triangle};

/// The closed solids of a scene: for each triangle, the direction in which its normal crosses the surface of
/// a closed solid, if the triangle bounds one.
///
/// A surface is a set of triangles connected by shared edges. A surface is closed if exactly two triangles
/// use each edge, in opposite directions. Triangles without area are ignored. The inner shell of a hollow
/// body is a separate surface, and the cavity counts as its inside.
pub struct Solids {
    /// The direction of the normal of each triangle, by id: +1 out of the solid, −1 into the solid, 0 if the
    /// triangle does not bound a closed solid.
    facing: Vec<i8>,
}

impl Solids {
    /// Finds the closed solids of `scene` by sorting its vertices and edges.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the scene has more than 1 431 655 765 triangles, because their corners are
    /// numbered with 32 bits.
    pub fn find(scene: &Scene) -> Result<Self, SceneError> {
        Self::among(scene, |_| true)
    }

    /// Finds the closed solids of the triangles that block all sight lines. Other triangles are ignored: a
    /// surface that only a see-through triangle closes is not a closed solid.
    ///
    /// # Errors
    /// The errors of [`Solids::find`].
    pub fn find_blocking(scene: &Scene) -> Result<Self, SceneError> {
        Self::among(scene, |id| scene.blocks(TriangleId(id)))
    }

    fn among(scene: &Scene, counts: impl Fn(u32) -> bool) -> Result<Self, SceneError> {
        let corners = corner_vertices(scene)?;
        let n = scene.triangles().len();
        // One key for each directed edge: smaller vertex, larger vertex, triangle, and a bit for the
        // ascending direction.
        let mut edges: Vec<u128> = Vec::with_capacity(3 * n);
        let solid: Vec<bool> = (0..)
            .zip(scene.triangles())
            .map(|(id, t)| !t.is_degenerate() && counts(id))
            .collect();
        for (id, c) in corners
            .chunks_exact(3)
            .enumerate()
            .filter(|(id, _)| solid[*id])
        {
            for (a, b) in [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])] {
                let (lo, hi) = (a.min(b), a.max(b));
                edges.push(
                    u128::from(lo) << 96
                        | u128::from(hi) << 64
                        | (id as u128) << 1
                        | u128::from(a < b),
                );
            }
        }
        edges.par_sort_unstable();
        let mut surface = UnionFind::new(n);
        let triangle = |key: u128| (key as u64 >> 1) as u32;
        let groups = || edges.chunk_by(|a, b| a >> 64 == b >> 64);
        for group in groups() {
            for key in &group[1..] {
                surface.join(triangle(group[0]), triangle(*key));
            }
        }
        let mut closed = vec![true; n];
        for group in groups() {
            if group.len() != 2 || group[0] & 1 == group[1] & 1 {
                closed[surface.root(triangle(group[0])) as usize] = false;
            }
        }
        drop(edges);
        drop(corners);
        let roots: Vec<u32> = (0..n as u32).map(|id| surface.root(id)).collect();
        let signs = volume_signs(scene, &roots, |id| solid[id] && closed[roots[id] as usize]);
        let facing = (0..n)
            .map(|id| {
                match (
                    solid[id] && closed[roots[id] as usize],
                    signs[roots[id] as usize],
                ) {
                    (true, Ordering::Greater) => 1,
                    (true, Ordering::Less) => -1,
                    _ => 0,
                }
            })
            .collect();
        Ok(Self { facing })
    }

    /// Returns +1 if the normal (v1 − v0) × (v2 − v0) of triangle `id` points out of its closed solid, −1 if
    /// the normal points in.
    ///
    /// Returns `None` if the triangle does not bound a closed solid with a volume, or if `id` is not in the
    /// scene.
    pub fn outward(&self, id: TriangleId) -> Option<f32> {
        self.facing
            .get(id.at())
            .filter(|f| **f != 0)
            .map(|f| f32::from(*f))
    }

    /// Returns true if `p` is on the outer side of triangle `id`'s plane.
    ///
    /// If most pixels of a sample at `p` show such triangles, `p` is outside the solids (exterior sample in
    /// Nirenstein and Blake 2004, section 3.6). Returns `None` if the triangle does not bound a closed solid,
    /// or if `p` is in its plane. `scene` must be the scene that `self` was computed from.
    pub fn exterior(&self, scene: &Scene, id: TriangleId, p: Vec3) -> Option<bool> {
        let facing = *self.facing.get(id.at())?;
        let [a, b, c] = scene.triangles().get(id.at())?.v;
        match (facing, orient3d_sign(a, b, c, p)) {
            (0, _) | (_, Ordering::Equal) => None,
            (f, side) => Some((f > 0) == (side == Ordering::Greater)),
        }
    }
}

/// Finds the classes of duplicates: two or more triangles with the same three vertices in any order.
///
/// Each class contains ascending ids, and the classes are in the order of their first ids. Triangles without
/// area are in no class.
///
/// # Errors
/// The errors of [`Solids::find`].
pub fn duplicates(scene: &Scene) -> Result<Vec<Vec<u32>>, SceneError> {
    check_size(scene)?;
    Ok(classes(scene.triangles(), hash))
}

/// Computes the result of [`duplicates`] for the triangles `all`, with the given hash of positions.
fn classes(all: &[Triangle], hash: impl Fn(u128) -> u64 + Sync) -> Vec<Vec<u32>> {
    // The hash does not depend on the order of the vertices, so a sort by hash makes equal triangles
    // neighbours.
    let mut keys: Vec<(u64, u32)> = all
        .par_iter()
        .enumerate()
        .map(|(id, t)| {
            (
                t.v.iter()
                    .fold(0, |sum: u64, v| sum.wrapping_add(hash(position(*v)))),
                id as u32,
            )
        })
        .collect();
    keys.par_sort_unstable();
    let mut classes: Vec<Vec<u32>> = Vec::new();
    for group in keys
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.len() > 1)
    {
        let mut same: Vec<([u128; 3], u32)> = group
            .iter()
            .filter(|(_, id)| !all[*id as usize].is_degenerate())
            .map(|(_, id)| {
                let mut vertices = all[*id as usize].v.map(position);
                vertices.sort_unstable();
                (vertices, *id)
            })
            .collect();
        same.sort_unstable();
        let found = same
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|class| class.len() > 1);
        classes.extend(found.map(|class| class.iter().map(|(_, id)| *id).collect()));
    }
    classes.sort_unstable();
    classes
}

/// Returns the bits of a position: 96 bits, with x in the highest bits. Two results are equal exactly if the
/// coordinates are equal (−0 = 0).
pub fn position(v: Vec3) -> u128 {
    // Adding 0 turns −0 into 0 and preserves all other values.
    let bits = |c: f32| u128::from((c + 0.0).to_bits());
    bits(v.x) << 64 | bits(v.y) << 32 | bits(v.z)
}

/// Computes a 64-bit hash of the result of [`position`].
pub fn hash(position: u128) -> u64 {
    mix((position >> 32) as u64).wrapping_add(mix(u64::from(position as u32)))
}

/// Checks that the corners of a scene can be numbered with 32 bits.
///
/// # Errors
/// The errors of [`Solids::find`].
pub fn check_size(scene: &Scene) -> Result<(), SceneError> {
    let corners = scene.triangles().len() as u64 * 3;
    if corners <= u64::from(u32::MAX) {
        return Ok(());
    }
    Err(SceneError::bad(
        "scene",
        "vertices",
        format!("{corners} triangle corners are more than 32 bits can number"),
        "split the scene into parts of at most 1 431 655 765 triangles",
    ))
}

/// Returns a vertex number for each corner, three for each triangle in id order. Corners have equal numbers
/// exactly if their positions are equal.
///
/// # Errors
/// The errors of [`Solids::find`].
pub fn corner_vertices(scene: &Scene) -> Result<Vec<u32>, SceneError> {
    check_size(scene)?;
    let corners = scene.triangles().len() as u64 * 3;
    // The position is in the upper 96 bits, and the corner in the lower 32.
    let mut keys: Vec<u128> = Vec::with_capacity(corners as usize);
    for v in scene.triangles().iter().flat_map(|t| &t.v) {
        keys.push(position(*v) << 32 | keys.len() as u128);
    }
    keys.par_sort_unstable();
    let mut ids = vec![0u32; keys.len()];
    for (id, group) in keys.chunk_by(|a, b| a >> 32 == b >> 32).enumerate() {
        for key in group {
            ids[*key as u32 as usize] = id as u32;
        }
    }
    Ok(ids)
}

/// Computes the sign of the volume of each closed surface, at the index of the surface's root in `roots`.
///
/// The sum is rounded first. Let o be a vertex of the surface and n the number of triangles. Each term's
/// error is at most 10u times the magnitudes of its products (see [`orient3d_sign`]), and adding n terms
/// loses at most about nu times their sum. So (n + 16)·2u times the sum of magnitudes is a safe bound for n <
/// 2³². If the bound does not determine the sign, the terms are added exactly, which needs no reference
/// point.
fn volume_signs(scene: &Scene, roots: &[u32], counts: impl Fn(usize) -> bool) -> Vec<Ordering> {
    let n = roots.len();
    let mut total = vec![(0.0f64, 0.0f64, 0u32); n];
    for (id, t) in scene
        .triangles()
        .iter()
        .enumerate()
        .filter(|(id, _)| counts(*id))
    {
        let o = scene.triangles()[roots[id] as usize].v[0].as_dvec3();
        let [a, b, c] = t.v.map(|v| (v.as_dvec3() - o).to_array());
        let (det, magnitude) = det3(a, b, c);
        let sum = &mut total[roots[id] as usize];
        *sum = (sum.0 + det, sum.1 + magnitude, sum.2 + 1);
    }
    let open =
        |s: &(f64, f64, u32)| s.2 > 0 && s.0.abs() <= (f64::from(s.2) + 16.0) * f64::EPSILON * s.1;
    let mut signs: Vec<Ordering> = total
        .iter()
        .map(|s| s.0.partial_cmp(&0.0).unwrap_or(Ordering::Equal))
        .collect();
    // The triangles of surfaces whose sign the bound does not determine, grouped by surface.
    let mut again: Vec<(u32, u32)> = (0..n)
        .filter(|id| counts(*id) && open(&total[roots[*id] as usize]))
        .map(|id| (roots[id], id as u32))
        .collect();
    again.sort_unstable();
    for group in again.chunk_by(|a, b| a.0 == b.0) {
        let mut sum = Sum::default();
        for (_, id) in group {
            let [a, b, c] = scene.triangles()[*id as usize].v;
            det3_terms(a, b, c)
                .into_iter()
                .for_each(|term| sum.add(term));
        }
        signs[group[0].0 as usize] = sum.sign();
    }
    signs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Kinds, Object, SurfaceKind};

    /// Creates the twelve triangles of a box, facing outwards.
    fn cube(at: Vec3, size: f32) -> Vec<Triangle> {
        let p =
            |i: u32| at + size * Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
        [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ]
        .iter()
        .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
        .map(|t| Triangle { v: t.map(p) })
        .collect()
    }

    fn scene(triangles: Vec<Triangle>) -> Scene {
        let count = triangles.len() as u32;
        Scene::new(
            "test",
            triangles,
            vec![Object {
                name: "all".into(),
                first: 0,
                count,
            }],
        )
        .unwrap()
    }

    fn flipped(t: &Triangle) -> Triangle {
        Triangle {
            v: [t.v[0], t.v[2], t.v[1]],
        }
    }

    #[test]
    fn cubes_face_out_flipped_cubes_in_and_open_cubes_neither() {
        let mut soup = cube(Vec3::ZERO, 1.0);
        soup.extend(cube(Vec3::splat(1e6), 0.5).iter().map(flipped));
        soup.extend_from_slice(&cube(Vec3::splat(-9.0), 1.0)[..11]);
        let mut twisted = cube(Vec3::splat(20.0), 1.0);
        twisted[5] = flipped(&twisted[5]);
        soup.extend(twisted);
        let s = scene(soup);
        let solids = Solids::find(&s).unwrap();
        let facing: Vec<Option<f32>> = (0..47).map(|id| solids.outward(TriangleId(id))).collect();
        assert_eq!(facing[..12], [Some(1.0); 12]);
        assert_eq!(facing[12..24], [Some(-1.0); 12]);
        assert_eq!(facing[24..], [None; 23]);
        assert_eq!(solids.outward(TriangleId(47)), None);
        assert_eq!(
            solids.exterior(&s, TriangleId(0), Vec3::new(0.5, 0.5, -1.0)),
            Some(true)
        );
        assert_eq!(
            solids.exterior(&s, TriangleId(0), Vec3::splat(0.5)),
            Some(false)
        );
        assert_eq!(
            solids.exterior(&s, TriangleId(0), Vec3::new(7.0, 7.0, 0.0)),
            None
        );
        assert_eq!(
            solids.exterior(&s, TriangleId(12), Vec3::splat(1e6 + 0.25)),
            Some(false)
        );
    }

    #[test]
    fn degenerate_triangles_neither_close_nor_open_a_solid() {
        let mut soup = cube(Vec3::ZERO, 1.0);
        soup.push(Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::ZERO],
        });
        soup.push(Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::X * 0.5],
        });
        let solids = Solids::find(&scene(soup)).unwrap();
        assert_eq!(solids.outward(TriangleId(0)), Some(1.0));
        assert_eq!(solids.outward(TriangleId(12)), None);
        assert_eq!(solids.outward(TriangleId(13)), None);
    }

    #[test]
    fn see_through_side_opens_solid_of_blocking_triangles() {
        let kinds = |see_through: u32| {
            let runs = [
                (12 - see_through, SurfaceKind::Opaque, "a test"),
                (see_through, SurfaceKind::SeeThrough, "a test"),
            ];
            let runs = runs.into_iter().filter(|r| r.0 > 0);
            scene(cube(Vec3::ZERO, 1.0))
                .with_kinds("test", Kinds::from_runs(runs, Vec::new()))
                .unwrap()
        };
        assert_eq!(
            Solids::find(&kinds(1)).unwrap().outward(TriangleId(0)),
            Some(1.0)
        );
        let open = Solids::find_blocking(&kinds(1)).unwrap();
        assert!((0..12).all(|id| open.outward(TriangleId(id)).is_none()));
        assert_eq!(
            Solids::find_blocking(&kinds(0))
                .unwrap()
                .outward(TriangleId(0)),
            Some(1.0)
        );
    }

    #[test]
    fn doubled_sheet_has_no_inside() {
        let t = Triangle {
            v: [
                Vec3::new(1.1, 2.3, 0.7),
                Vec3::new(5.9, 0.1, 0.3),
                Vec3::new(0.2, 0.9, 8.7),
            ],
        };
        let solids = Solids::find(&scene(vec![t, flipped(&t)])).unwrap();
        assert_eq!(
            (solids.outward(TriangleId(0)), solids.outward(TriangleId(1))),
            (None, None)
        );
    }

    #[test]
    fn flat_far_tetrahedron_is_decided_exactly() {
        // The height is one unit in the last place, far from the origin.
        let s = 8_388_608.0f32;
        let p = [
            [s, s, s],
            [s + 64.0, s, s],
            [s, s + 64.0, s],
            [s + 1.0, s + 1.0, s + 1.0],
        ]
        .map(Vec3::from);
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let soup: Vec<Triangle> = faces
            .iter()
            .map(|f| Triangle { v: f.map(|i| p[i]) })
            .collect();
        assert_eq!(
            Solids::find(&scene(soup.clone()))
                .unwrap()
                .outward(TriangleId(2)),
            Some(1.0)
        );
        let inverted: Vec<Triangle> = soup.iter().map(flipped).collect();
        assert_eq!(
            Solids::find(&scene(inverted))
                .unwrap()
                .outward(TriangleId(2)),
            Some(-1.0)
        );
    }

    #[test]
    fn zeros_of_either_sign_are_one_vertex() {
        let mut soup = cube(Vec3::ZERO, 1.0);
        for v in &mut soup[3].v {
            *v = v.map(|c| if c == 0.0 { -0.0 } else { c });
        }
        assert_eq!(
            Solids::find(&scene(soup)).unwrap().outward(TriangleId(3)),
            Some(1.0)
        );
    }

    #[test]
    fn duplicates_are_found_in_any_vertex_order() {
        let mut soup = cube(Vec3::ZERO, 1.0);
        let again = [
            flipped(&soup[7]),
            soup[2],
            Triangle {
                v: [soup[7].v[2], soup[7].v[0], soup[7].v[1]],
            },
        ];
        soup.extend(again);
        soup.extend([Triangle { v: [Vec3::ONE; 3] }; 2]);
        assert_eq!(
            duplicates(&scene(soup)).unwrap(),
            [vec![2, 13], vec![7, 12, 14]]
        );
        assert!(
            duplicates(&scene(cube(Vec3::ZERO, 1.0)))
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn duplicates_may_have_zeros_of_either_sign() {
        let mut soup = cube(Vec3::ZERO, 1.0);
        soup.push(Triangle {
            v: soup[4]
                .v
                .map(|v| v.map(|c| if c == 0.0 { -0.0 } else { c })),
        });
        assert_eq!(duplicates(&scene(soup)).unwrap(), [vec![4, 12]]);
    }

    #[test]
    fn triangles_of_one_hash_are_distinguished() {
        let soup = cube(Vec3::ZERO, 1.0);
        let again = [flipped(&soup[7]), soup[2], soup[7]];
        let soup = [
            soup,
            again.to_vec(),
            vec![Triangle { v: [Vec3::ONE; 3] }; 2],
        ]
        .concat();
        assert_eq!(classes(&soup, |_| 0), [vec![2, 13], vec![7, 12, 14]]);
    }
}
