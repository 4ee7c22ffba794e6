//! Tests of the method portals: its sets contain the exact sets, and its bytes depend only on the scene.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

mod common;
#[path = "common/cpu.rs"]
mod cpu;

use std::sync::Arc;
use std::time::{Duration, Instant};

use common::Quiet;
use cpu::cpu;
use glam::Vec3;
use sightline_bake::{BakeScene, Control, Inputs, SoleMember, run};
use sightline_exact::{Cell, CellTask, ExactScene, ExactViewRegion, decide};
use sightline_model::{
    CellSet, DecisionStats, Effort, GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler,
    Sampling, TileOutput, codec,
};
use sightline_numbers::Aabb;
use sightline_portals::{
    Enclosure, EnclosureLimits, Partition, RegionPlanes, Tree, enclose, reached, region_of, sights,
};
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_scene::{Object, Scene, Triangle};
use sightline_viewcells::TileIndex;

fn rooms() -> Arc<Scene> {
    Arc::new(
        generate(
            SceneKind::Rooms,
            &SceneParams {
                triangles: Some(700),
                ..SceneParams::default()
            },
        )
        .unwrap(),
    )
}

fn grid(scene: &Scene) -> KnownCells {
    KnownCells::Grid(GridCells::new(scene.bounds(), [3, 2, 2]).unwrap())
}

fn job(scene: &Scene, method: Method) -> PlannedJob {
    PlannedJob::new(JobSpec::new(scene.digest().0, method)).unwrap()
}

fn cells(bytes: &[u8], scene: &Scene) -> Vec<CellSet> {
    match codec::decode(bytes, scene.len()).unwrap() {
        TileOutput::Cells(sets) => sets.cells,
        TileOutput::Pack(_) => panic!("a leaf tile has cells"),
    }
}

fn by_portals(scene: &Arc<Scene>, deadline: Option<Instant>) -> Vec<u8> {
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let control = Control {
        watcher: &Quiet,
        deadline,
        crew: &SoleMember,
    };
    let job = job(scene, Method::portals(grid(scene)));
    run(&job, TileIndex(0), Inputs::new(&prepared), control)
        .unwrap()
        .bytes
}

#[test]
fn sets_contain_exact_sets_and_list_triangles_without_witness() {
    let scene = rooms();
    let found = by_portals(&scene, None);
    assert_eq!(found, by_portals(&scene, None));
    let sampling = Sampling::new(Sampler::lines(grid(&scene)));
    let exact = job(&scene, Method::exact(sampling, Effort::Full));
    let backend = cpu(&scene, exact.spec());
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &SoleMember,
    };
    let prepared = BakeScene::new(Arc::clone(&scene)).unwrap();
    let inputs = Inputs::new(&prepared).with_tracer(&backend);
    let exact = run(&exact, TileIndex(0), inputs, control).unwrap();
    let exact = cells(&exact.bytes, &scene);
    let is_part = |a: &[u32], b: &[u32]| a.iter().all(|t| b.binary_search(t).is_ok());
    let mut sums = [0; 3];
    for (found, exact) in cells(&found, &scene).iter().zip(&exact) {
        assert!(is_part(&exact.visible, &found.visible));
        let undecided = &found.undecided;
        assert!(is_part(undecided, &found.visible));
        let witnessed: Vec<u32> = found
            .visible
            .iter()
            .copied()
            .filter(|t| undecided.binary_search(t).is_err())
            .collect();
        assert!(is_part(&witnessed, &exact.visible));
        for (sum, n) in
            sums.iter_mut()
                .zip([witnessed.len(), exact.visible.len(), found.visible.len()])
        {
            *sum += n;
        }
    }
    let [witnessed, seen, drawn] = sums;
    assert!(
        2 * witnessed > seen && drawn < 2 * seen,
        "{witnessed} witnessed, {seen} seen, {drawn} drawn"
    );
    assert!(drawn < 12 * scene.len() as usize, "portals hide something");
}

