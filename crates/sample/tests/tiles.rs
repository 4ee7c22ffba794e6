//! Tests that run whole plans tile by tile on the cpu backend, and check the sets against known triangles.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use sightline_model::numbers::{ErrorThreshold, MinDistance, Resolution};
use sightline_model::{
    CellSet, CellSets, CubeParams, ErrorMeasure, Granularity, Pack, Stop, SubtreeNode,
    SupersetChoice, TileOutput, codec,
};
use sightline_sample::crew::SoleMember;
use sightline_sample::{JobContext, LineSampler, TileSampler, Watcher, tile};
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_scene::{Object, Scene, Triangle, overlap};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::{CubeSpec, PreparedScene, Tracer};
use sightline_viewcells::{CellBox, Division, Layout, Plan, Tile, TileKind};

#[derive(Default)]
struct Count(AtomicU64, AtomicU64);
impl Watcher for Count {
    fn rendered(&self, cubes: u64) {
        self.0.fetch_add(cubes, Ordering::Relaxed);
    }
    fn cell_done(&self) {
        self.1.fetch_add(1, Ordering::Relaxed);
    }
    fn cancelled(&self) -> bool {
        false
    }
}

/// Returns the cpu backend for a sampler.
fn backend(scene: &Arc<Scene>, sampler: TileSampler) -> CpuBackend {
    let cubes = match sampler {
        TileSampler::Cubes(params) => params,
        TileSampler::Lines(_) => CubeParams::default(),
    };
    CpuBackend::new(Arc::clone(scene), CubeSpec::new(&cubes)).unwrap()
}

/// Computes every tile of a plan in its order and returns the sets of all cells.
fn bake(scene: Scene, division: Division, sampler: TileSampler) -> (Arc<Scene>, Vec<CellSet>, u64) {
    let (scene, tiles, count) = bake_tiles(scene, division, sampler);
    let cells = tiles.into_iter().flat_map(|(_, sets)| sets.cells).collect();
    (scene, cells, count)
}

/// Leaf tiles with their outputs.
type Leaves = Vec<(Tile, CellSets)>;

/// Works like [`bake`], but returns the sets by leaf tile. Packs are encoded and decoded, as between
/// machines.
fn bake_tiles(scene: Scene, division: Division, sampler: TileSampler) -> (Arc<Scene>, Leaves, u64) {
    let scene = Arc::new(scene);
    let backend = backend(&scene, sampler);
    let b = scene.bounds();
    let lattice = division.lattice(b.min, b.max).unwrap();
    let prepared = PreparedScene::new(Arc::clone(&scene)).unwrap();
    let layout = match sampler {
        TileSampler::Cubes(_) => Layout::Samples,
        TileSampler::Lines(_) => Layout::Blocks(512),
    };
    let plan = Plan::new(&division, &lattice, layout);
    let job = JobContext {
        scene: &prepared,
        division,
        lattice,
        sampler,
        items: Granularity::Triangles,
        completes: false,
        far: None,
        viewpoints: None,
        region: None,
        pairs: None,
        backend: &backend as &dyn Tracer,
        seed: 0,
        deadline: None,
        crew: &SoleMember,
    };
    let mut outputs: Vec<Vec<u8>> = Vec::new();
    let mut leaves = Vec::new();
    let count = Count::default();
    for tile in &plan.tiles {
        let packs: Vec<Pack> = tile
            .needs
            .iter()
            .map(|n| codec::decode_pack(&outputs[*n as usize], scene.len(), &tile.cell).unwrap())
            .collect();
        let (output, _) = tile::run(&job, tile, &packs, &count).unwrap();
        assert_eq!(
            matches!(output, TileOutput::Cells(_)),
            tile.kind == TileKind::Leaf
        );
        outputs.push(codec::encode(&output).unwrap());
        if let TileOutput::Cells(sets) = output {
            leaves.push((tile.clone(), sets));
        }
    }
    assert_eq!(
        count.1.into_inner(),
        leaves
            .iter()
            .map(|(_, sets)| sets.cells.len() as u64)
            .sum::<u64>()
    );
    (scene, leaves, count.0.into_inner())
}

