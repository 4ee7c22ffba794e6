//! Tests of determinism. The order of the hierarchy decides between hits at equal distance, so the hierarchy
//! must not depend on the number of threads that build it. Embree promises this since version 2.5 for all
//! builders except the builder of high quality (Embree issue 20).

use std::sync::Arc;

use glam::Vec3;

use super::library::{Device, Layer, RayHit1, TriangleScene};
use super::{EmbreeBackend, EmbreeTracer, Hierarchy};
use crate::cube::SKY;
use crate::error::TracerError;
use crate::packet::{Halves, LANES, LineTracer, Packet};
use crate::sequence::Hashed;

/// Returns triangles on a coarse lattice. Many of them overlap, are coplanar or are equal.
fn soup(count: usize) -> Vec<[f32; 9]> {
    let mut state = 7u64;
    let mut random = move |below: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    (0..count)
        .map(|_| {
            let at = [random(64), random(64), random(8)];
            let mut corner = || [0, 1, 2].map(|a| (at[a] + random(4)) as f32);
            let [a, b, c] = [corner(), corner(), corner()];
            [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
        })
        .collect()
}

/// Returns a layer of triangles that end rays and have two sides.
fn layer(triangles: &[[f32; 9]]) -> Layer<impl Iterator<Item = [f32; 9]> + '_> {
    Layer {
        count: triangles.len(),
        triangles: triangles.iter().copied(),
        fronts: None,
        is_passed: false,
    }
}

/// Opens a device, or returns `None` without Embree. Under `CI`, a missing Embree is a failure.
fn device(threads: usize) -> Option<Arc<Device>> {
    match EmbreeBackend::open(threads) {
        Ok(device) => Some(Arc::new(device)),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run: {why}");
            None
        }
        Err(e) => panic!("{e}"),
    }
}

#[test]
fn single_rays_meet_same_triangles_as_packets() {
    let triangles = soup(20_000);
    let Some(device) = device(1) else { return };
    let scene = TriangleScene::new(&device, [layer(&triangles)]).unwrap();
    let hierarchy = Arc::new(Hierarchy {
        scene,
        ids: (0..triangles.len() as u32).collect(),
        passed: Vec::new(),
    });
    let tracer = EmbreeTracer {
        hierarchy,
        near: 0.0,
    };
    let mut random = Hashed::new(&[3]);
    let mut packets: Vec<Packet> = (0..1000)
        .map(|_| {
            let mut packet = Packet::default();
            for _ in 0..LANES {
                let [from, to] = [0; 2].map(|_| random.point() * Vec3::new(64.0, 64.0, 8.0));
                packet.push(from.to_array(), (to - from).to_array());
            }
            packet
        })
        .collect();
    let mut singly = packets.clone();
    tracer.trace(&mut packets, Halves::Rays, true).unwrap();
    tracer.trace(&mut singly, Halves::Rays, false).unwrap();
    let (mut met, mut other) = (0, 0);
    for (a, b) in packets.iter().zip(&singly) {
        for lane in 0..LANES {
            met += u32::from(a.triangle[lane] != SKY);
            // If triangles overlap, either may be hit, but at the same distance.
            other += u32::from(a.triangle[lane] != b.triangle[lane]);
            let (far, near) = (a.distance[lane], b.distance[lane]);
            assert!(
                far == near || (far - near).abs() <= 1e-4 * far.max(1e-2),
                "{far} {near}"
            );
        }
    }
    assert!(met > 10_000 && other < met / 100, "{met} {other}");
}

#[test]
fn hierarchy_does_not_depend_on_build_threads() {
    let triangles = soup(150_000);
    let mut met: Vec<Vec<(u32, u32)>> = Vec::new();
    for threads in [1, 2, 3, 8] {
        let Some(device) = device(threads) else {
            return;
        };
        let scene = TriangleScene::new(&device, [layer(&triangles)]).unwrap();
        let ray = |i: u32| {
            let (x, y) = (i % 256, i / 256);
            // Vertical rays through lattice points and edges, where many triangles are hit at equal distance,
            // and oblique rays.
            let direction = if i.is_multiple_of(2) {
                [0.0, 0.0, -1.0]
            } else {
                [0.25, 0.5, -1.0]
            };
            let mut ray = RayHit1::new([x as f32 * 0.25, y as f32 * 0.25, 20.0], direction, 0.0);
            scene.intersect_one(&mut ray, None);
            (ray.prim, ray.tfar.to_bits())
        };
        met.push((0..256 * 256).map(ray).collect());
    }
    assert!(met[0].iter().filter(|hit| hit.0 != u32::MAX).count() > 60_000);
    for other in &met[1..] {
        assert_eq!(met[0], *other);
    }
}
