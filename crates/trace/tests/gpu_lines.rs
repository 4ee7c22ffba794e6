//! Tests that compare the GPU line tracer with a brute-force tracer in f64, and check that no ray leaves a
//! closed mesh.
//!
//! Without a Vulkan adapter each test prints one line and returns; under `CI` it fails.

#![allow(
    clippy::print_stdout,
    clippy::panic,
    clippy::unwrap_used,
    reason = "helpers of tests, which may"
)]

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use sightline_scene::{Object, Scene, Triangle};
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::packet::{Halves, LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeSpec, LineSet, SKY, Strata, Tracer, TracerError};

fn backend(triangles: &[Triangle]) -> Option<GpuBackend> {
    let objects = vec![Object {
        name: "test".into(),
        first: 0,
        count: triangles.len() as u32,
    }];
    let scene = Arc::new(Scene::new("test", triangles.to_vec(), objects).expect("a valid scene"));
    let spec = CubeSpec {
        resolution: 16,
        strata: Strata::One,
        keep_pixels: false,
    };
    match GpuBackend::new(scene, spec, AdapterChoice::AllowSoftware) {
        Ok(backend) => Some(backend),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            println!("not run: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Returns a random number below `n`.
fn below(random: &mut Hashed, n: usize) -> usize {
    (random.bits() % n as u64) as usize
}

/// Returns a random point of the cube −1…1.
fn point(random: &mut Hashed) -> Vec3 {
    random.point() * 2.0 - 1.0
}

fn packed(rays: &[(Vec3, Vec3)]) -> Vec<Packet> {
    rays.chunks(LANES)
        .map(|run| {
            let mut packet = Packet::default();
            run.iter()
                .for_each(|(o, d)| packet.push(o.to_array(), d.to_array()));
            packet
        })
        .collect()
}

/// Returns more ids than any scene here has. Ids that the scene lacks are ignored.
fn any() -> Vec<u32> {
    (0..1 << 20).collect()
}

/// Returns the (triangle, distance) of each ray.
fn traced(backend: &GpuBackend, rays: &[(Vec3, Vec3)]) -> Vec<(u32, f32)> {
    let mut packets = packed(rays);
    backend
        .lines(LineSet::Blocking, &any())
        .unwrap()
        .trace(&mut packets, Halves::Rays, true)
        .unwrap();
    packets
        .iter()
        .flat_map(|p| (0..p.count).map(|l| (p.triangle[l], p.distance[l])))
        .collect()
}

/// Returns the distance of a hit (Möller and Trumbore 1997).
fn hit(t: &Triangle, o: DVec3, d: DVec3) -> Option<f64> {
    let [a, b, c] = t.v.map(|v| v.as_dvec3());
    let (e, f) = (b - a, c - a);
    let p = d.cross(f);
    let inverse = 1.0 / e.dot(p);
    let s = o - a;
    let u = s.dot(p) * inverse;
    let q = s.cross(e);
    let v = d.dot(q) * inverse;
    let t = f.dot(q) * inverse;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-12).then_some(t)
}

#[test]
fn nearest_triangle_equals_brute_force() {
    let mut random = Hashed::new(&[0x1234_5678_9abc_def1]);
    let triangles: Vec<Triangle> = (0..400)
        .map(|_| {
            let c = point(&mut random);
            Triangle {
                v: [0; 3].map(|_| c + point(&mut random) * 0.3),
            }
        })
        .collect();
    let Some(backend) = backend(&triangles) else {
        return;
    };
    let rays: Vec<_> = (0..20_000)
        .map(|i| {
            // Directions of many lengths, some along an axis.
            let length = ((i % 41) as f32 - 20.0).exp2();
            let d = if i % 10 == 0 {
                Vec3::AXES[i / 10 % 3]
            } else {
                point(&mut random)
            };
            (point(&mut random) * 1.5, d * length)
        })
        .collect();
    let (mut met, mut near_edges) = (0, 0);
    for ((o, d), (id, distance)) in rays.iter().zip(traced(&backend, &rays)) {
        let (o, d) = (o.as_dvec3(), d.as_dvec3());
        let mut all: Vec<(f64, u32)> = triangles
            .iter()
            .zip(0..)
            .filter_map(|(t, id)| Some((hit(t, o, d)?, id)))
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let expected = all.first().map_or((SKY, f64::INFINITY), |h| (h.1, h.0));
        met += u32::from(expected.0 != SKY);
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-4 * b.abs();
        if id == expected.0 {
            // The distance of the hit from the triangle's plane. Along grazing rays the hit distance itself
            // is inaccurate.
            let off = |t: &Triangle| {
                let [a, b, c] = t.v.map(|v| v.as_dvec3());
                (b - a)
                    .cross(c - a)
                    .normalize()
                    .dot(o + d * f64::from(distance) - a)
                    .abs()
            };
            // Coordinates are below 2, so the limit is a few units in the last place.
            assert!(
                id == SKY || off(&triangles[id as usize]) <= 1e-6,
                "{distance} {expected:?}"
            );
        } else if !(all.len() > 1 && close(all[0].0, all[1].0)) {
            // The other differences are rays so near a triangle's border that rounding decides the side.
            let shrunk = |t: &Triangle, k: f32| {
                let c = (t.v[0] + t.v[1] + t.v[2]) / 3.0;
                Triangle {
                    v: t.v.map(|v| c + (v - c) * k),
                }
            };
            let triangle_at = |id: u32| &triangles[id as usize];
            let on_border = |id: u32| {
                id != SKY
                    && hit(&shrunk(triangle_at(id), 1.0 + 1e-5), o, d).is_some()
                    && hit(&shrunk(triangle_at(id), 1.0 - 1e-5), o, d).is_none()
            };
            assert!(
                on_border(id) || on_border(expected.0),
                "{o} {d}: {id} at {distance}, not {expected:?}"
            );
            near_edges += 1;
        }
    }
    assert!(met > 5_000, "{met}");
    assert!(near_edges <= 5, "{near_edges}");
}

/// Returns a sphere of radius 1: an icosahedron whose triangles are divided into four `cuts` times. Triangles
/// share vertices to the bit.
fn icosphere(cuts: u32) -> (Vec<Vec3>, Vec<[usize; 3]>) {
    let g = f32::midpoint(1.0, 5f32.sqrt());
    let mut points: Vec<Vec3> = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        for v in [
            Vec3::new(0.0, a, b),
            Vec3::new(a, b, 0.0),
            Vec3::new(b, 0.0, a),
        ] {
            points.push(v.normalize());
        }
    }
    let near = |a: usize, b: usize| points[a].distance(points[b]) < 1.1;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            faces.extend(
                (b + 1..12)
                    .filter(|c| near(a, b) && near(b, *c) && near(a, *c))
                    .map(|c| [a, b, c]),
            );
        }
    }
    assert_eq!(faces.len(), 20);
    for _ in 0..cuts {
        let mut middles = BTreeMap::new();
        let mut middle = |a: usize, b: usize| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a] + points[b]).normalize());
                points.len() - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let [x, y, z] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, x, z], [b, y, x], [c, z, y], [x, y, z]]
            })
            .collect();
    }
    (points, faces)
}

