//! Tests of the largest and smallest scenes that every stage accepts, and of scenes beyond these limits.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;
#[path = "common/cpu.rs"]
mod cpu;

use std::sync::Arc;

use common::Quiet;
use cpu::cpu;
use glam::Vec3;
use sightline_bake::{BakeScene, Control, Inputs, PackBytes, SoleMember, run};
use sightline_model::numbers::Resolution;
use sightline_model::{
    CellToCell, Completion, CubeCells, CubeGrid, CubeParams, Effort, Granularity, GridCells,
    JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling, Task, TileOutput, TracerChoice,
    Visibility, codec,
};
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_scene::{MAX_COORDINATE, Object, Scene, Triangle};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::embree::EmbreeBackend;
use sightline_trace::packet::{Halves, LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeSpec, LineSet, SKY, Tracer as _, TracerError};
use sightline_viewcells::TileIndex;

/// Returns rooms whose coordinates are below 1, multiplied by a power of two.
fn scaled(power: i32) -> Arc<Scene> {
    let params = SceneParams {
        triangles: Some(300),
        ..SceneParams::default()
    };
    let rooms = generate(SceneKind::Rooms, &params).unwrap();
    let bounds = rooms.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let scale = 2f32.powi(power - largest.log2().ceil() as i32);
    let triangles = rooms
        .triangles()
        .iter()
        .map(|t| Triangle {
            v: t.v.map(|v| v * scale),
        })
        .collect();
    Arc::new(Scene::new("rooms", triangles, rooms.objects().to_vec()).unwrap())
}

fn grid(scene: &Scene) -> KnownCells {
    KnownCells::Grid(GridCells::new(scene.bounds(), [2, 2, 1]).unwrap())
}

fn sampling(sampler: Sampler) -> Sampling {
    Sampling {
        tracer: TracerChoice::Cpu,
        ..Sampling::new(sampler)
    }
}

fn aggressive(scene: &Scene) -> Method {
    // Likely triangles can be hidden.
    Method::Aggressive {
        sampling: sampling(Sampler::lines(grid(scene))),
        items: Granularity::Triangles,
        completion: Completion::Off,
    }
}

fn exact(scene: &Scene) -> Method {
    Method::exact(sampling(Sampler::lines(grid(scene))), Effort::Full)
}

fn portals(scene: &Scene) -> Method {
    Method::portals(grid(scene))
}

fn cubes(scene: &Scene) -> Method {
    let cells = CubeCells::Grid(CubeGrid::new(scene.bounds(), [2, 2, 1]).unwrap());
    let params = CubeParams {
        resolution: Resolution::new(64).unwrap(),
        ..CubeParams::default()
    };
    Method::aggressive(sampling(Sampler::Cubes { cells, params }))
}

/// Returns the sets of all cells.
fn sets(scene: &Arc<Scene>, method: Method) -> Vec<Vec<u32>> {
    let task = Visibility {
        pairs: CellToCell::Off,
        ..method.into()
    };
    let job = PlannedJob::new(JobSpec {
        scene: scene.digest().0,
        task: Task::Visibility(task),
    });
    let job = job.unwrap();
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &SoleMember,
    };
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let mut outputs: Vec<Vec<u8>> = Vec::new();
    for (number, tile) in (0u32..).zip(&job.plan().tiles) {
        let needed = tile.needs.iter();
        let packs: Vec<PackBytes<'_>> = needed
            .map(|n| PackBytes::Present(&outputs[*n as usize]))
            .collect();
        let backend = job.spec().tracer().map(|_| cpu(scene, job.spec()));
        let inputs = Inputs {
            tracer: backend.as_ref().map(|backend| backend as _),
            ..Inputs::new(&prepared).with_packs(&packs)
        };
        let done = run(&job, TileIndex(number), inputs, control);
        outputs.push(done.unwrap().bytes);
    }
    let mut all = Vec::new();
    for bytes in outputs {
        if let TileOutput::Cells(sets) = codec::decode(&bytes, scene.len()).unwrap() {
            all.extend(sets.cells.into_iter().map(|cell| cell.visible));
        }
    }
    all
}

#[test]
fn scenes_of_all_sizes_have_correct_sets() {
    // Coordinates up to 5.4e8, and a width of 1.9e-9.
    let sets_at = |power, method: fn(&Scene) -> Method| {
        let scene = scaled(power);
        sets(&scene, method(&scene))
    };
    let (decided, by_portals) = (sets_at(0, exact), sets_at(0, portals));
    for power in [0, 29, -28] {
        assert_eq!(sets_at(power, exact), decided, "2^{power}");
        assert_eq!(sets_at(power, portals), by_portals, "2^{power}");
        // The digest of the scene selects the samples, so each size has other samples.
        for (sampled, exact) in sets_at(power, aggressive).iter().zip(&decided) {
            let strange: Vec<_> = sampled
                .iter()
                .filter(|id| exact.binary_search(id).is_err())
                .collect();
            assert!(strange.is_empty(), "2^{power}: {strange:?}");
            assert!(
                sampled.len() * 10 > exact.len() * 9,
                "2^{power}: {} of {}",
                sampled.len(),
                exact.len()
            );
        }
    }
}