fn coarse() -> CubeParams {
    CubeParams {
        resolution: Resolution::new(64).unwrap(),
        min_distance: MinDistance::new(1.0).unwrap(),
        ..CubeParams::default()
    }
}

/// Returns lines with this target error.
fn lines(error: f64) -> TileSampler {
    let stop = Stop::Expected;
    TileSampler::Lines(LineSampler::Shared { error, stop })
}

fn rooms() -> Scene {
    generate(
        SceneKind::Rooms,
        &SceneParams {
            triangles: Some(2_000),
            ..SceneParams::default()
        },
    )
    .unwrap()
}

#[test]
fn cell_sees_triangles_that_meet_it_and_two_bakes_are_equal() {
    let division = Division::Grid([3, 2, 2]);
    let (scene, cells, samples) = bake(rooms(), division.clone(), TileSampler::Cubes(coarse()));
    assert_eq!(cells.len(), 12);
    assert!(samples > 36, "at least every cell corner: {samples}");
    let lattice = division
        .lattice(scene.bounds().min, scene.bounds().max)
        .unwrap();
    let plan = Plan::new(&division, &lattice, Layout::Samples);
    // With twelve cells every leaf tile is one cell, in order.
    for (n, set) in plan.leaves().zip(&cells) {
        let (min, max) = plan.tiles[n as usize].cell.world(&lattice);
        let inside = overlap::triangles_in_box(&scene, None, &sightline_scene::Aabb { min, max });
        assert!(
            inside
                .iter()
                .all(|id| set.visible.binary_search(id).is_ok())
        );
        assert!(set.visible.is_sorted() && set.samples >= 8);
    }
    let (_, again, _) = bake(rooms(), division.clone(), TileSampler::Cubes(coarse()));
    assert_eq!(cells, again);
}

#[test]
fn every_measure_and_superset_works_and_more_samples_see_no_less() {
    let division = Division::Grid([2, 2, 1]);
    let (_, base, few) = bake(rooms(), division.clone(), TileSampler::Cubes(coarse()));
    let finer = CubeParams {
        min_distance: MinDistance::new(0.25).unwrap(),
        error_threshold: ErrorThreshold::new(0.0).unwrap(),
        ..coarse()
    };
    let (_, more, many) = bake(rooms(), division.clone(), TileSampler::Cubes(finer));
    assert!(many > few);
    for (a, b) in base.iter().zip(&more) {
        assert!(
            a.visible
                .iter()
                .all(|id| b.visible.binary_search(id).is_ok())
        );
    }
    for measure in [ErrorMeasure::Sets, ErrorMeasure::Pixels] {
        let (_, cells, _) = bake(
            rooms(),
            division.clone(),
            TileSampler::Cubes(CubeParams {
                measure,
                ..coarse()
            }),
        );
        assert_eq!(cells.len(), 4);
    }
    // Rendering only the triangles that the parent cell saw must lose few of the triangles seen without the
    // simplification.
    let simplified = CubeParams {
        superset: SupersetChoice::On,
        ..finer
    };
    let (_, simplified, _) = bake(rooms(), division.clone(), TileSampler::Cubes(simplified));
    for (a, b) in more.iter().zip(&simplified) {
        let common = a
            .visible
            .iter()
            .filter(|id| b.visible.binary_search(id).is_ok())
            .count();
        assert!(
            common * 100 >= a.visible.len() * 98,
            "{common} of {}",
            a.visible.len()
        );
    }
}

