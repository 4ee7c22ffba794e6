//! Tests that see-through triangles found together with the ends of lines equal the triangles that a second
//! search finds. The scenes are random triangles, of which none share a plane.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::Arc;

use glam::Vec3;
use sightline_scene::{Kinds, Object, Scene, Side, Sides, SurfaceKind, Triangle};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::packet::{LANES, LineTracer, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::{
    CubeRenderer, CubeSpec, LineSet, PreparedScene, SKY, Strata, Tracer, TracerError,
};

/// A backend that traces among one set of triangles at a time.
struct OneByOne<'a>(&'a CpuBackend);

impl Tracer for OneByOne<'_> {
    fn profile(&self) -> &str {
        self.0.profile()
    }

    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, TracerError> {
        self.0.prepare(superset)
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, TracerError> {
        self.0.lines(set, ids)
    }
}

/// Returns triangles in the unit cube: 600 see-through triangles between 200 opaque triangles.
fn scene(sides: Sides) -> Scene {
    let mut random = Hashed::new(&[11]);
    let triangles: Vec<Triangle> = (0..800)
        .map(|_| {
            let at = random.point();
            Triangle {
                v: [0; 3].map(|_| at + (random.point() - Vec3::splat(0.5)) * 0.3),
            }
        })
        .collect();
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: 800,
    }];
    let kinds = [
        (100, SurfaceKind::Opaque, "wall"),
        (600, SurfaceKind::SeeThrough, "glass"),
        (100, SurfaceKind::Opaque, "wall"),
    ];
    let scene = Scene::new("soup", triangles, objects).unwrap();
    scene
        .with_kinds("soup", Kinds::from_runs(kinds, Vec::new()))
        .unwrap()
        .with_sides("soup", sides)
        .unwrap()
}

/// The triangle at the end of a line, and the triangles that the line passes.
type LineHit = (u32, Vec<u32>);

/// Returns the triangles that each line shows.
fn traced(sight: &SightLineTracer<'_>, coherent: bool) -> Vec<LineHit> {
    let mut random = Hashed::new(&[5]);
    let mut packets: Vec<Packet> = (0..200)
        .map(|_| {
            let mut packet = Packet::default();
            let origin = random.point();
            // Some packets are not full.
            for _ in 0..LANES - (random.unit() * 3.0) as usize {
                packet.push(
                    origin.to_array(),
                    (random.point() - Vec3::splat(0.5)).to_array(),
                );
            }
            packet
        })
        .collect();
    let mut passed = Passed::default();
    // The lines are traced twice, because old content of the memory must not affect the result.
    for _ in 0..2 {
        match coherent {
            true => sight.trace(&mut packets, &mut passed, 0.0).unwrap(),
            false => sight.trace_each(&mut packets, &mut passed, 0.0).unwrap(),
        }
    }
    let lanes = packets
        .iter()
        .enumerate()
        .flat_map(|(k, p)| (0..p.count).map(move |lane| (k, p, lane)));
    lanes
        .map(|(k, p, lane)| {
            let mut on: Vec<u32> = passed.on(k, lane).collect();
            // A second search begins close behind a triangle, and can meet it again if a line grazes it.
            on.dedup();
            (p.triangle[lane], on)
        })
        .collect()
}

#[test]
fn one_traversal_equals_two_searches() {
    let one_sided = Sides::from_runs([
        (50, Side::Both),
        (700, Side::CounterClockwise),
        (50, Side::Both),
    ]);
    for sides in [Sides::both(), one_sided] {
        let scene = Arc::new(scene(sides));
        let spec = CubeSpec {
            resolution: 16,
            strata: Strata::One,
            keep_pixels: false,
        };
        let backend = CpuBackend::new(Arc::clone(&scene), spec).unwrap();
        let (prepared, apart) = (
            PreparedScene::new(Arc::clone(&scene)).unwrap(),
            OneByOne(&backend),
        );
        for (far, coherent) in [
            (None, false),
            (None, true),
            (Some(0.4), false),
            (Some(0.4), true),
        ] {
            let sight = |backend| {
                SightLineTracer::new(backend, prepared.traced())
                    .unwrap()
                    .up_to(far)
            };
            let together = traced(&sight(&backend), coherent);
            let apart = traced(&sight(&apart), coherent);
            assert_eq!(together.len(), apart.len());
            for (a, b) in together.iter().zip(&apart) {
                assert_eq!(a, b, "far {far:?}, coherent {coherent}");
            }
            let most = together.iter().map(|(_, on)| on.len()).max();
            assert!(most > Some(4), "lines pass several triangles: {most:?}");
            assert!(together.iter().any(|(end, ..)| *end != SKY));
        }
    }
}
