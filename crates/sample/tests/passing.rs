//! See-through triangles that are found together with the ends of lines are those that a second search
//! finds, whatever else the scene has: random triangles, of which none share a plane.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::sync::Arc;

use glam::Vec3;
use sightline_scene::{Kind, Kinds, Object, Scene, Side, Sides, Triangle};
use sightline_trace::embree::CpuBackend;
use sightline_trace::packet::{LANES, LineTracer, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::{
    Backend, BackendError, CubeRenderer, CubeSpec, LineSet, PreparedScene, SKY, Strata,
};

/// A backend that traces among one set of triangles at a time.
struct OneByOne<'a>(&'a CpuBackend);

impl Backend for OneByOne<'_> {
    fn profile(&self) -> &str {
        self.0.profile()
    }

    fn prepare(
        &self,
        superset: Option<&[u32]>,
    ) -> Result<Box<dyn CubeRenderer + '_>, BackendError> {
        self.0.prepare(superset)
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, BackendError> {
        self.0.lines(set, ids)
    }
}

/// Triangles in the unit cube: 600 see-through ones between 200 opaque ones.
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
        (100, Kind::Opaque, "wall"),
        (600, Kind::SeeThrough, "glass"),
        (100, Kind::Opaque, "wall"),
    ];
    let scene = Scene::new("soup", triangles, objects).unwrap();
    scene
        .with_kinds("soup", Kinds::from_runs(kinds, Vec::new()))
        .unwrap()
        .with_sides("soup", sides)
        .unwrap()
}

/// The triangle at the end of a line, and those that it passes.
type Shown = (u32, Vec<u32>);

/// What each line shows.
fn traced(sight: &SightLineTracer<'_>, coherent: bool) -> Vec<Shown> {
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
    // Twice: what the memory holds from the last time must not matter.
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
            // A second search begins close behind a triangle, and can meet it again where a line grazes it.
            on.dedup();
            (p.triangle[lane], on)
        })
        .collect()
}

#[test]
fn one_traversal_finds_what_two_searches_find() {
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
        let backend = match CpuBackend::new(Arc::clone(&scene), spec) {
            Ok(backend) => backend,
            Err(BackendError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
                eprintln!("not run: {why}");
                return;
            }
            Err(e) => panic!("{e}"),
        };
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