#[test]
fn adaptive_tree_stops_at_budget_or_depth() {
    let division = Division::Adaptive {
        budget: 300,
        max_depth: 6,
    };
    let (_, cells, _) = bake(rooms(), division.clone(), TileSampler::Cubes(coarse()));
    assert!(cells.len() >= 8 && cells.len() <= 64);
    let generous = Division::Adaptive {
        budget: 1_000_000,
        max_depth: 6,
    };
    let (_, few, _) = bake(rooms(), generous, TileSampler::Cubes(coarse()));
    assert_eq!(few.len(), 8, "the levels that are always split");
}

/// Returns the cells of a tile with their boxes and depths.
fn cells(tile: &Tile, sets: &CellSets) -> Vec<(CellBox, u32, CellSet)> {
    let mut waiting = vec![(tile.cell, tile.depth)];
    let mut sets_left = sets.cells.iter();
    let mut out = Vec::new();
    for node in &sets.nodes {
        let (cell, depth) = waiting.pop().unwrap();
        match node {
            SubtreeNode::Split(split) => {
                let [below, above] = cell.children(*split);
                waiting.extend([(above, depth + 1), (below, depth + 1)]);
            }
            SubtreeNode::Cell => out.push((cell, depth, sets_left.next().unwrap().clone())),
        }
    }
    assert!(waiting.is_empty() && sets_left.next().is_none());
    out
}

/// Returns a large hall with boxes in it. One box is small, closed and full: few triangles are visible from
/// next to it, and many from inside.
fn full_box() -> Scene {
    let mut t = solid(Vec3::ZERO, Vec3::splat(16.0));
    t.extend((0..4).flat_map(|i| {
        solid(
            Vec3::splat(1.3 + 3.0 * i as f32),
            Vec3::splat(2.4 + 3.0 * i as f32),
        )
    }));
    let middle = Vec3::new(5.4, 9.6, 3.4);
    t.extend(solid(middle - 0.3, middle + 0.3));
    for i in 0..64 {
        let at =
            middle + (Vec3::new((i % 4) as f32, (i / 4 % 4) as f32, (i / 16) as f32) - 1.5) * 0.12;
        t.push(Triangle {
            v: [at, at + Vec3::X * 0.02, at + Vec3::Y * 0.02],
        });
    }
    scene(t)
}

#[test]
fn adaptive_tree_of_sight_lines_is_halved_only_where_needed() {
    let sampler = lines(1e-3);
    // The box is in one of the smallest cells.
    let (budget, max_depth) = (70, 12);
    let division = Division::Adaptive { budget, max_depth };
    let (scene, tiles, _) = bake_tiles(full_box(), division.clone(), sampler);
    assert_eq!(tiles.len(), 8);
    let lattice = division
        .lattice(scene.bounds().min, scene.bounds().max)
        .unwrap();
    let (mut deepest, mut shallowest) = (0, max_depth);
    for (tile, sets) in &tiles {
        let all = cells(tile, sets);
        for (cell, depth, set) in &all {
            assert!(
                set.visible.len() <= budget as usize || *depth == max_depth,
                "{depth}: {}",
                set.visible.len()
            );
            let (min, max) = cell.world(&lattice);
            let inside =
                overlap::triangles_in_box(&scene, None, &sightline_scene::Aabb { min, max });
            assert!(
                set.visible.is_sorted()
                    && inside
                        .iter()
                        .all(|id| set.visible.binary_search(id).is_ok())
            );
            assert!(!set.stats.unfinished && set.stats.rays[0] > 0);
            (deepest, shallowest) = (deepest.max(*depth), shallowest.min(*depth));
        }
        // Two halves that are cells see more triangles together than the budget.
        for pair in all.windows(2) {
            let [(a, da, x), (b, db, y)] = pair else {
                continue;
            };
            let halves = da == db
                && *da > tile.depth
                && (0..3)
                    .filter(|k| (a.lo[*k], a.hi[*k]) == (b.lo[*k], b.hi[*k]))
                    .count()
                    == 2
                && division
                    .split(&lattice, &CellBox { lo: a.lo, hi: b.hi }, da - 1)
                    .is_some_and(|s| CellBox { lo: a.lo, hi: b.hi }.children(s) == [*a, *b]);
            if halves {
                let mut both = [x.visible.as_slice(), &y.visible].concat();
                both.sort_unstable();
                both.dedup();
                assert!(both.len() > budget as usize, "{} at {da}", both.len());
            }
        }
    }
    assert_eq!(
        (deepest, shallowest),
        (max_depth, 3),
        "some cells are as small as can be, and some tiles are one"
    );
    let (_, again, _) = bake_tiles(full_box(), division.clone(), sampler);
    assert!(
        tiles.iter().zip(&again).all(|(a, b)| a.1 == b.1),
        "twice is not the same"
    );
    // Triangles that are seen from a part are also seen from the whole.
    let generous = Division::Adaptive {
        budget: 1000,
        max_depth: 12,
    };
    let (_, whole, _) = bake_tiles(full_box(), generous, sampler);
    let (_, parts, _) = bake_tiles(
        full_box(),
        Division::Adaptive {
            budget: 1,
            max_depth: 12,
        },
        sampler,
    );
    for ((_, whole), (_, parts)) in whole.iter().zip(&parts) {
        assert_eq!((whole.cells.len(), parts.cells.len()), (1, 512));
        let mut all: Vec<u32> = parts
            .cells
            .iter()
            .flat_map(|c| c.visible.iter().copied())
            .collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(whole.cells[0].visible, all);
        let sum = |k: usize| parts.cells.iter().map(|c| c.stats.rays[k]).sum::<u64>();
        assert_eq!(whole.cells[0].stats.rays, [0, 1, 2, 3].map(sum));
    }
}

