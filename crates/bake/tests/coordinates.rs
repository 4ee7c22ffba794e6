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
use sightline_bake::{Alone, BakeScene, Control, PackBytes, run_portal_tile, run_tile};
use sightline_model::{BackendChoice, CellToCell, JobSpec, Method, Sampler, TileOutput, codec};
use sightline_sampling::{BackendError, CubeSpec, embree::CpuBackend};
use sightline_scene::generate::{Kind, Params, generate};
use sightline_scene::{MAX_COORDINATE, Object, Scene, Triangle};
use sightline_viewcells::Division;

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

fn spec(scene: &Scene, method: Method, sampler: Sampler) -> JobSpec {
    let mut spec = JobSpec::new(scene.digest().0, Division::Grid([2, 2, 1]), scene.bounds());
    spec.backend = if method == Method::Portals {
        BackendChoice::None
    } else {
        BackendChoice::Cpu
    };
    spec.method = method;
    spec.sampling.sampler = sampler;
    spec.sampling.cell_to_cell = CellToCell::Off;
    spec.sampling.resolution = 64;
    spec
}

/// Returns the sets of all cells.
fn sets(scene: &Arc<Scene>, spec: &JobSpec) -> Option<Vec<Vec<u32>>> {
    spec.check().unwrap();
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &Alone,
    };
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let (_, plan) = spec.plan().unwrap();
    let mut outputs: Vec<Vec<u8>> = Vec::new();
    for (number, tile) in (0u32..).zip(&plan.tiles) {
        let done = if spec.method == Method::Portals {
            run_portal_tile(spec, number, &prepared, control)
        } else {
            let needed = tile
                .needs
                .iter()
                .map(|n| PackBytes::Present(&outputs[*n as usize]));
            run_tile(
                spec,
                number,
                &prepared,
                &cpu(scene, spec)?,
                &needed.collect::<Vec<_>>(),
                control,
            )
        };
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
    let of = |power, method| {
        let scene = scaled(power);
        sets(&scene, &spec(&scene, method, Sampler::Lines))
    };
    let Some(exact) = of(0, Method::Exact) else {
        return;
    };
    let portals = of(0, Method::Portals).unwrap();
    for power in [0, 29, -28] {
        assert_eq!(of(power, Method::Exact).unwrap(), exact, "2^{power}");
        assert_eq!(of(power, Method::Portals).unwrap(), portals, "2^{power}");
        // Samples are drawn by the digest of the scene, so that each size has others.
        for (sampled, exact) in of(power, Method::Aggressive).unwrap().iter().zip(&exact) {
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
        let Some(sets) = sets(&scene, &spec(&scene, Method::Aggressive, Sampler::Cubes)) else {
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
        match CpuBackend::new(
            Arc::clone(&scene),
            CubeSpec::of(&JobSpec::new([0; 32], Division::Grid([1; 3]), scene.bounds()).sampling),
        ) {
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
        for method in [Method::Exact, Method::Aggressive] {
            let mut spec = spec(&scene, method, Sampler::Lines);
            spec.view_box = sightline_scene::Aabb::new(Vec3::splat(-1.0), Vec3::splat(4.0));
            let Some(sets) = sets(&scene, &spec) else {
                return;
            };
            assert_eq!(sets.len(), 4, "{method:?}");
        }
    }
}
