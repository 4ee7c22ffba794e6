//! Boxes along walls: open boxes, of which walls in a face block.

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
use sightline_bake::{Alone, BakeScene, Control, run_portal_tile, run_tile};
use sightline_exact::{Cell, ExactScene, Task, decide};
use sightline_model::{BackendChoice, JobSpec, Method, TileOutput, codec};
use sightline_portals::along_walls;
use sightline_scene::Scene;
use sightline_scene::generate::{Kind, Params, generate};
use sightline_viewcells::Division;

/// The set of a tile of one cell.
fn set(bytes: &[u8], scene: &Scene) -> Vec<u32> {
    match codec::decode(bytes, scene.len()).unwrap() {
        TileOutput::Cells(sets) if sets.cells.len() == 1 => sets.cells[0].visible.clone(),
        _ => panic!("a box is a tile of one cell"),
    }
}

/// What exact queries say of a closed box.
fn of_closed(prepared: &ExactScene, min: Vec3, max: Vec3) -> Vec<u32> {
    decide(&Task {
        scene: prepared,
        cell: Cell::new(min, max).unwrap(),
        places: None,
        seen: &[],
        above: &[],
        listed: None,
        limits: sightline_exact::Limits::default(),
        seed: 3,
        keep: false,
        stop: &|| false,
        asked: &|| {},
    })
    .visible
}

#[test]
fn a_wall_in_a_face_blocks() {
    let params = Params {
        triangles: Some(500),
        ..Params::default()
    };
    let scene = Arc::new(generate(Kind::Rooms, &params).unwrap());
    let tree = along_walls(&scene, scene.bounds(), 14, &|_| true);
    let division = Division::Tree(Arc::new(tree));
    let mut sampled = JobSpec::new(scene.digest().0, division, scene.bounds());
    sampled.backend = BackendChoice::Cpu;
    sampled.sampling.cell_to_cell = sightline_model::CellToCell::Off;
    let exact = JobSpec {
        method: Method::Exact,
        ..sampled.clone()
    };
    let portals = JobSpec {
        method: Method::Portals,
        backend: BackendChoice::None,
        ..sampled.clone()
    };
    [&sampled, &exact, &portals].into_iter().for_each(|spec| {
        spec.check().unwrap();
        assert_eq!(&JobSpec::from_proto(&spec.to_proto(), None).unwrap(), spec);
    });
    let Some(backend) = cpu(&scene, &exact) else {
        return;
    };
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &Alone,
    };
    let prepared = BakeScene::new(Arc::clone(&scene)).unwrap();
    let queries = ExactScene::prepare(&scene).unwrap();
    let (lattice, plan) = exact.plan().unwrap();
    assert_eq!(plan.tiles.len(), 14);
    let is_part = |a: &[u32], b: &[u32]| a.iter().all(|t| b.binary_search(t).is_ok());
    let [mut open_sum, mut closed_sum, mut inner_sum] = [0; 3];
    for (number, tile) in plan.tiles.iter().enumerate() {
        let run = |spec| run_tile(spec, number as u32, &prepared, &backend, &[], control).unwrap();
        let [shown, open] = [&sampled, &exact].map(|spec| set(&run(spec).bytes, &scene));
        let walls = run_portal_tile(&portals, number as u32, &prepared, control).unwrap();
        let walls = set(&walls.bytes, &scene);
        let (min, max) = tile.cell.world(&lattice);
        // Of a box a little inside, walls in the faces block in any case.
        let gap = ((max - min).min_element() / 4.0).min(1e-3);
        let inner = of_closed(&queries, min + gap, max - gap);
        let closed = of_closed(&queries, min, max);
        assert!(is_part(&shown, &open), "box {number} shows what is hidden");
        assert!(
            is_part(&inner, &open),
            "box {number} hides what is seen from the inside"
        );
        assert!(
            is_part(&open, &walls),
            "box {number}: portals hide what is seen"
        );
        assert!(
            is_part(&open, &closed),
            "box {number} sees more than the closed box"
        );
        open_sum += open.len();
        closed_sum += closed.len();
        inner_sum += inner.len();
    }
    // What touches a face from the inside is not seen from the box inside.
    assert!(
        open_sum < closed_sum,
        "walls in faces hide something: {open_sum} of {closed_sum}"
    );
    assert!(
        open_sum < inner_sum * 6 / 5,
        "{open_sum} seen, {inner_sum} from a little inside"
    );
}

#[test]
fn what_needs_equal_closed_cells_is_refused() {
    let scene = generate(
        Kind::Rooms,
        &Params {
            triangles: Some(500),
            ..Params::default()
        },
    )
    .unwrap();
    let tree = Arc::new(along_walls(&scene, scene.bounds(), 5, &|_| true));
    let good = JobSpec::new(scene.digest().0, Division::Tree(tree), scene.bounds());
    good.check().unwrap();
    let mut cubes = good.clone();
    cubes.sampling.sampler = sightline_model::Sampler::Cubes;
    let mut pairs = good.clone();
    pairs.sampling.cell_to_cell = sightline_model::CellToCell::On;
    let proofs = JobSpec {
        method: Method::Exact,
        certificates: true,
        ..good
    };
    for other in [cubes, pairs, proofs] {
        assert!(other.check().is_err(), "{other:?}");
    }
}
