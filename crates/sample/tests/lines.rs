//! Tests of sight lines: equal on any number of threads, sound, complete where completeness is known, and
//! bounded as promised.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::Arc;

use glam::Vec3;
use sightline_model::CellStats;
use sightline_sample::Unwatched;
use sightline_sample::crew::SoleMember;
use sightline_sample::lines::block::{Block, BlockInputs};
use sightline_sample::lines::rounds::Tolerance;
use sightline_scene::generate::{self, SceneKind, SceneParams};
use sightline_scene::{Object, Scene, Triangle};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::packet::Packet;
use sightline_trace::rows::Rows;
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_trace::surface::Surface;
use sightline_trace::{CubeSpec, LineSet, Strata, Tracer};

fn backend(scene: &Arc<Scene>) -> CpuBackend {
    let spec = CubeSpec {
        resolution: 64,
        strata: Strata::One,
        keep_pixels: false,
    };
    CpuBackend::new(Arc::clone(scene), spec).unwrap()
}

fn scene(triangles: Vec<[Vec3; 3]>) -> Arc<Scene> {
    let count = triangles.len() as u32;
    let triangles = triangles.into_iter().map(|v| Triangle { v }).collect();
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count,
    }];
    Arc::new(Scene::new("test", triangles, objects).unwrap())
}

/// Returns a box whose sides are n×n squares of two triangles each, seen from inside and outside.
fn tessellated_box(min: Vec3, max: Vec3, n: u32) -> Vec<[Vec3; 3]> {
    let mut out = Vec::new();
    // The same arithmetic computes equal corners, so that sides meet to the bit.
    let at = |a: usize, i: u32| {
        if i == n {
            max[a]
        } else {
            min[a] + (max[a] - min[a]) * i as f32 / n as f32
        }
    };
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [min[axis], max[axis]] {
            for i in 0..n {
                for j in 0..n {
                    let corner = |i: u32, j: u32| {
                        let mut p = Vec3::ZERO;
                        p[axis] = side;
                        p[u] = at(u, i);
                        p[v] = at(v, j);
                        p
                    };
                    let [a, b, c, d] = [
                        corner(i, j),
                        corner(i + 1, j),
                        corner(i + 1, j + 1),
                        corner(i, j + 1),
                    ];
                    out.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    out
}

fn with_block<R>(
    scene: &Arc<Scene>,
    sight: &SightLineTracer<'_>,
    view: [Vec3; 2],
    cells: [u32; 3],
    seed: u64,
    f: impl FnOnce(&mut Block<'_>) -> R,
) -> R {
    let surface = Surface::new(scene, &all(scene));
    let rows = Rows::triangles(scene);
    let (watcher, deadline) = (&Unwatched, None);
    let grid = CellGrid::new(view[0], view[1], cells);
    let pairs = Pairs::new(grid.clone());
    let pairs = Some(&pairs);
    let (surface, rows, crew) = (&surface, &rows, &SoleMember);
    let inputs = BlockInputs {
        scene,
        surface,
        rows,
        sight,
        seed,
        watcher,
        deadline,
        pairs,
        region: None,
        crew,
        observer: None,
    };
    let [nx, ny, _] = cells.map(u64::from);
    let number = |c: [u32; 3]| (u64::from(c[2]) * ny + u64::from(c[1])) * nx + u64::from(c[0]);
    f(&mut Block::new(inputs, grid, number, |_| u64::MAX))
}

fn sets(block: &Block<'_>) -> Vec<Vec<u32>> {
    block.bits().columns()
}

/// Returns the likely triangles of each cell.
fn likely(block: &Block<'_>) -> Vec<Vec<u32>> {
    let likely = block.likely_items().into_iter();
    likely
        .map(|items| items.iter().map(|l| l.item).collect())
        .collect()
}

fn all(scene: &Scene) -> Vec<u32> {
    (0..scene.len())
        .filter(|id| !scene.triangles()[*id as usize].is_degenerate())
        .collect()
}

#[test]
fn sets_do_not_depend_on_threads() {
    let params = SceneParams {
        triangles: Some(3000),
        ..SceneParams::default()
    };
    let scene = Arc::new(generate::generate(SceneKind::Rooms, &params).unwrap());
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    let b = scene.bounds();
    let run = |threads: usize| -> (Vec<Vec<u32>>, Vec<CellStats>) {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            with_block(&scene, &sight, [b.min, b.max], [5, 3, 2], 7, |block| {
                block.sample_before_bound(1.0, 0.01).unwrap();
                block.sample_to_bound(1.0, 0.01).unwrap();
                block.join_to_bound(0.01).unwrap();
                (sets(block), block.stats().to_vec())
            })
        })
    };
    let one = run(1);
    let within = |b: Option<f64>| b.unwrap() <= 0.01;
    assert!(
        one.1
            .iter()
            .all(|s| within(s.bound()) && within(s.cell_bound())),
        "the bounds are reached"
    );
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

/// Checks that guided rays do not depend on threads, and find more if every crossed cell is credited.
#[test]
fn guided_rays_share_segments() {
    let params = SceneParams {
        triangles: Some(8000),
        ..SceneParams::default()
    };
    let scene = Arc::new(generate::generate(SceneKind::Rooms, &params).unwrap());
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    let b = scene.bounds();
    let run = |threads: usize, shared: bool| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            with_block(&scene, &sight, [b.min, b.max], [6, 2, 6], 3, |block| {
                match shared {
                    true => block.sample_guided_shared(2000).unwrap(),
                    false => block.sample_guided(2000).unwrap(),
                }
                (sets(block), block.stats().to_vec())
            })
        })
    };
    let (shared, alone) = (run(1, true), run(1, false));
    assert_eq!(shared, run(5, true));
    let count = |sets: &[Vec<u32>]| sets.iter().map(Vec::len).sum::<usize>();
    assert!(
        count(&shared.0) > 3 * count(&alone.0) / 2,
        "{} triangles with shared segments, {} without",
        count(&shared.0),
        count(&alone.0)
    );
    assert!(shared.1.iter().all(|s| !s.unfinished));
}

