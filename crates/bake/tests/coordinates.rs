//! The largest and smallest scenes that every stage accepts, and those beyond them.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

mod common;
#[path = "common/cpu.rs"]
mod cpu;

use std::sync::Arc;

use common::Quiet;
use cpu::cpu;
use glam::Vec3;
use sightline_bake::{Alone, BakeScene, Control, Inputs, PackBytes, run};
use sightline_model::numbers::Resolution;
use sightline_model::{
    CellToCell, CubeCells, CubeGrid, CubeParams, Effort, GridCells, JobSpec, KnownCells, Method,
    PlannedJob, Sampler, Sampling, Task, TileOutput, TracerChoice, Visibility, codec,
};
use sightline_scene::generate::{Kind, Params, generate};
use sightline_scene::{MAX_COORDINATE, Object, Scene, Triangle};
use sightline_trace::{BackendError, CubeSpec, embree::CpuBackend};

/// Returns rooms whose largest coordinate is below 1, times a power of two.
fn scaled(power: i32) -> Arc<Scene> {
    let params = Params {
        triangles: Some(300),
        ..Params::default()
    };
    let rooms = generate(Kind::Rooms, &params).unwrap();
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
    Method::aggressive(sampling(Sampler::lines(grid(scene))))
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
fn sets(scene: &Arc<Scene>, method: Method) -> Option<Vec<Vec<u32>>> {
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
        crew: &Alone,
    };
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let mut outputs: Vec<Vec<u8>> = Vec::new();
    for (number, tile) in (0u32..).zip(&job.plan().tiles) {
        let needed = tile.needs.iter();
        let packs: Vec<PackBytes<'_>> = needed
            .map(|n| PackBytes::Present(&outputs[*n as usize]))
            .collect();
        let backend = match job.spec().tracer() {
            Some(_) => Some(cpu(scene, job.spec())?),
            None => None,
        };
        let inputs = Inputs {
            tracer: backend.as_ref().map(|backend| backend as _),
            ..Inputs::new(&prepared).with_packs(&packs)
        };
        let done = run(&job, number, inputs, control);
        outputs.push(done.unwrap().bytes);
    }
    let mut all = Vec::new();
    for bytes in outputs {
        if let TileOutput::Cells(sets) = codec::decode(&bytes, scene.len()).unwrap() {
            all.extend(sets.cells.into_iter().map(|cell| cell.visible));
        }
    }
    Some(all)
}

#[test]
fn scenes_of_all_sizes_have_their_sets() {
    // Coordinates up to 5.4e8, and a width of 1.9e-9.
    let sets_at = |power, method: fn(&Scene) -> Method| {
        let scene = scaled(power);
        sets(&scene, method(&scene))
    };
    let Some(decided) = sets_at(0, exact) else {
        return;
    };
    let by_portals = sets_at(0, portals).unwrap();
    for power in [0, 29, -28] {
        assert_eq!(sets_at(power, exact).unwrap(), decided, "2^{power}");
        assert_eq!(sets_at(power, portals).unwrap(), by_portals, "2^{power}");
        // Samples are drawn by the digest of the scene, so that each size has others.
        for (sampled, exact) in sets_at(power, aggressive).unwrap().iter().zip(&decided) {
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
        let Some(sets) = sets(&scene, cubes(&scene)) else {
            return;
        };
        assert!(sets.iter().all(|set| set.len() > 10), "2^{power}: {sets:?}");
    }
}

#[test]
fn vertex_beyond_largest_coordinate_is_refused_by_its_triangle() {
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
            text.starts_with("stray.obj: triangle 1, vertex 2: its position"),
            "{text}"
        );
    }
    assert_eq!(with(MAX_COORDINATE).unwrap().len(), 2);
}

#[test]
fn scene_too_small_for_embree_is_refused_without_crash() {
    for power in [-31, -60, -100] {
        let scene = scaled(power);
        match CpuBackend::new(Arc::clone(&scene), CubeSpec::new(&CubeParams::default())) {
            Err(BackendError::Unavailable(why)) if why.contains("Embree") => {
                assert!(std::env::var_os("CI").is_none(), "{why}");
                return;
            }
            Err(e) => assert!(e.to_string().contains("wide"), "{e}"),
            Ok(_) => panic!("2^{power} is accepted"),
        }
    }
}

#[test]
fn scenes_without_extent_are_baked() {
    // A point, a line and a plane: view boxes lie around them.
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
            let Some(sets) = sets(&scene, method) else {
                return;
            };
            assert_eq!(sets.len(), 4, "{name}");
        }
    }
}
