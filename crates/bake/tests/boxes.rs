//! Tests of boxes along walls: open boxes, in which walls in a face block.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

mod common;
#[path = "common/cpu.rs"]
mod cpu;

use std::sync::Arc;

use common::Quiet;
use cpu::cpu;
use glam::Vec3;
use sightline_bake::{BakeScene, Control, Inputs, SoleMember, run};
use sightline_exact::{Cell, CellTask as ExactTask, ExactScene, decide};
use sightline_model::{
    BoxCells, CellToCell, Effort, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling,
    SceneFacts, Task, TileOutput, TracerChoice, Visibility, codec,
};
use sightline_portals::along_walls;
use sightline_scene::Scene;
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_viewcells::TileIndex;

/// Returns the set of a tile of one cell.
fn set(bytes: &[u8], scene: &Scene) -> Vec<u32> {
    match codec::decode(bytes, scene.len()).unwrap() {
        TileOutput::Cells(sets) if sets.cells.len() == 1 => sets.cells[0].visible.clone(),
        _ => panic!("a box is a tile of one cell"),
    }
}

/// Returns the set of a closed box from exact queries.
fn of_closed(prepared: &ExactScene, min: Vec3, max: Vec3) -> Vec<u32> {
    decide(&ExactTask {
        scene: prepared,
        cell: Cell::new(min, max).unwrap(),
        region: None,
        seen: &[],
        above: &[],
        listed: None,
        limits: sightline_exact::QueryLimits::default(),
        seed: 3,
        keep: false,
        stop: &|| false,
        asked: &|| {},
    })
    .visible
}

#[test]
fn wall_in_face_of_box_blocks() {
    let params = SceneParams {
        triangles: Some(500),
        ..SceneParams::default()
    };
    let scene = Arc::new(generate(SceneKind::Rooms, &params).unwrap());
    let tree = along_walls(&scene, scene.bounds(), 14, &|_| true);
    let cells =
        || KnownCells::Boxes(BoxCells::new(scene.bounds(), Arc::new(tree.clone())).unwrap());
    let sampling = || Sampling {
        tracer: TracerChoice::Cpu,
        ..Sampling::new(Sampler::lines(cells()))
    };
    let job = |method: Method| {
        let task = Visibility {
            pairs: CellToCell::Off,
            ..method.into()
        };
        let spec = JobSpec {
            scene: scene.digest().0,
            task: Task::Visibility(task),
        };
        let read = JobSpec::from_message(&spec.to_message(), &SceneFacts::default());
        assert_eq!(read.as_ref(), Ok(&spec));
        PlannedJob::new(spec).unwrap()
    };
    let sampled = job(Method::aggressive(sampling()));
    let exact = job(Method::exact(sampling(), Effort::Full));
    let portals = job(Method::portals(cells()));
    let backend = cpu(&scene, exact.spec());
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &SoleMember,
    };
    let prepared = BakeScene::new(Arc::clone(&scene)).unwrap();
    let queries = ExactScene::prepare(&scene).unwrap();
    let (lattice, plan) = (exact.lattice().unwrap(), exact.plan());
    assert_eq!(plan.tiles.len(), 14);
    let is_part = |a: &[u32], b: &[u32]| a.iter().all(|t| b.binary_search(t).is_ok());
    let [mut open_sum, mut closed_sum, mut inner_sum] = [0; 3];
    for (number, tile) in plan.tiles.iter().enumerate() {
        let inputs = Inputs::new(&prepared).with_tracer(&backend);
        let [shown, open, walls] = [&sampled, &exact, &portals].map(|job| {
            let done = run(job, TileIndex(number as u32), inputs, control).unwrap();
            set(&done.bytes, &scene)
        });
        let (min, max) = tile.cell.world(lattice);
        // In a box slightly inside, walls in the faces of the outer box always block.
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
    // Triangles that touch a face from the inside are not visible from the inner box.
    assert!(
        open_sum < closed_sum,
        "walls in faces hide something: {open_sum} of {closed_sum}"
    );
    assert!(
        open_sum < inner_sum * 6 / 5,
        "{open_sum} seen, {inner_sum} from a little inside"
    );
}
