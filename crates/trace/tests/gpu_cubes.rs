//! Tests that compare the cubes of the GPU backend with a ray caster in f64 and with the reference reduction.
//!
//! Without a Vulkan adapter each test prints one line and returns; under `CI` it fails.

#![allow(
    clippy::print_stdout,
    clippy::panic,
    clippy::unwrap_used,
    reason = "helpers of tests, which may"
)]

use std::sync::Arc;

use glam::{DVec3, Vec3};
use sightline_scene::{Object, Scene, Triangle};
use sightline_trace::cube::{face_basis, sample_of_image};
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeImage, CubeSpec, SKY, Strata, Tracer, TracerError};

fn scene(triangles: Vec<Triangle>) -> Arc<Scene> {
    let objects = vec![Object {
        name: "test".into(),
        first: 0,
        count: triangles.len() as u32,
    }];
    Arc::new(Scene::new("test", triangles, objects).expect("a valid scene"))
}

fn backend(
    scene: &Arc<Scene>,
    resolution: u32,
    strata: Strata,
    keep_pixels: bool,
) -> Option<GpuBackend> {
    let spec = CubeSpec {
        resolution,
        strata,
        keep_pixels,
    };
    match GpuBackend::new(scene.clone(), spec, AdapterChoice::AllowSoftware) {
        Ok(backend) => {
            println!("adapter: {}", backend.profile());
            Some(backend)
        }
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            println!("not run: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn triangle(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> Triangle {
    Triangle {
        v: [a.into(), b.into(), c.into()],
    }
}

/// Returns the cube of half side `h` around `centre`, with two triangles per side. Side s, numbered like the
/// faces, has the ids 2s and 2s + 1.
fn room(centre: Vec3, h: f32) -> Vec<Triangle> {
    (0..6)
        .flat_map(|face| {
            let [f, r, u] = face_basis(face).map(|v| v * h);
            let corner = |a: f32, b: f32| centre + f + r * a + u * b;
            let [a, b, c, d] = [
                corner(-1., -1.),
                corner(1., -1.),
                corner(1., 1.),
                corner(-1., 1.),
            ];
            [Triangle { v: [a, b, c] }, Triangle { v: [a, c, d] }]
        })
        .collect()
}

/// Returns random triangles in the unit cube.
fn triangles(random: &mut Hashed, count: usize, size: f32) -> Vec<Triangle> {
    (0..count)
        .map(|_| {
            let c = random.point();
            Triangle {
                v: [0; 3].map(|_| c + (random.point() - 0.5) * size),
            }
        })
        .collect()
}

/// Returns the direction of the point (`x`, `y`) of a face, in pixels, by the cube's conventions, in f64.
fn direction(face: u32, x: f64, y: f64, n: u32) -> DVec3 {
    let [f, r, u] = face_basis(face).map(|v| v.as_dvec3());
    let n = f64::from(n);
    f + r * ((2.0 * x + 1.0) / n - 1.0) + u * ((2.0 * y + 1.0) / n - 1.0)
}

/// Returns the distance along `d` at which the ray hits the triangle. Hits count on both sides and on edges.
fn hit(t: &Triangle, eye: DVec3, d: DVec3) -> Option<f64> {
    let [a, b, c] = t.v.map(|v| v.as_dvec3() - eye);
    let volumes = [d.dot(b.cross(c)), d.dot(c.cross(a)), d.dot(a.cross(b))];
    if volumes.iter().any(|v| *v < 0.0) && volumes.iter().any(|v| *v > 0.0) {
        return None;
    }
    let normal = (b - a).cross(c - a);
    let t = normal.dot(a) / normal.dot(d);
    (t > 0.0).then_some(t)
}

fn cast(triangles: &[Triangle], eye: DVec3, d: DVec3) -> u32 {
    let mut best = (f64::INFINITY, SKY);
    for (id, t) in (0..).zip(triangles) {
        if let Some(distance) = hit(t, eye, d)
            && distance < best.0
        {
            best = (distance, id);
        }
    }
    best.1
}

/// Compares a cube with the ray caster and returns the number of pixels that differ. For each such pixel, a
/// ray within `slack` pixels of its centre must hit the triangle that the cube shows.
fn differing(triangles: &[Triangle], eye: Vec3, image: &CubeImage, slack: f64) -> usize {
    let n = image.resolution;
    let eye = eye.as_dvec3();
    let mut wrong = 0;
    for (i, &seen) in (0u32..).zip(&image.ids) {
        let (face, x, y) = (i / (n * n), i % n, i / n % n);
        let at = |dx: f64, dy: f64| {
            cast(
                triangles,
                eye,
                direction(
                    face,
                    f64::from(x) + dx * slack,
                    f64::from(y) + dy * slack,
                    n,
                ),
            )
        };
        if at(0.0, 0.0) == seen {
            continue;
        }
        wrong += 1;
        let near = (0..16).any(|k| {
            let (s, c) = (f64::from(k) * std::f64::consts::TAU / 16.0).sin_cos();
            [0.25, 0.5, 1.0].iter().any(|r| at(c * r, s * r) == seen)
        });
        assert!(
            near,
            "face {face}, pixel ({x}, {y}) shows {seen}, the ray meets {}",
            at(0.0, 0.0)
        );
    }
    wrong
}

#[test]
fn each_face_of_room_shows_its_wall() {
    let scene = scene(room(Vec3::new(1.0, 2.0, 3.0), 2.0));
    let Some(backend) = backend(&scene, 33, Strata::Faces, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    let centre = renderer.image(Vec3::new(1.0, 2.0, 3.0)).unwrap();
    for (i, id) in centre.ids.iter().enumerate() {
        assert_eq!(*id / 2, i as u32 / (33 * 33), "pixel {i} shows {id}");
    }
    for eye in [
        [1.0, 2.0, 3.0],
        [0.3, 2.9, 1.7],
        [2.9, 0.1, 4.9],
        [1.7, 2.0, 3.1],
    ] {
        let eye = Vec3::from(eye);
        let image = renderer.image(eye).unwrap();
        assert!(
            image.ids.iter().all(|id| *id != SKY),
            "a closed room shows sky from {eye}"
        );
        let wrong = differing(scene.triangles(), eye, &image, 1.0 / 64.0);
        // The diagonals of a centred view run through pixel centres.
        assert!(wrong <= 6 * 33 * 2, "{wrong} pixels differ from {eye}");
    }
}

/// Checks that left and right, and top and bottom, are not swapped, with a small quad off centre on each
/// face.
#[test]
fn faces_have_correct_orientation() {
    let n = 32;
    let triangles: Vec<_> = (0..6)
        .flat_map(|face| {
            let [f, r, u] = face_basis(face);
            // The quad covers u in (0.25, 0.75) and v in (-0.5, -0.25): columns 20 to 27, rows 8 to 11.
            let corner = |a: f32, b: f32| f + r * a + u * b;
            let [a, b, c, d] = [
                corner(0.25, -0.5),
                corner(0.75, -0.5),
                corner(0.75, -0.25),
                corner(0.25, -0.25),
            ];
            [Triangle { v: [a, b, c] }, Triangle { v: [a, c, d] }]
        })
        .collect();
    let scene = scene(triangles);
    let Some(backend) = backend(&scene, n, Strata::Quadrants, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    let image = renderer.image(Vec3::ZERO).unwrap();
    for (i, id) in (0u32..).zip(&image.ids) {
        let (face, x, y) = (i / (n * n), i % n, i / n % n);
        let inside = (20..28).contains(&x) && (8..12).contains(&y);
        assert_eq!(*id != SKY, inside, "face {face}, pixel ({x}, {y})");
        assert!(!inside || id / 2 == face);
    }
    let sample = &renderer.samples(&[Vec3::ZERO]).unwrap()[0];
    assert_eq!(sample.ids, (0..12).collect::<Vec<_>>());
    // Quadrant 1 (right, lower half) of each face.
    assert!(
        sample
            .ids
            .iter()
            .zip(&sample.strata)
            .all(|(id, mask)| *mask == 1 << (id / 2 * 4 + 1))
    );
}

#[test]
fn random_triangles_are_seen_where_rays_meet_them() {
    let mut random = Hashed::new(&[7]);
    let scene = scene(triangles(&mut random, 600, 0.35));
    let Some(backend) = backend(&scene, 64, Strata::Faces, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    // Inside, among triangles that cross the eye's planes, and outside.
    for eye in [random.point(), random.point(), Vec3::new(-1.5, 0.4, 2.5)] {
        let image = renderer.image(eye).unwrap();
        let wrong = differing(scene.triangles(), eye, &image, 1.0 / 64.0);
        println!("{wrong} pixels of {} differ from {eye}", image.ids.len());
        assert!(
            wrong * 1000 <= image.ids.len(),
            "{wrong} pixels differ from {eye}"
        );
    }
}

/// Checks huge triangles above, below and next to the eye, which cross the eye plane of every face.
#[test]
fn triangles_that_cross_eye_plane_are_clipped_correctly() {
    let far = 1000.0;
    let triangles = vec![
        triangle([-far, -far, -0.1], [far, -far, -0.1], [0.0, far, -0.1]),
        triangle([-far, -0.3, -far], [far, -0.2, -far], [0.0, -0.25, far]),
        triangle([0.5, -far, -far], [0.4, far, -far], [0.6, 0.0, far]),
        triangle([-3.0, 2.0, -far], [3.0, 2.5, far], [-2.0, 2.0, far]),
        triangle(
            [-0.02, -0.01, -0.05],
            [0.02, -0.015, 0.06],
            [0.0, 0.01, -0.04],
        ),
    ];
    let scene = scene(triangles);
    let Some(backend) = backend(&scene, 64, Strata::One, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    for eye in [
        Vec3::ZERO,
        Vec3::new(0.01, 0.02, 0.003),
        Vec3::new(-0.2, 0.1, 0.4),
    ] {
        let image = renderer.image(eye).unwrap();
        let wrong = differing(scene.triangles(), eye, &image, 1.0 / 64.0);
        assert!(
            wrong * 1000 <= image.ids.len(),
            "{wrong} pixels differ from {eye}"
        );
    }
}

#[test]
fn very_small_and_very_large_coordinates_can_be_mixed() {
    // In metres: four walls two millimetres apart, inside a room of two thousand kilometres.
    let mut triangles = room(Vec3::ZERO, 1e6);
    triangles.extend(room(Vec3::ZERO, 1e-3).into_iter().take(8));
    let scene = scene(triangles);
    let Some(backend) = backend(&scene, 64, Strata::Faces, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    for eye in [
        Vec3::ZERO,
        Vec3::new(3e-4, -9e-4, 9.9e-4),
        Vec3::new(5e5, -2e3, 7.0),
    ] {
        let image = renderer.image(eye).unwrap();
        let wrong = differing(scene.triangles(), eye, &image, 1.0 / 64.0);
        assert!(wrong <= 6 * 64 * 2, "{wrong} pixels differ from {eye}");
        assert!(image.ids.iter().all(|id| *id != SKY));
    }
}

#[test]
fn device_reduction_equals_reference() {
    let mut random = Hashed::new(&[11]);
    let mut triangles = triangles(&mut random, 2000, 0.1);
    triangles.extend(room(Vec3::splat(0.5), 1.0).into_iter().take(5));
    let scene = scene(triangles);
    let points: Vec<_> = (0..11).map(|_| random.point()).collect();
    for strata in [Strata::One, Strata::Faces, Strata::Quadrants] {
        // A side of 37 pixels is not a multiple of the segment length, has a middle column and needs padded
        // rows in the read-back.
        for (resolution, keep) in [(64, true), (37, false), (37, true), (1, true)] {
            let Some(backend) = backend(&scene, resolution, strata, keep) else {
                return;
            };
            let renderer = backend.prepare(None).unwrap();
            let samples = renderer.samples(&points).unwrap();
            assert_eq!(samples.len(), points.len());
            for (point, sample) in points.iter().zip(&samples) {
                let image = renderer.image(*point).unwrap();
                assert_eq!(*sample, sample_of_image(&image, strata, keep));
                assert_eq!(sample.pixels.is_some(), keep);
            }
            // A second call, and a call for each point, result in the same bits.
            assert_eq!(samples, renderer.samples(&points).unwrap());
            for (point, sample) in points.iter().zip(&samples) {
                assert_eq!(
                    std::slice::from_ref(sample),
                    renderer.samples(&[*point]).unwrap()
                );
            }
            assert_eq!(renderer.samples(&[]).unwrap(), []);
        }
    }
}

#[test]
fn lists_all_triangles_beyond_first_read() {
    let mut random = Hashed::new(&[5]);
    let scene = scene(triangles(&mut random, 40_000, 0.01));
    let Some(backend) = backend(&scene, 256, Strata::Faces, false) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    let points: Vec<_> = (0..3).map(|_| random.point()).collect();
    for (point, sample) in points.iter().zip(renderer.samples(&points).unwrap()) {
        assert!(sample.ids.len() > 10_000, "{}", sample.ids.len());
        let image = renderer.image(*point).unwrap();
        assert_eq!(sample, sample_of_image(&image, Strata::Faces, false));
    }
}

#[test]
fn superset_shows_only_its_triangles() {
    let mut random = Hashed::new(&[3]);
    let scene = scene(triangles(&mut random, 3000, 0.15));
    let Some(backend) = backend(&scene, 64, Strata::Quadrants, true) else {
        return;
    };
    let whole = backend.prepare(None).unwrap();
    let points: Vec<_> = (0..3).map(|_| random.point()).collect();
    for point in &points {
        let seen = whole.samples(&[*point]).unwrap().remove(0);
        // Rendering only the visible triangles results in the same cube.
        let alone = backend.prepare(Some(&seen.ids)).unwrap();
        assert_eq!(alone.samples(&[*point]).unwrap().remove(0), seen);
    }
    let third: Vec<u32> = (0..3000).step_by(3).collect();
    let part = backend.prepare(Some(&third)).unwrap();
    for sample in part.samples(&points).unwrap() {
        assert!(!sample.ids.is_empty() && sample.ids.iter().all(|id| id % 3 == 0));
    }
    // Two renderers of one backend can be used at the same time.
    let before = whole.samples(&points).unwrap();
    std::thread::scope(|scope| {
        let other = scope.spawn(|| part.samples(&points).unwrap());
        assert_eq!(whole.samples(&points).unwrap(), before);
        assert_eq!(other.join().unwrap(), part.samples(&points).unwrap());
    });
}

#[test]
fn empty_superset_shows_sky() {
    let scene = scene(room(Vec3::ZERO, 1.0));
    let Some(backend) = backend(&scene, 16, Strata::Faces, true) else {
        return;
    };
    let renderer = backend.prepare(Some(&[])).unwrap();
    let image = renderer.image(Vec3::ZERO).unwrap();
    assert_eq!(
        image,
        CubeImage {
            resolution: 16,
            ids: vec![SKY; 6 * 16 * 16]
        }
    );
    let sample = renderer.samples(&[Vec3::ZERO]).unwrap().remove(0);
    assert_eq!(sample, sample_of_image(&image, Strata::Faces, true));
}

#[test]
fn degenerate_triangles_are_never_seen() {
    let mut triangles = room(Vec3::ZERO, 3.0);
    let seen = triangles.len() as u32;
    for i in 0..200 {
        let a = Vec3::new((i as f32).sin(), (i as f32).cos(), (i as f32 * 0.7).sin());
        triangles.push(Triangle {
            v: [a, a * 2.0, a * 1.5],
        });
        triangles.push(Triangle { v: [a, a, a] });
        triangles.push(Triangle { v: [a, -a, a] });
    }
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    let scene = scene(triangles);
    let Some(backend) = backend(&scene, 64, Strata::Faces, false) else {
        return;
    };
    for superset in [None, Some(all.as_slice())] {
        let renderer = backend.prepare(superset).unwrap();
        let image = renderer.image(Vec3::new(0.01, 0.02, 0.03)).unwrap();
        assert!(image.ids.iter().all(|id| *id < seen));
    }
    let renderer = backend.prepare(Some(&all[seen as usize..])).unwrap();
    assert_eq!(
        renderer.samples(&[Vec3::ZERO]).unwrap()[0].ids,
        Vec::<u32>::new()
    );
}

/// Checks that the winner of two coincident triangles does not depend on the other triangles drawn.
#[test]
fn ties_do_not_depend_on_superset() {
    let mut random = Hashed::new(&[23]);
    let mut triangles = triangles(&mut random, 1500, 0.1);
    let twins = triangles.clone();
    triangles.extend(twins);
    let scene = scene(triangles);
    let Some(backend) = backend(&scene, 64, Strata::One, false) else {
        return;
    };
    let whole = backend.prepare(None).unwrap();
    let eye = Vec3::splat(0.5);
    let image = whole.image(eye).unwrap();
    let mut seen: Vec<u32> = image
        .ids
        .iter()
        .filter(|id| **id != SKY)
        .map(|id| id % 1500)
        .collect();
    seen.sort_unstable();
    seen.dedup();
    let both: Vec<u32> = seen
        .iter()
        .copied()
        .chain(seen.iter().map(|id| id + 1500))
        .collect();
    assert_eq!(
        backend.prepare(Some(&both)).unwrap().image(eye).unwrap(),
        image
    );
}

#[test]
fn adapters_are_listed_best_first() {
    let all = sightline_trace::gpu::adapters();
    for adapter in &all {
        println!("{adapter:?}");
        assert!(adapter.profile.starts_with("gpu/wgpu-30/"));
        assert!(adapter.profile.bytes().all(|b| (b' '..=b'~').contains(&b)));
        assert_eq!(adapter.profile.split('/').count(), 5);
    }
    assert!(all.is_sorted_by_key(|a| a.software));
    let scene = scene(room(Vec3::ZERO, 1.0));
    let spec = CubeSpec {
        resolution: 8,
        strata: Strata::One,
        keep_pixels: false,
    };
    let hardware = GpuBackend::new(scene.clone(), spec, AdapterChoice::Hardware);
    assert_eq!(hardware.is_ok(), all.iter().any(|a| !a.software));
    if let Some(first) = all.first() {
        let named =
            GpuBackend::new(scene, spec, AdapterChoice::Named(first.name.to_uppercase())).unwrap();
        assert_eq!(named.profile(), first.profile);
    }
}