#[test]
fn convex_room_is_fully_visible() {
    let scene = scene(tessellated_box(Vec3::splat(-3.0), Vec3::splat(3.0), 12));
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    with_block(
        &scene,
        &sight,
        [Vec3::splat(-2.0), Vec3::splat(2.0)],
        [3, 3, 3],
        1,
        |block| {
            block.sample(1e-5, &[], Tolerance::Equal).unwrap();
            let columns = sets(block);
            for c in block.grid().each() {
                assert_eq!(
                    columns[block.grid().slot(c).index()].len(),
                    scene.triangles().len(),
                    "{c:?}"
                );
            }
        },
    );
}

/// Checks that likely triangles are not seen, are few, do not depend on threads, and lower the number of
/// missed lines.
#[test]
fn likely_triangles_lower_error() {
    let params = SceneParams {
        triangles: Some(20_000),
        ..SceneParams::default()
    };
    let scene = Arc::new(generate::generate(SceneKind::Rooms, &params).unwrap());
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    let b = scene.bounds();
    // Returns the likely triangles by cell, and the number of missed held-out lines.
    let run = |threads: usize, completes: bool| -> (Vec<Vec<u32>>, u64) {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            with_block(&scene, &sight, [b.min, b.max], [6, 2, 6], 7, |block| {
                block.sample(0.01, &[], Tolerance::Equal).unwrap();
                if completes {
                    block.enable_completion(&[]);
                }
                block.complete_all();
                let (seen, likely) = (sets(block), likely(block));
                for (at, likely) in block.grid().each().zip(&likely) {
                    let seen = &seen[block.grid().slot(at).index()];
                    assert!(likely.is_sorted());
                    assert!(likely.iter().all(|t| seen.binary_search(t).is_err()));
                }
                let count = |sets: &[Vec<u32>]| sets.iter().map(Vec::len).sum::<usize>();
                assert!(20 * count(&likely) <= count(&seen));
                block.look(1, 20_000).unwrap();
                (likely, block.stats().iter().map(|s| s.bound_misses).sum())
            })
        })
    };
    let (none, misses) = run(2, false);
    assert!(none.concat().is_empty() && misses > 1000, "{misses} misses");
    let completed = run(1, true);
    assert!(completed.0.iter().any(|likely| !likely.is_empty()));
    assert!(
        10 * completed.1 < 8 * misses,
        "{} misses with likely triangles, {misses} without",
        completed.1
    );
    assert_eq!(completed, run(5, true));
}

