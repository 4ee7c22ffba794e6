//! Tests of the sets of a region. A triangle strictly visible from a point of the region is in the set of the
//! point's cell, and the sets of the region are subsets of the sets of whole cells.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

mod common;

use std::sync::Arc;

use common::Quiet;
use glam::Vec3;
use sightline_bake::{BakeScene, Control, Inputs, SoleMember, run};
use sightline_geometry::predicates::crossed_alone;
use sightline_model::numbers::TargetError;
use sightline_model::{
    CellSet, Completion, Effort, Granularity, GridCells, JobSpec, KnownCells, LineAim, Method,
    PlannedJob, Sampler, Sampling, Stop, TileOutput, Viewpoints, codec,
};
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::{
    Enclosure, EnclosureLimits, RegionPlanes, Tree, enclose, reached, region_of,
};
use sightline_scene::Scene;
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_trace::{CubeSpec, cpu::CpuBackend};
use sightline_viewcells::{CellBox, Division, PartMask, TileIndex, UNITS_PER_CELL};

const CELLS: [u32; 3] = [3, 2, 2];

/// Returns the sets of a scene's cells, sampled or decided.
fn sets(scene: &Arc<Scene>, effort: Option<Effort>, viewpoints: Viewpoints) -> Vec<CellSet> {
    let cells = GridCells::new(scene.bounds(), CELLS).unwrap();
    let cells = KnownCells::Grid(cells.with_viewpoints(viewpoints).unwrap());
    let (error, stop) = (TargetError::new(1e-3).unwrap(), Stop::Expected);
    let aim = LineAim::Known { cells, error, stop };
    let sampling = Sampling::new(Sampler::Lines { aim, time: None });
    let backend =
        CpuBackend::new(Arc::clone(scene), CubeSpec::from_sampler(&sampling.sampler)).unwrap();
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let control = Control {
        watcher: &Quiet,
        deadline: None,
        crew: &SoleMember,
    };
    let method = match effort {
        Some(effort) => Method::exact(sampling, effort),
        // Likely triangles can be hidden.
        None => Method::Aggressive {
            sampling,
            items: Granularity::Triangles,
            completion: Completion::Off,
        },
    };
    let job = PlannedJob::new(JobSpec::new(scene.digest().0, method)).unwrap();
    let inputs = Inputs::new(&prepared).with_tracer(&backend);
    let done = run(&job, TileIndex(0), inputs, control).unwrap();
    match codec::decode(&done.bytes, scene.len()).unwrap() {
        TileOutput::Cells(sets) => sets.cells,
        TileOutput::Pack(_) => panic!("a leaf tile has cells"),
    }
}

/// Returns the triangle that a segment crosses first, if exact signs determine it.
fn strictly_seen(scene: &Scene, p: Vec3, q: Vec3) -> Option<u32> {
    crossed_alone(scene.triangles().iter().map(|t| t.v), p, q)
}

#[test]
fn sets_of_region_contain_triangles_seen_from_room() {
    let scene = Arc::new(
        generate(
            SceneKind::Rooms,
            &SceneParams {
                triangles: Some(700),
                ..SceneParams::default()
            },
        )
        .unwrap(),
    );
    let mut random = SplitMix64::new(5);
    let bounds = scene.bounds();
    let mut point = |bounds: Aabb| {
        let mut unit = || random.unit_f32();
        bounds.min + (bounds.max - bounds.min) * Vec3::new(unit(), unit(), unit())
    };
    // A point around which walls enclose the region.
    let (region, reach) = (0..50)
        .find_map(|_| {
            let seed = [point(bounds).to_array()];
            let mut tree = Tree::new(&scene, &seed);
            let found = enclose(&mut tree, &seed, EnclosureLimits::default(), &mut |_| true);
            let region = region_of(&tree, &reached(&tree, &seed)).unwrap();
            let reach = RegionPlanes::new(&region, &scene).unwrap();
            (found == Enclosure::Closed).then_some((region, reach))
        })
        .unwrap();
    // The cells in the order of the sets, which is the order of the tree.
    let division = Division::Grid(CELLS);
    let lattice = division.lattice(bounds.min, bounds.max).unwrap();
    let (mut cells, mut open) = (Vec::new(), vec![(division.root(&lattice), 0)]);
    while let Some((cell, depth)) = open.pop() {
        match division.split(&lattice, &cell, depth) {
            Some(split) => {
                let [below, above] = cell.children(split);
                open.extend([(above, depth + 1), (below, depth + 1)]);
            }
            None => cells.push(cell),
        }
    }
    let of_cell = |cell: &CellBox| {
        let (min, max) = cell.world(&lattice);
        Aabb::new(min, max)
    };
    let boxes: Vec<Aabb> = cells.iter().map(of_cell).collect();
    let mut marks = PartMask::empty(CELLS);
    for (cell, bounds) in cells
        .iter()
        .zip(&boxes)
        .filter(|(_, bounds)| reach.meets(**bounds))
    {
        let at = cell.lo.map(|u| u / UNITS_PER_CELL);
        let each = |k: u32| [at[0] * 4 + k % 4, at[1] * 4 + k / 4 % 4, at[2] * 4 + k / 16];
        assert!(reach.any_in(*bounds).is_some());
        (0..64).for_each(|k| marks.mark(each(k)));
    }
    let within = Viewpoints::new(marks.clone(), Some(region));
    let sampled = sets(&scene, None, within.clone());
    let exact = sets(&scene, Some(Effort::Full), within);
    let whole = sets(&scene, Some(Effort::Full), Viewpoints::new(marks, None));
    let is_part =
        |a: &CellSet, b: &CellSet| a.visible.iter().all(|t| b.visible.binary_search(t).is_ok());
    for ((sampled, exact), whole) in sampled.iter().zip(&exact).zip(&whole) {
        assert!(is_part(sampled, exact) && is_part(exact, whole));
        assert!(exact.decision.is_some() && exact.undecided.is_empty());
    }
    let sum = |sets: &[CellSet]| sets.iter().map(|s| s.visible.len()).sum::<usize>();
    assert!(
        sum(&exact) < sum(&whole),
        "{} in the region, {} in whole cells",
        sum(&exact),
        sum(&whole)
    );
    let mut seen = 0;
    for (cell_box, set) in boxes.iter().zip(&exact).filter(|(_, set)| !set.unreached) {
        for _ in 0..1500 {
            let (p, q) = (point(*cell_box), point(bounds));
            let far = p + (q - p) * 4.0;
            if reach.holds(p)
                && let Some(id) =
                    strictly_seen(&scene, p, far).or_else(|| strictly_seen(&scene, p, q))
            {
                seen += 1;
                assert!(
                    set.visible.binary_search(&id).is_ok(),
                    "triangle {id} is seen from {p}"
                );
            }
        }
    }
    assert!(seen > 200, "{seen} triangles were seen");
}
