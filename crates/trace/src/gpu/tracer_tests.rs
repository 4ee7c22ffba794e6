//! Tests of the line tracer that need private items: batches and pages. `tests/gpu_lines.rs` tests the hits.

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};

use super::*;
use crate::cube::{CubeSpec, Strata};
use crate::gpu::AdapterChoice;
use crate::gpu::GpuBackend;
use crate::gpu::line_scene::Refusal;
use crate::tracer::Tracer;

/// Returns a pseudo-random number in −1…1.
fn noise(i: u32) -> f32 {
    let x = i.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    let x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((x ^ (x >> 12)) & 0xffff) as f32 / 32768.0 - 1.0
}

fn point(i: u32) -> Vec3 {
    Vec3::new(noise(3 * i), noise(3 * i + 1), noise(3 * i + 2))
}

fn soup(count: u32) -> Arc<Scene> {
    let triangles = (0..count).map(|i| {
        let c = point(4 * i);
        Triangle {
            v: [1, 2, 3].map(|k| c + point(4 * i + k) * 0.2),
        }
    });
    let objects = vec![Object {
        name: "soup".into(),
        first: 0,
        count,
    }];
    Arc::new(Scene::new("soup", triangles.collect(), objects).unwrap())
}

fn backend(scene: &Arc<Scene>) -> Option<GpuBackend> {
    let spec = CubeSpec {
        resolution: 16,
        strata: Strata::One,
        keep_pixels: false,
    };
    match GpuBackend::new(scene.clone(), spec, AdapterChoice::AllowSoftware) {
        Ok(backend) => Some(backend),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            println!("not run: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn packets(count: u32) -> Vec<Packet> {
    (0..count)
        .map(|i| {
            let mut packet = Packet::default();
            for lane in 0..(i % 17) {
                let ray = 1_000_000 + 2 * (16 * i + lane);
                packet.push(point(ray).to_array(), point(ray + 1).to_array());
            }
            packet
        })
        .collect()
}

fn bits(packets: &[Packet]) -> Vec<([u32; LANES], [u32; LANES])> {
    packets
        .iter()
        .map(|p| (p.distance.map(f32::to_bits), p.triangle))
        .collect()
}

#[test]
fn batches_pages_and_threads_do_not_change_bits() {
    let scene = soup(500);
    let Some(backend) = backend(&scene) else {
        return;
    };
    let tracer = |page_bytes| {
        let scene = DeviceLineScene::new(
            &backend.gpu.device,
            &scene,
            &(0..scene.len()).collect::<Vec<_>>(),
            page_bytes,
        )
        .unwrap();
        GpuTracer::new(&backend.gpu, Arc::new(LineKit::new(scene)))
    };
    let one = tracer(u64::MAX);
    let mut expected = packets(700);
    one.trace(&mut expected, Halves::Rays, true).unwrap();
    assert!(
        expected
            .iter()
            .any(|p| p.triangle.iter().any(|t| *t != SKY))
    );
    for p in &expected {
        assert!(p.triangle[p.count..].iter().all(|t| *t == SKY));
        assert!(
            p.triangle
                .iter()
                .zip(p.distance)
                .all(|(t, d)| (*t == SKY) == d.is_infinite())
        );
    }
    // Three pages of 224 triangles each, and of 336 nodes each. A hierarchy has at most twice as many nodes
    // as triangles.
    let many = tracer(336 * 32);
    for (tracer, batch) in [(&one, 1), (&one, 64), (&many, 1024), (&many, 37)] {
        let mut again = packets(700);
        tracer.trace_in(&mut again, batch).unwrap();
        assert_eq!(bits(&expected), bits(&again), "batches of {batch}");
    }
    std::thread::scope(|s| {
        for _ in 0..4 {
            s.spawn(|| {
                for _ in 0..5 {
                    let mut again = packets(700);
                    one.trace_in(&mut again, 100).unwrap();
                    assert_eq!(bits(&expected), bits(&again));
                }
            });
        }
    });
}

#[test]
fn rejects_scene_that_exceeds_limit_and_names_limit() {
    let scene = soup(500);
    let Some(backend) = backend(&scene) else {
        return;
    };
    let refused = DeviceLineScene::new(
        &backend.gpu.device,
        &scene,
        &(0..scene.len()).collect::<Vec<_>>(),
        100 * 48,
    );
    assert!(matches!(refused, Err(Refusal::Unavailable(why)) if why.contains("4800 bytes")));
}

#[test]
fn lost_device_is_error() {
    let Some(backend) = backend(&soup(50)) else {
        return;
    };
    let tracer = backend
        .lines(
            crate::LineSet::Blocking,
            &(0..backend.scene.len()).collect::<Vec<_>>(),
        )
        .unwrap();
    tracer.trace(&mut packets(20), Halves::Rays, true).unwrap();
    backend.gpu.device.destroy();
    for _ in 0..2 {
        let error = tracer
            .trace(&mut packets(20), Halves::Rays, true)
            .unwrap_err();
        assert!(matches!(error, TracerError::Failed { .. }), "{error}");
    }
}