#[test]
fn adaptive_tree_ends_before_coarse_coordinates_lose_lines() {
    // Far from the origin a small cell is a few steps of single precision wide.
    let far = solid(Vec3::splat(1e6), Vec3::splat(1e6 + 16.0));
    let sampler = lines(1e-2);
    let division = Division::Adaptive {
        budget: 1,
        max_depth: 12,
    };
    let (_, cells, _) = bake(scene(far), division.clone(), sampler);
    let seen: Vec<usize> = cells.iter().map(|c| c.visible.len()).collect();
    assert_eq!(seen, [12; 8]);
}

#[test]
fn adaptive_tree_marks_unfinished_cells_at_deadline() {
    let sampler = lines(1e-4);
    let scene = Arc::new(full_box());
    let backend = backend(&scene, sampler);
    let division = Division::Adaptive {
        budget: 5,
        max_depth: 12,
    };
    let lattice = division
        .lattice(scene.bounds().min, scene.bounds().max)
        .unwrap();
    let prepared = PreparedScene::new(Arc::clone(&scene)).unwrap();
    let plan = Plan::new(&division, &lattice, Layout::Blocks(512));
    let now = Some(std::time::Instant::now());
    let backend = &backend as &dyn Tracer;
    let job = JobContext {
        scene: &prepared,
        division,
        lattice: lattice.clone(),
        sampler,
        items: Granularity::Triangles,
        completes: false,
        far: None,
        viewpoints: None,
        region: None,
        pairs: None,
        backend,
        seed: 0,
        deadline: now,
        crew: &SoleMember,
    };
    let TileOutput::Cells(sets) = tile::run(&job, &plan.tiles[0], &[], &Count::default())
        .unwrap()
        .0
    else {
        panic!("a leaf tile gives cells")
    };
    for (cell, depth, set) in cells(&plan.tiles[0], &sets) {
        assert!(set.stats.unfinished && depth <= 12);
        let (min, max) = cell.world(&lattice);
        let inside = overlap::triangles_in_box(&scene, None, &sightline_scene::Aabb { min, max });
        assert!(
            inside
                .iter()
                .all(|id| set.visible.binary_search(id).is_ok())
        );
    }
}

