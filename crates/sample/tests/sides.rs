//! Tests of triangles with one side: every tracer and sampler meets them only from their front.
//!
//! Without a Vulkan adapter the tests print one line and use only the cpu backend; under `CI` they fail.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use sightline_model::numbers::{MaxError, Resolution};
use sightline_model::{
    CellSets, Crediting, CubeParams, Granularity, Pack, Stop, TileOutput, codec,
};
use sightline_sample::crew::SoleMember;
use sightline_sample::{JobContext, LineSampler, TileSampler, Unwatched, tile};
use sightline_scene::overlap::triangle_touches_box;
use sightline_scene::{Aabb, Kinds, Object, Scene, Side, Sides, SurfaceKind, Triangle, TriangleId};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::packet::{Halves, LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeSpec, LineSet, PreparedScene, SKY, Strata, Tracer, TracerError, layers};
use sightline_viewcells::{Division, Layout, Plan};

/// Returns the backends of this machine. Under `CI`, a missing adapter is a failure.
fn backends(scene: &Arc<Scene>, spec: CubeSpec) -> Vec<Box<dyn Tracer>> {
    let mut backends: Vec<Box<dyn Tracer>> =
        vec![Box::new(CpuBackend::new(Arc::clone(scene), spec).unwrap())];
    match GpuBackend::new(Arc::clone(scene), spec, AdapterChoice::AllowSoftware) {
        Ok(gpu) => backends.push(Box::new(gpu)),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run on a GPU: {why}");
        }
        Err(e) => panic!("{e}"),
    }
    backends
}

fn spec(resolution: u32) -> CubeSpec {
    CubeSpec {
        resolution,
        strata: Strata::One,
        keep_pixels: false,
    }
}

/// Creates a scene of triangles with their sides and kinds.
fn scene(parts: &[([Vec3; 3], Side, SurfaceKind)]) -> Arc<Scene> {
    let triangles: Vec<Triangle> = parts.iter().map(|(v, ..)| Triangle { v: *v }).collect();
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    }];
    let sides = Sides::from_runs(parts.iter().map(|(_, side, _)| (1, *side)));
    let kinds = Kinds::from_runs(
        parts.iter().map(|(.., kind)| (1, *kind, "test")),
        Vec::new(),
    );
    let scene = Scene::new("test", triangles, objects).unwrap();
    Arc::new(
        scene
            .with_sides("test", sides)
            .unwrap()
            .with_kinds("test", kinds)
            .unwrap(),
    )
}

/// Returns the square 0…4 of the plane z = `z`, cut along one diagonal or the other. Its two triangles run
/// counter-clockwise as seen from above.
fn square(z: f32, other_diagonal: bool) -> [[Vec3; 3]; 2] {
    let [a, b, c, d] = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
        .map(|(x, y): (f32, f32)| Vec3::new(x, y, z));
    if other_diagonal {
        [[b, c, d], [b, d, a]]
    } else {
        [[a, b, c], [a, c, d]]
    }
}

/// The height of a wall that divides the third of four storeys of cells. No corner of a cell is in its plane.
const WALL: f32 = 2.47;

/// Creates a floor at z = 0, a ceiling at 4, both with two sides, and the layers of a wall in between.
fn storeys(wall: &[([[Vec3; 3]; 2], Side, SurfaceKind)]) -> Arc<Scene> {
    let outer =
        [square(0.0, false), square(4.0, false)].map(|s| (s, Side::Both, SurfaceKind::Opaque));
    let squares = outer.iter().chain(wall);
    let parts: Vec<_> = squares
        .flat_map(|(s, side, kind)| s.map(|v| (v, *side, *kind)))
        .collect();
    scene(&parts)
}

fn reversed(square: [[Vec3; 3]; 2]) -> [[Vec3; 3]; 2] {
    square.map(|[a, b, c]| [a, c, b])
}

/// Returns the outputs of all tiles of a bake.
fn bake(
    scene: &Arc<Scene>,
    backend: &dyn Tracer,
    cells: [u32; 3],
    sampler: TileSampler,
) -> Vec<CellSets> {
    let division = Division::Grid(cells);
    let lattice = division
        .lattice(scene.bounds().min, scene.bounds().max)
        .unwrap();
    let prepared = PreparedScene::new(Arc::clone(scene)).unwrap();
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
        pairs: Some(cells),
        backend,
        seed: 0,
        deadline: None,
        crew: &SoleMember,
    };
    let mut outputs: Vec<Vec<u8>> = Vec::new();
    let mut sets = Vec::new();
    for tile in &plan.tiles {
        let packs: Vec<Pack> = tile
            .needs
            .iter()
            .map(|n| codec::decode_pack(&outputs[*n as usize], scene.len(), &tile.cell).unwrap())
            .collect();
        let (output, _) = tile::run(&job, tile, &packs, &Unwatched).unwrap();
        outputs.push(codec::encode(&output).unwrap());
        if let TileOutput::Cells(cells) = output {
            sets.push(cells);
        }
    }
    sets
}