#[test]
fn all_triangles_may_be_visible_if_time_is_over() {
    let scene = rooms();
    let past = Instant::now().checked_sub(Duration::from_secs(1)).unwrap();
    for cell in cells(&by_portals(&scene, Some(past)), &scene) {
        let decision = cell.decision.unwrap();
        let counts = DecisionStats::NAMES.iter().zip(&decision.counts);
        let count_of = |wanted: &str| {
            counts
                .clone()
                .find(|(name, _)| **name == wanted)
                .map_or(0, |(_, n)| *n)
        };
        // Closed surfaces hide triangles without portals.
        assert_eq!(count_of("exact_hidden"), count_of("exact_enclosed"));
        assert_eq!(
            cell.visible.len() as u64 + count_of("exact_hidden"),
            u64::from(scene.len())
        );
        assert!(!cell.undecided.is_empty() && count_of("undecided_stopped") > 0);
    }
}

/// Rooms in a row whose walls lie in the faces of cells. Segments that begin on these walls count.
#[test]
fn walls_in_cell_faces_hide_same_triangles_with_and_without_portals() {
    let rectangle = |axis: usize, at: f32, [u, v]: [[f32; 2]; 2]| {
        let corner = |s: usize, t: usize| {
            let mut p = Vec3::splat(at);
            (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (u[s], v[t]);
            p
        };
        [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]].map(|t| Triangle {
            v: t.map(|(s, t)| corner(s, t)),
        })
    };
    let mut walls = Vec::new();
    for k in 0..12 {
        let z = k as f32 / 4.0;
        (0..12).for_each(|x| {
            walls.extend(rectangle(
                1,
                0.0,
                [[z, z + 0.25], [x as f32 / 4.0, x as f32 / 4.0 + 0.25]],
            ))
        });
    }
    walls.extend(rectangle(1, 1.0, [[0.0, 3.0], [0.0, 3.0]]));
    for end in [0.0, 3.0] {
        walls.extend(rectangle(0, end, [[0.0, 1.0], [0.0, 3.0]]));
        walls.extend(rectangle(2, end, [[0.0, 3.0], [0.0, 1.0]]));
    }
    for (x, door) in [(1.0, 0.0), (2.0, 2.0)] {
        for z in [0.0, 1.0, 2.0f32].into_iter().filter(|z| *z != door) {
            walls.extend(rectangle(0, x, [[0.0, 1.0], [z, z + 1.0]]));
        }
    }
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: walls.len() as u32,
    }];
    let scene = Scene::new("test", walls, objects).unwrap();
    let seed = [[0.5, 0.5, 0.5]];
    let mut tree = Tree::new(&scene, &seed);
    assert_eq!(
        enclose(&mut tree, &seed, EnclosureLimits::default(), &mut |_| true),
        Enclosure::Closed
    );
    let region = region_of(&tree, &reached(&tree, &seed)).unwrap();
    let planes = RegionPlanes::new(&region, &scene).unwrap();
    let prepared = ExactScene::prepare(&scene).unwrap();
    for within in [None, Some(&region)] {
        let partition = Partition::new(
            &scene,
            within,
            scene.bounds(),
            EnclosureLimits::default(),
            &|| false,
        )
        .unwrap();
        for x in 0..3 {
            let (min, max) = (
                Vec3::new(x as f32, 0.0, 0.0),
                Vec3::new(x as f32 + 1.0, 1.0, 3.0),
            );
            let listed = sights(&partition, Aabb::new(min, max), false, &|| false).unwrap();
            let decided = |listed: Option<&[u32]>| {
                decide(&CellTask {
                    scene: &prepared,
                    cell: Cell::new(min, max).unwrap(),
                    region: within.map(|_| &planes as &dyn ExactViewRegion),
                    seen: &[],
                    above: &[],
                    listed,
                    limits: sightline_exact::QueryLimits::default(),
                    seed: 3,
                    keep: false,
                    stop: &|| false,
                    asked: &|| {},
                })
                .visible
            };
            let alone = decided(None);
            assert!(
                alone.iter().all(|t| listed.binary_search(t).is_ok()),
                "cell {x} sees what is hidden"
            );
            assert_eq!(alone, decided(Some(&listed)));
            // The middle room sees all triangles.
            assert!(
                x == 1 || listed.len() < scene.len() as usize,
                "walls hide something from cell {x}"
            );
        }
    }
}