#[test]
fn cubes_see_scenes_of_all_sizes() {
    for power in [29, 0, -28] {
        let scene = scaled(power);
        let sets = sets(&scene, cubes(&scene));
        assert!(sets.iter().all(|set| set.len() > 10), "2^{power}: {sets:?}");
    }
}

#[test]
fn error_names_triangle_with_vertex_beyond_largest_coordinate() {
    let objects = || {
        vec![Object {
            name: "all".to_owned(),
            first: 0,
            count: 2,
        }]
    };
    let with = |far: f32| {
        let near = Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::Y],
        };
        let stray = Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::new(0.0, -far, 0.0)],
        };
        let scene = Scene::new("stray.obj", vec![near, stray], objects()).unwrap();
        scene.check_reach("stray.obj").map(|()| scene)
    };
    for far in [1.000_001e9, 1e19, f32::MAX] {
        let text = with(far).unwrap_err().to_string();
        assert!(
            text.starts_with("stray.obj: triangle 1, vertex 2: the position"),
            "{text}"
        );
    }
    assert_eq!(with(MAX_COORDINATE).unwrap().len(), 2);
}

#[test]
fn rejects_scene_too_small_for_embree() {
    for power in [-31, -60, -100] {
        let scene = scaled(power);
        match EmbreeBackend::new(scene, CubeSpec::new(&CubeParams::default())) {
            Err(TracerError::Unavailable(why)) if why.contains("Embree") => {
                assert!(std::env::var_os("CI").is_none(), "{why}");
                return;
            }
            Err(e) => assert!(e.to_string().contains("wide"), "{e}"),
            Ok(_) => panic!("2^{power} is accepted"),
        }
    }
}

/// Returns the triangle that each of 512 rays meets in the rooms [`scaled`], and its distance in lengths of
/// the ray. The rays are multiplied by the same power of two as the rooms.
fn hits(power: i32) -> Vec<(u32, f32)> {
    let scene = scaled(power);
    let bounds = scene.bounds();
    let (min, size) = (bounds.min, bounds.max - bounds.min);
    let mut random = Hashed::new(&[8]);
    let mut packets = vec![Packet::default(); 32];
    for packet in &mut packets {
        for _ in 0..LANES {
            let [from, to] = [0; 2].map(|_| min + size * random.point());
            packet.push(from.to_array(), (to - from).to_array());
        }
    }
    let ids: Vec<u32> = (0..scene.len()).collect();
    let backend = CpuBackend::new(scene, CubeSpec::new(&CubeParams::default())).unwrap();
    let tracer = backend.lines(LineSet::Blocking, &ids).unwrap();
    tracer.trace(&mut packets, Halves::Rays, false).unwrap();
    packets
        .iter()
        .flat_map(|p| p.triangle.into_iter().zip(p.distance))
        .collect()
}

#[test]
fn cpu_backend_has_same_hits_in_scenes_too_small_for_embree() {
    let expected = hits(0);
    let met = expected.iter().filter(|(id, _)| *id != SKY).count();
    assert!(met * 2 > expected.len(), "{met} of {}", expected.len());
    for power in [-31, -50] {
        assert_eq!(hits(power), expected, "2^{power}");
    }
    let tiny = CpuBackend::new(scaled(-70), CubeSpec::new(&CubeParams::default()));
    let reason = tiny.map(|_| ()).unwrap_err().to_string();
    assert!(reason.contains("wide"), "{reason}");
}

#[test]
fn scenes_without_extent_are_baked() {
    // A point, a line and a plane. View boxes enclose them.
    let point = Triangle { v: [Vec3::ONE; 3] };
    let line = Triangle {
        v: [Vec3::ONE, Vec3::ONE * 2.0, Vec3::ONE * 3.0],
    };
    let plane = Triangle {
        v: [Vec3::X, Vec3::Y, Vec3::ZERO],
    };
    for triangles in [vec![point], vec![line], vec![plane, point, line]] {
        let count = triangles.len() as u32;
        let objects = vec![Object {
            name: "all".to_owned(),
            first: 0,
            count,
        }];
        let scene = Arc::new(Scene::new("flat", triangles, objects).unwrap());
        let view_box = sightline_scene::Aabb::new(Vec3::splat(-1.0), Vec3::splat(4.0));
        let cells = GridCells::new(view_box, [2, 2, 1]).unwrap();
        let sampling = sampling(Sampler::lines(KnownCells::Grid(cells)));
        for method in [
            Method::aggressive(sampling.clone()),
            Method::exact(sampling.clone(), Effort::Full),
        ] {
            let name = method.name();
            let sets = sets(&scene, method);
            assert_eq!(sets.len(), 4, "{name}");
        }
    }
}