/// Returns the samplers, the last one with a bound.
fn samplers() -> Vec<TileSampler> {
    let lines = |stop| LineSampler::Shared { error: 1e-4, stop };
    let bound = Stop::Bound(MaxError::new(0.01).unwrap());
    let cubes = CubeParams {
        resolution: Resolution::new(32).unwrap(),
        ..CubeParams::default()
    };
    vec![
        TileSampler::Lines(lines(Stop::Expected)),
        TileSampler::Lines(LineSampler::Guided {
            rays: 20_000,
            credit: Crediting::All,
        }),
        TileSampler::Cubes(cubes),
        TileSampler::Lines(lines(bound)),
    ]
}

/// Checks that every sampler and backend computes the expected sets of four storeys of cells, from below.
/// `pair` is true if the lowest and the highest cell see each other.
#[track_caller]
fn assert_storeys(scene: &Arc<Scene>, expected: [&[u32]; 4], pair: bool) {
    for backend in backends(scene, spec(32)) {
        for sampler in samplers() {
            let what = format!("{} {sampler:?}", backend.profile());
            let tiles = bake(scene, &*backend, [1, 1, 4], sampler);
            let sets: Vec<&Vec<u32>> = tiles
                .iter()
                .flat_map(|t| t.cells.iter().map(|c| &c.visible))
                .collect();
            assert_eq!(sets, expected, "{what}");
            let joined = tiles
                .iter()
                .any(|t| t.pairs.as_ref().is_some_and(|p| p.seen.has(0, 3)));
            assert_eq!(joined, pair, "{what}");
        }
    }
}

#[test]
fn wall_with_one_side_is_seen_and_blocks_only_from_front() {
    use SurfaceKind::Opaque;
    // The floor is 0 and 1, the ceiling 2 and 3. The third cell meets the wall.
    let all: &[u32] = &[0, 1, 2, 3, 4, 5];
    let wall = storeys(&[(square(WALL, false), Side::CounterClockwise, Opaque)]);
    assert_storeys(
        &wall,
        [&[0, 1, 2, 3], &[0, 1, 2, 3], all, &[2, 3, 4, 5]],
        true,
    );
    let mirrored = storeys(&[(square(WALL, false), Side::Clockwise, Opaque)]);
    assert_storeys(
        &mirrored,
        [&[0, 1, 4, 5], &[0, 1, 4, 5], all, &[0, 1, 2, 3]],
        true,
    );
    let both = storeys(&[(square(WALL, false), Side::Both, Opaque)]);
    assert_storeys(
        &both,
        [&[0, 1, 4, 5], &[0, 1, 4, 5], all, &[2, 3, 4, 5]],
        false,
    );
}

#[test]
fn wall_of_two_coincident_faces_is_closed() {
    let up = (
        square(WALL, false),
        Side::CounterClockwise,
        SurfaceKind::Opaque,
    );
    // The same vertices in reversed order, also cut along the other diagonal.
    for other_diagonal in [false, true] {
        let down = (
            reversed(square(WALL, other_diagonal)),
            Side::CounterClockwise,
            SurfaceKind::Opaque,
        );
        let below: &[u32] = &[0, 1, 6, 7];
        let expected = [below, below, &[0, 1, 2, 3, 4, 5, 6, 7], &[2, 3, 4, 5]];
        assert_storeys(&storeys(&[up, down]), expected, false);
    }
}

#[test]
fn pane_with_one_side_is_seen_only_from_front_and_never_blocks() {
    let pane = storeys(&[(
        square(WALL, false),
        Side::CounterClockwise,
        SurfaceKind::SeeThrough,
    )]);
    let all: &[u32] = &[0, 1, 2, 3, 4, 5];
    assert_storeys(&pane, [&[0, 1, 2, 3], &[0, 1, 2, 3], all, all], true);
}

#[test]
fn item_buffer_has_no_back_faces() {
    let wall = storeys(&[(
        square(WALL, false),
        Side::CounterClockwise,
        SurfaceKind::Opaque,
    )]);
    for backend in backends(&wall, spec(16)) {
        let prepared = PreparedScene::new(Arc::clone(&wall)).unwrap();
        let renderer = layers::renderer(&*backend, &prepared, spec(16), None, None).unwrap();
        let ids = |z: f32| -> BTreeSet<u32> {
            let image = renderer.image(Vec3::new(1.7, 2.1, z)).unwrap();
            image.ids.into_iter().filter(|id| *id != SKY).collect()
        };
        assert_eq!(
            ids(1.0),
            BTreeSet::from([0, 1, 2, 3]),
            "{}",
            backend.profile()
        );
        assert_eq!(
            ids(3.0),
            BTreeSet::from([2, 3, 4, 5]),
            "{}",
            backend.profile()
        );
    }
}