/// Returns the cube −1…1 with n × n squares of two triangles on each side. A third of the corners are moved
/// at random.
fn crumpled_box(n: i32, random: &mut Hashed) -> (Vec<Vec3>, Vec<[usize; 3]>) {
    let (mut points, mut known, mut faces) = (Vec::new(), BTreeMap::new(), Vec::new());
    let mut corner = |p: [i32; 3]| {
        *known.entry(p).or_insert_with(|| {
            let exact = Vec3::from(p.map(|x| x as f32)) * 2.0 / n as f32 - 1.0;
            let moved = if (p[0] + p[1] + p[2]) % 3 == 0 {
                point(random) * 0.3 / n as f32
            } else {
                Vec3::ZERO
            };
            points.push(exact + moved);
            points.len() - 1
        })
    };
    for axis in 0..3 {
        for (side, i, j) in [0, n]
            .iter()
            .flat_map(|s| (0..n * n).map(|k| (*s, k % n, k / n)))
        {
            let mut at = |di: i32, dj: i32| {
                let mut p = [0; 3];
                p[axis] = side;
                p[(axis + 1) % 3] = i + di;
                p[(axis + 2) % 3] = j + dj;
                corner(p)
            };
            let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    (points, faces)
}

/// Returns rays from inside at vertices, edges and triangles, and along the axes. A direction is `length`
/// times the vector from the origin to the target.
fn inside_rays(
    points: &[Vec3],
    faces: &[[usize; 3]],
    centre: Vec3,
    size: f32,
    length: f32,
    count: usize,
    random: &mut Hashed,
) -> Vec<(Vec3, Vec3)> {
    (0..count)
        .map(|i| {
            let at_centre = i % 5 == 0;
            let o = if at_centre {
                centre
            } else {
                centre + point(random) * (0.4 * size)
            };
            let f = faces[below(random, faces.len())].map(|v| points[v]);
            let k = below(random, 3);
            let target = match i % 4 {
                0 => f[k],
                1 => (f[k] + f[(k + 1) % 3]) * 0.5,
                2 => f[k] + (f[(k + 1) % 3] - f[k]) * random.unit(),
                _ => {
                    f[0] + (f[1] - f[0]) * (random.unit() * 0.5)
                        + (f[2] - f[0]) * (random.unit() * 0.5)
                }
            };
            let axis = Vec3::AXES[below(random, 3)] * size;
            let d = match i % 97 {
                0 => axis,
                1 => -axis,
                _ => target - o,
            };
            (o, d * length)
        })
        .collect()
}

#[test]
fn rays_do_not_leave_closed_mesh() {
    let mut random = Hashed::new(&[0xfeed_beef_0bad_cafe]);
    let meshes = [icosphere(4), crumpled_box(24, &mut random)];
    let mut number = 0;
    for (points, faces) in &meshes {
        for (scale, offset) in [
            (1.0, 0.0),
            (1e-6, 0.0),
            (1e6, 0.0),
            (1.0, 300.0),
            (1e-28, 0.0),
            (5e8, 0.0),
        ] {
            // An offset rounds the vertices equally for all triangles that share them. The near distance
            // grows with the scene but is measured in lengths of the direction.
            let length = if scale > 1e8 { 1.0 / scale } else { 1.0 };
            let centre = Vec3::new(offset, -0.7 * offset, 0.3 * offset) * scale;
            let points: Vec<Vec3> = points.iter().map(|p| *p * scale + centre).collect();
            let triangles: Vec<Triangle> = faces
                .iter()
                .map(|f| Triangle {
                    v: f.map(|v| points[v]),
                })
                .collect();
            let Some(backend) = backend(&triangles) else {
                return;
            };
            let rays = inside_rays(&points, faces, centre, scale, length, 60_000, &mut random);
            let hits = traced(&backend, &rays);
            let misses = hits.iter().filter(|h| h.0 == SKY).count();
            assert_eq!(
                misses,
                0,
                "of {} rays, scale {scale}, offset {offset}",
                rays.len()
            );
            for (i, ((o, d), (id, distance))) in rays.iter().zip(&hits).enumerate() {
                // The ray was aimed at a point of the surface.
                if i % 97 > 1 && offset == 0.0 && faces.len() == 5120 {
                    assert!(
                        (distance * length - 1.0).abs() < 1e-4,
                        "{o} {d} meets {id} at {distance}"
                    );
                }
            }
            number += rays.len();
        }
    }
    println!("{number} rays, none lost");
}

#[test]
fn repeated_and_split_calls_have_same_bits() {
    let mut random = Hashed::new(&[77]);
    let triangles: Vec<Triangle> = (0..5_000)
        .map(|_| {
            let c = point(&mut random);
            Triangle {
                v: [0; 3].map(|_| c + point(&mut random) * 0.05),
            }
        })
        .collect();
    let (Some(one), Some(two)) = (backend(&triangles), backend(&triangles)) else {
        return;
    };
    let rays: Vec<_> = (0..100_003)
        .map(|_| (point(&mut random), point(&mut random)))
        .collect();
    let bits = |packets: &[Packet]| -> Vec<_> {
        packets
            .iter()
            .map(|p| (p.distance.map(f32::to_bits), p.triangle))
            .collect()
    };
    let mut whole = packed(&rays);
    one.lines(LineSet::Blocking, &any())
        .unwrap()
        .trace(&mut whole, Halves::Rays, true)
        .unwrap();
    assert!(whole.iter().filter(|p| p.triangle[0] != SKY).count() > 1000);
    for (backend, portion) in [
        (&one, usize::MAX),
        (&two, 7000),
        (&two, 501),
        (&one, 13_000),
    ] {
        let mut again = packed(&rays);
        let tracer = backend.lines(LineSet::Blocking, &any()).unwrap();
        again
            .chunks_mut(portion)
            .for_each(|run| tracer.trace(run, Halves::Rays, false).unwrap());
        assert!(bits(&whole) == bits(&again), "portions of {portion}");
    }
}

#[test]
fn handles_ties_degenerate_triangles_and_rays_from_walls() {
    let square = |x: f32| {
        let at = |y: f32, z: f32| Vec3::new(x, y, z);
        [
            Triangle {
                v: [at(-1., -1.), at(1., -1.), at(1., 1.)],
            },
            Triangle {
                v: [at(-1., -1.), at(1., 1.), at(-1., 1.)],
            },
        ]
    };
    let line = Triangle {
        v: [
            Vec3::new(1.0, -1.0, 0.0),
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(1.0, 1.0, 0.0),
        ],
    };
    let mut triangles = vec![line];
    triangles.extend(square(3.0));
    triangles.extend(square(2.0));
    triangles.extend(square(2.0));
    triangles.extend(square(0.0));
    let Some(backend) = backend(&triangles) else {
        return;
    };
    let below = Vec3::new(0.0, 0.3, -0.2);
    let rays = [
        // The ray begins in the wall at 0, passes the degenerate triangle at 1, and hits two coincident walls
        // at 2.
        (below, Vec3::X),
        (below, Vec3::new(1.0, 0.1, 0.05)),
        (below, Vec3::new(0.01, 0.02, -0.5)),
        (below + Vec3::X, -2.0 * Vec3::X),
        (below + 2.5 * Vec3::X, Vec3::X),
        (below, Vec3::ZERO),
        (below, Vec3::NAN),
        (Vec3::splat(f32::INFINITY), Vec3::X),
        // Rays in the plane of a wall meet it edge-on.
        (Vec3::new(3.0, 5.0, 0.0), Vec3::Y),
        (Vec3::new(0.0, -5.0, 0.0), Vec3::Y),
    ];
    let hits = traced(&backend, &rays);
    let expected = [(3, 2.0), (3, 2.0), (SKY, f32::INFINITY), (7, 0.5), (1, 0.5)];
    assert_eq!(&hits[..5], &expected);
    assert!(
        hits[5..].iter().all(|h| *h == (SKY, f32::INFINITY)),
        "{hits:?}"
    );

    let Some(nothing) = self::backend(&[line]) else {
        return;
    };
    assert_eq!(traced(&nothing, &rays[..1]), [(SKY, f32::INFINITY)]);
}