/// Checks that over hundreds of seeds the bound is below the true fraction at most one time in twenty, with
/// and without likely triangles.
///
/// The room is convex, so the true fraction is known: every triangle is visible, and brute force determines
/// the fraction of sight lines that meet it.
#[test]
fn bounds_hold_with_their_confidence() {
    const SEEDS: u64 = 250;
    const CELLS: [u32; 3] = [2, 2, 1];
    let scene = scene(tessellated_box(Vec3::splat(-3.0), Vec3::splat(3.0), 24));
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    let view = [Vec3::splat(-2.5), Vec3::splat(2.5)];
    let grid = CellGrid::new(view[0], view[1], CELLS);
    // The fraction of sight lines of each cell that meet each triangle.
    let truth: Vec<Vec<f64>> = grid
        .each()
        .enumerate()
        .map(|(i, c)| {
            let (lo, size) = grid.cell_box(c);
            let mut random = Hashed::new(&[99, i as u64]);
            let mut hits = vec![0u64; scene.triangles().len()];
            let packets = 60_000;
            for _ in 0..packets {
                let mut p = [Packet::default()];
                for _ in 0..16 {
                    let face = (random.bits() % 6) as u32;
                    let [forward, right, up] = sightline_trace::cube::face_basis(face);
                    let d = forward
                        + right * (2.0 * random.unit() - 1.0)
                        + up * (2.0 * random.unit() - 1.0);
                    let o = lo + size * Vec3::new(random.unit(), random.unit(), random.unit());
                    p[0].push(o.to_array(), d.to_array());
                }
                sight.trace(&mut p, &mut Passed::default(), 0.0).unwrap();
                p[0].triangle.iter().for_each(|t| hits[*t as usize] += 1);
            }
            hits.into_iter()
                .map(|h| h as f64 / (16.0 * f64::from(packets)))
                .collect()
        })
        .collect();
    for completes in [false, true] {
        let (mut looks, mut wrong, mut useful, mut likely_triangles) = (0u32, 0u32, 0u32, 0);
        for seed in 0..SEEDS {
            with_block(&scene, &sight, view, CELLS, seed, |block| {
                // Sampling stops early, so that the set is incomplete when the bound is computed.
                block.sample_guided(600).unwrap();
                if completes {
                    block.enable_completion(&[]);
                }
                block.complete_all();
                let (before, likely) = (sets(block), likely(block));
                block.look(1, 400).unwrap();
                for (i, c) in block.grid().each().enumerate() {
                    let drawn = before[block.grid().slot(c).index()]
                        .iter()
                        .chain(&likely[i]);
                    let missed: f64 = 1.0 - drawn.map(|t| truth[i][*t as usize]).sum::<f64>();
                    let bound = block.stats()[i].bound().unwrap();
                    looks += 1;
                    wrong += u32::from(missed > bound);
                    useful += u32::from(missed > 0.3 * bound);
                    likely_triangles += likely[i].len();
                }
            });
        }
        assert_eq!(likely_triangles > 0, completes);
        // Look 1 has 2.5 %. Three standard deviations more are attributed to chance.
        let may = f64::from(looks) * 0.025;
        assert!(
            f64::from(wrong) <= may + 3.0 * may.sqrt(),
            "{wrong} of {looks} bounds were too low"
        );
        assert!(
            useful * 2 > looks,
            "the bounds are far above the truth: {useful} of {looks}"
        );
    }
}

/// Checks slivers, a closed wall without T-junctions and far from square, and small and large coordinates
/// together: no triangle outside is seen.
#[test]
fn lines_do_not_pass_closed_wall() {
    // The view box ends a little before the wall. If coordinates are coarse, it ends far enough away that
    // rounding does not move it into the wall.
    for (scale, offset, view) in [
        (1.0, 0.0, 0.99),
        (1e-6, 0.0, 0.99),
        (1e6, 0.0, 0.99),
        (1e-6, 1.0, 0.7),
        (1.0, 1e5, 0.7),
    ] {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z) * scale + Vec3::splat(offset);
        let mut triangles = tessellated_box(at(-1.0, -1.0, -1.0), at(1.0, 1.0, 1.0), 7);
        // Slivers. Fans from a distant corner over one side's squares would overlap; a thin inner prism does
        // not.
        triangles.extend(tessellated_box(
            at(-0.9, -1e-4, -0.9),
            at(0.9, 1e-4, 0.9),
            3,
        ));
        let inside = triangles.len() as u32;
        triangles.extend(tessellated_box(at(-3.0, -3.0, -3.0), at(3.0, 3.0, 3.0), 5));
        let scene = scene(triangles);
        let backend = backend(&scene);
        let sight =
            SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
        let view = [at(-view, -view, -view), at(view, view, view)];
        for guided in [false, true] {
            with_block(&scene, &sight, view, [3, 2, 2], 5, |block| {
                match guided {
                    false => block.sample(1e-4, &[], Tolerance::Equal).unwrap(),
                    true => block.sample_guided_shared(20_000).unwrap(),
                }
                let outside: usize = sets(block)
                    .iter()
                    .map(|s| s.iter().filter(|t| **t >= inside).count())
                    .sum();
                assert_eq!(outside, 0, "scale {scale}, offset {offset}, {guided}");
            });
        }
    }
}