/// Returns random triangles in the box −1…1, a third of them with each side.
fn random_scene(seed: u64, count: usize, size: f32) -> Arc<Scene> {
    let mut random = Hashed::new(&[seed]);
    let mut point = || random.point() * 2.0 - 1.0;
    let parts: Vec<_> = (0..count)
        .map(|i| {
            let at = point();
            let v = [0, 1, 2].map(|_| (at + point() * size).clamp(Vec3::NEG_ONE, Vec3::ONE));
            (v, Side::ALL[i % 3], SurfaceKind::Opaque)
        })
        .collect();
    scene(&parts)
}

/// Returns the nearest triangle that faces a ray, and its distance (Möller and Trumbore 1997).
///
/// The flag is true if rounding may decide otherwise: another triangle is about as near, or a border or an
/// edge-on triangle is close.
fn brute_force(scene: &Scene, o: DVec3, d: DVec3) -> (u32, f64, bool) {
    let (mut nearest, mut unclear) = ((SKY, f64::INFINITY), false);
    let mut distances = Vec::new();
    for (id, t) in (0..).zip(scene.triangles()) {
        let [a, b, c] = t.v.map(|v| v.as_dvec3());
        let (e, f) = (b - a, c - a);
        let p = d.cross(f);
        let inverse = 1.0 / e.dot(p);
        let s = o - a;
        let u = s.dot(p) * inverse;
        let q = s.cross(e);
        let v = d.dot(q) * inverse;
        let at = f.dot(q) * inverse;
        let least = u.min(v).min(1.0 - u - v);
        let steep = (e.cross(f).normalize().dot(d.normalize())).abs() > 1e-3;
        if at < 1e-6 || least < -1e-4 {
            continue;
        }
        // The front, from its definition.
        let towards = e.cross(f).dot(d);
        let met = match scene.sides().side(TriangleId(id)) {
            Side::Both => true,
            Side::CounterClockwise => towards < 0.0,
            Side::Clockwise => towards > 0.0,
        };
        unclear |= least < 1e-4 || !steep;
        if met {
            distances.push(at);
            if at < nearest.1 {
                nearest = (id, at);
            }
        }
    }
    unclear |= distances
        .iter()
        .filter(|at| **at < nearest.1 + 1e-4)
        .count()
        > 1;
    (nearest.0, nearest.1, unclear)
}

#[test]
fn tracers_meet_nearest_triangle_that_faces_ray() {
    let scene = random_scene(1, 300, 0.5);
    let ids: Vec<u32> = (0..scene.len()).collect();
    let mut random = Hashed::new(&[2]);
    // Packets of one origin, as the samplers use them, and packets of any rays.
    let mut packets: Vec<Packet> = Vec::new();
    for k in 0..400 {
        let mut packet = Packet::default();
        let (origin, way) = (random.point() * 2.0 - 1.0, random.point() * 2.0 - 1.0);
        for _ in 0..LANES {
            let own = random.point() * 2.0 - 1.0;
            let (o, d) = if k % 2 == 0 {
                (origin, way + own * 0.1)
            } else {
                (own, random.point() - 0.5)
            };
            packet.push(o.to_array(), d.to_array());
        }
        packets.push(packet);
    }
    for backend in backends(&scene, spec(16)) {
        let tracer = backend.lines(LineSet::Blocking, &ids).unwrap();
        let mut each = packets.clone();
        tracer.trace(&mut each, Halves::Rays, false).unwrap();
        let mut traced = packets.clone();
        tracer.trace(&mut traced, Halves::Rays, true).unwrap();
        let (mut clear, mut culled) = (0, 0);
        for (packet, each) in traced.iter().zip(&each) {
            for lane in 0..LANES {
                let (o, d) = packet.ray(lane);
                let (o, d) = (Vec3::from(o).as_dvec3(), Vec3::from(d).as_dvec3());
                let (id, at, unclear) = brute_force(&scene, o, d);
                if unclear {
                    continue;
                }
                clear += 1;
                assert_eq!(
                    [packet.triangle[lane], each.triangle[lane]],
                    [id; 2],
                    "{}",
                    backend.profile()
                );
                if id != SKY {
                    assert!((f64::from(packet.distance[lane]) - at).abs() < 1e-4 * at.max(1.0));
                }
                // Among triangles without sides, another triangle would be the nearest.
                let both = scene_of_both_sides(&scene);
                culled += usize::from(brute_force(&both, o, d).0 != id);
            }
        }
        assert!(clear > 4000 && culled > 500, "{clear} {culled}");
    }
}