fn tri(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> Triangle {
    Triangle {
        v: [a.into(), b.into(), c.into()],
    }
}

/// Returns the twelve triangles of a box, facing outward.
fn solid(min: Vec3, max: Vec3) -> Vec<Triangle> {
    let p = |i: usize| {
        [
            if i & 1 == 0 { min.x } else { max.x },
            if i & 2 == 0 { min.y } else { max.y },
            if i & 4 == 0 { min.z } else { max.z },
        ]
    };
    [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ]
    .into_iter()
    .flat_map(|q: [usize; 4]| {
        [
            tri(p(q[0]), p(q[1]), p(q[2])),
            tri(p(q[0]), p(q[2]), p(q[3])),
        ]
    })
    .collect()
}

fn scene(triangles: Vec<Triangle>) -> Scene {
    let count = triangles.len() as u32;
    Scene::new(
        "test",
        triangles,
        vec![Object {
            name: "all".into(),
            first: 0,
            count,
        }],
    )
    .unwrap()
}

#[test]
fn closed_box_hides_its_inside_and_degenerate_triangles_are_hidden() {
    // No face of the boxes lies in a face of the grid's cells.
    let mut t = solid(Vec3::splat(-3.1), Vec3::splat(3.3));
    let inner = t.len() as u32;
    t.extend(solid(Vec3::splat(-0.7), Vec3::splat(0.9)));
    let degenerate = t.len() as u32;
    t.push(tri([0.0; 3], [1.0; 3], [2.0; 3]));
    // Two far corners stretch the view box around the boxes.
    let corners = t.len() as u32;
    t.push(tri([-10.0; 3], [-9.0, -10.0, -10.0], [-10.0, -9.0, -10.0]));
    t.push(tri([10.0; 3], [9.0, 10.0, 10.0], [10.0, 9.0, 10.0]));
    let division = Division::Grid([7, 7, 7]);
    let (scene, cells, _) = bake(scene(t), division.clone(), TileSampler::Cubes(coarse()));
    let lattice = division
        .lattice(scene.bounds().min, scene.bounds().max)
        .unwrap();
    let mut outside = 0;
    // The cells in the order of the result: the kd-tree depth first.
    let mut order = Vec::new();
    fn walk(
        d: &Division,
        l: &sightline_viewcells::Lattice,
        c: sightline_viewcells::CellBox,
        out: &mut Vec<sightline_viewcells::CellBox>,
    ) {
        match d.split(l, &c, 0) {
            Some(s) => c.children(s).into_iter().for_each(|k| walk(d, l, k, out)),
            None => out.push(c),
        }
    }
    walk(&division, &lattice, division.root(&lattice), &mut order);
    assert_eq!(order.len(), cells.len());
    for (cell, set) in order.iter().zip(&cells) {
        assert!(set.visible.binary_search(&degenerate).is_err());
        let (min, max) = cell.world(&lattice);
        if min.cmpgt(Vec3::splat(3.3)).any() || max.cmplt(Vec3::splat(-3.1)).any() {
            outside += 1;
            let leaked: Vec<u32> = set
                .visible
                .iter()
                .copied()
                .filter(|id| (inner..corners).contains(id))
                .collect();
            assert!(
                leaked.is_empty(),
                "{min} to {max} sees {leaked:?} through the walls"
            );
        }
    }
    assert!(outside > 200, "{outside}");
}

#[test]
fn exact_duplicates_are_seen_together() {
    let wall = tri([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let turned = Triangle {
        v: [wall.v[2], wall.v[0], wall.v[1]],
    };
    let back = tri([0.0, 0.0, 4.0], [4.0, 0.0, 4.0], [0.0, 4.0, 4.0]);
    let (_, cells, _) = bake(
        scene(vec![wall, back, turned]),
        Division::Grid([2, 2, 2]),
        TileSampler::Cubes(coarse()),
    );
    for set in &cells {
        assert_eq!(
            set.visible.binary_search(&0).is_ok(),
            set.visible.binary_search(&2).is_ok()
        );
    }
    assert!(cells.iter().any(|s| s.visible.contains(&0)));
}