/// Checks that inward lines from a vertex, an edge and the middle of a face of a closed box meet the box.
#[test]
fn lines_from_wall_stay_inside() {
    for scale in [1.0f32, 1e-6, 1e6] {
        let (min, max) = (Vec3::splat(-scale), Vec3::splat(scale));
        let mut triangles = tessellated_box(min, max, 6);
        let wall = triangles.len() as u32;
        triangles.extend(tessellated_box(min * 2.0, max * 2.0, 3));
        let scene = scene(triangles);
        let backend = backend(&scene);
        let sight =
            SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
        let mut random = Hashed::new(&[3]);
        let mut crossed = 0;
        for id in 0..wall {
            let v = scene.triangles()[id as usize].v;
            for from in [
                v[0],
                (v[0] + v[1]) * 0.5,
                (v[0] + v[2]) * 0.5,
                (v[0] + v[1] + v[2]) / 3.0,
            ] {
                // A midpoint may be rounded to just outside the box. Such an origin is not on the wall.
                let from = from.clamp(min, max);
                let mut packets: Vec<Packet> = Vec::new();
                for _ in 0..8 {
                    let mut p = Packet::default();
                    for _ in 0..16 {
                        let to =
                            Vec3::new(random.unit(), random.unit(), random.unit()) * 1.98 - 0.99;
                        p.push(from.to_array(), (to * scale - from).to_array());
                    }
                    packets.push(p);
                }
                sight
                    .trace(&mut packets, &mut Passed::default(), 0.0)
                    .unwrap();
                crossed += packets
                    .iter()
                    .flat_map(|p| p.triangle)
                    .filter(|t| *t >= wall)
                    .count();
            }
        }
        assert_eq!(crossed, 0, "scale {scale}");
    }
}

/// Checks that a closed closet full of leaves gets less time than its cell would need. The cells around it do
/// not depend on it.
#[test]
fn only_hardest_cell_has_raised_tolerance() {
    let mut random = Hashed::new(&[9]);
    let mut triangles = tessellated_box(Vec3::ZERO, Vec3::splat(10.0), 2);
    triangles.extend(tessellated_box(Vec3::splat(7.6), Vec3::splat(9.9), 2));
    triangles.extend((0..20_000).map(|_| {
        let c = Vec3::splat(7.7) + random.point() * 2.1;
        [0; 3].map(|_| c + (random.point() - 0.5) * 0.08)
    }));
    let scene = scene(triangles);
    let backend = backend(&scene);
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all(&scene)).unwrap());
    let sampled = |tolerance: Tolerance| -> Vec<CellStats> {
        with_block(
            &scene,
            &sight,
            [Vec3::ZERO, Vec3::splat(10.0)],
            [4, 4, 4],
            3,
            |block| {
                block.sample(1e-3, &[], tolerance).unwrap();
                block.stats().to_vec()
            },
        )
    };
    let (alike, spared) = (sampled(Tolerance::Equal), sampled(Tolerance::Raised));
    assert!(alike.iter().chain(&spared).all(|s| !s.unfinished));
    let rays = |cell: &CellStats| cell.rays.iter().sum::<u64>();
    let ([others_alike @ .., last_alike], [others_spared @ .., last_spared]) =
        (&alike[..], &spared[..])
    else {
        panic!("there are cells");
    };
    assert!(
        rays(last_spared) < rays(last_alike),
        "{last_spared:?} {last_alike:?}"
    );
    assert!(last_spared.raised_tolerance && !last_alike.raised_tolerance);
    assert_eq!(others_alike, others_spared);
}