fn scene_of_both_sides(scene: &Scene) -> Scene {
    scene.clone().with_sides("test", Sides::both()).unwrap()
}

#[test]
fn sets_contain_hits_of_random_rays_and_no_back_faces() {
    let scene = random_scene(3, 60, 0.9);
    let bounds = scene.bounds();
    let cells = [3u32, 3, 3];
    let size = (bounds.max - bounds.min) / 3.0;
    for backend in backends(&scene, spec(32)) {
        let (error, stop) = (1e-4, Stop::Expected);
        let sampler = TileSampler::Lines(LineSampler::Shared { error, stop });
        let tiles = bake(&scene, &*backend, cells, sampler);
        let pairs = tiles[0].pairs.as_ref().unwrap();
        // One tile, with the boxes of its cells in the order of its tree.
        let division = Division::Grid(cells);
        let lattice = division.lattice(bounds.min, bounds.max).unwrap();
        let plan = Plan::new(&division, &lattice, Layout::Blocks(512));
        let tile = plan.tiles.iter().find(|t| t.needs.is_empty()).unwrap();
        let mut waiting = vec![(tile.cell, tile.depth)];
        let mut boxes = Vec::new();
        while let Some((cell, depth)) = waiting.pop() {
            match division.split(&lattice, &cell, depth) {
                Some(split) => {
                    let [below, above] = cell.children(split);
                    waiting.extend([(above, depth + 1), (below, depth + 1)]);
                }
                None => boxes.push(cell.world(&lattice)),
            }
        }
        let sets: Vec<&Vec<u32>> = tiles[0].cells.iter().map(|c| &c.visible).collect();
        assert_eq!(sets.len(), boxes.len());
        let mut random = Hashed::new(&[4]);
        let (mut rays, mut missed, mut unjoined, mut outside) = (0, 0, 0, 0);
        let mut witnessed = 0;
        for (set, (lo, hi)) in sets.iter().zip(&boxes) {
            let index = |p: Vec3| {
                let at = ((p - bounds.min) / size)
                    .as_uvec3()
                    .min(glam::UVec3::splat(2));
                (at.z * 3 + at.y) * 3 + at.x
            };
            let here = index((*lo + *hi) * 0.5);
            for _ in 0..2000 {
                let o = *lo + (*hi - *lo) * random.point();
                let d = random.point() * 2.0 - 1.0;
                let (id, at, unclear) = brute_force(&scene, o.as_dvec3(), d.as_dvec3());
                if unclear || id == SKY {
                    continue;
                }
                rays += 1;
                missed += usize::from(set.binary_search(&id).is_err());
                // The segment to the hit is free, so this cell and all cells on it see each other.
                let there = o + d * (at as f32 * random.unit());
                unjoined += usize::from(!pairs.seen.has(here, index(there)));
            }
            for &id in set.iter() {
                let t = &scene.triangles()[id as usize];
                if triangle_touches_box(t, &Aabb { min: *lo, max: *hi }) {
                    continue;
                }
                // A triangle of one side has a corner of the cell in front of it. Most such triangles have a
                // witness among a few hundred rays aimed at them.
                let front = scene.front(TriangleId(id));
                let corner = |k: u32| {
                    let pick = |a: usize| if k >> a & 1 == 1 { hi[a] } else { lo[a] };
                    Vec3::new(pick(0), pick(1), pick(2))
                };
                let before = |k: u32| front.dot((corner(k) - t.v[0]).as_dvec3()) > -1e-9;
                assert!(
                    front == DVec3::ZERO || (0..8).any(before),
                    "{id} faces away"
                );
                outside += 1;
                witnessed += usize::from((0..800).any(|_| {
                    let o = (*lo + (*hi - *lo) * random.point()).as_dvec3();
                    let [u, v] = [random.unit(), random.unit()];
                    let (u, v) = if u + v > 1.0 {
                        (1.0 - u, 1.0 - v)
                    } else {
                        (u, v)
                    };
                    let p = t.v[0] + (t.v[1] - t.v[0]) * u + (t.v[2] - t.v[0]) * v;
                    brute_force(&scene, o, p.as_dvec3() - o).0 == id
                }));
            }
        }
        assert!(rays > 10_000 && outside > 100, "{rays} {outside}");
        assert!(
            missed * 500 < rays,
            "{missed} of {rays} rays meet a triangle that is not in the set"
        );
        assert!(
            unjoined * 500 < rays,
            "{unjoined} of {rays} free ways join no pair"
        );
        assert!(
            witnessed * 100 > outside * 95,
            "{witnessed} of {outside} have a witness"
        );
    }
}
