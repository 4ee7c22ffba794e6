//! Tests that the device and the host credit the same bits for the same lines. `tests/gpu_rounds.rs` tests
//! whole rounds.

use std::collections::BTreeMap;

use glam::Vec3;
use sightline_scene::generate::{self, SceneKind, SceneParams};
use sightline_scene::{Scene, Side, Sides};

use super::*;
use crate::cube::{CubeSpec, SKY, Strata};
use crate::gpu::{AdapterChoice, GpuBackend};
use crate::lines::bits::SeenBits;
use crate::lines::device::{DeviceCell, DevicePairs};
use crate::lines::device::{Rounds as _, UniformWork};
use crate::lines::grid::{CellGrid, Crossed};
use crate::lines::pairs::Pairs;
use crate::packet::{Halves, LANES, Packet};
use crate::surface::Surface;
use crate::tracer::{LineSet, Tracer};

fn backend(scene: &Arc<Scene>) -> Option<GpuBackend> {
    let spec = CubeSpec {
        resolution: 16,
        strata: Strata::One,
        keep_pixels: false,
    };
    match GpuBackend::new(scene.clone(), spec, AdapterChoice::AllowSoftware) {
        Ok(backend) => Some(backend),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            println!("not run: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

const KERNELS: [Kernel; 4] = [
    Kernel::MakeUniform,
    Kernel::TraceRays,
    Kernel::CreditLines,
    Kernel::JoinLines,
];

fn town() -> Scene {
    let params = SceneParams {
        triangles: Some(3000),
        ..SceneParams::default()
    };
    generate::generate(SceneKind::Rooms, &params).unwrap()
}

/// Returns the cells that see the triangles at both ends of a line, as in `Block::credit_line`.
fn credited(
    grid: &CellGrid,
    ahead: &Packet,
    behind: &Packet,
    step: f32,
    far: f32,
    one_way: bool,
    mut credit: impl FnMut(u32, &Crossed),
) {
    let mut crossed = Crossed::new();
    for lane in 0..ahead.count {
        let (origin, direction) = ahead.ray(lane);
        let limit = far / ahead.length(lane);
        let end = |half: &Packet| match half.triangle[lane] {
            t if t != SKY && half.distance[lane] <= limit => (t, half.distance[lane]),
            _ => (SKY, limit),
        };
        let [(a, to), (b, back)] = [ahead, behind].map(end);
        let from = ahead.advance(lane, step) - back;
        let is_split = one_way || far < f32::INFINITY;
        for (triangle, at, is_ahead) in [(a, to, true), (b, from, false)] {
            if triangle == SKY {
                continue;
            }
            let (mut least, mut most) = match (one_way, is_ahead) {
                (false, _) => (from, to),
                (true, true) => (from.max(0.0), to),
                (true, false) => (from, to.min(0.0)),
            };
            if is_split {
                (least, most) = (least.max(at - limit), most.min(at + limit));
            }
            grid.walk(origin, direction, least, most, &mut crossed);
            credit(triangle, &crossed);
        }
    }
}

fn compare(scene: Scene, far: f32) {
    let scene = Arc::new(scene);
    let Some(backend) = backend(&scene) else {
        return;
    };
    let all: Vec<u32> = (0..scene.len())
        .filter(|t| !scene.triangles()[*t as usize].is_degenerate())
        .collect();
    let surface = Surface::new(&scene, &all);
    let tracer = backend.lines(LineSet::Blocking, &all).unwrap();
    let kit = backend.lines[LineSet::Blocking as usize]
        .get()
        .unwrap()
        .as_ref()
        .unwrap();
    let bounds = scene.bounds();
    let grid = CellGrid::new(bounds.min, bounds.max, [7, 5, 3]);
    let cells: Vec<DeviceCell> = grid
        .each()
        .zip(0..)
        .map(|(at, key)| {
            let (low, size) = grid.cell_box(at);
            DeviceCell {
                low,
                size,
                at,
                slot: grid.slot(at),
                parts: u64::MAX,
                key,
            }
        })
        .collect();
    let step = (bounds.max - bounds.min).max_element() / (1 << 24) as f32;
    let one_way = !scene.sides().are_both();
    let block = DeviceBlock {
        scene: &scene,
        surface: &surface,
        rows: &[],
        row_count: scene.triangles().len(),
        grid: &grid,
        cells: &cells,
        reached: &[],
        step,
        far,
        one_way,
        key: 1,
        pairs: None,
    };
    // Other cells than the block's, over which every line joins.
    let division = CellGrid::new(bounds.min, bounds.max, [5, 6, 4]);
    let division_cells: Vec<DeviceCell> = division
        .each()
        .zip(0..)
        .map(|(at, key)| {
            let (low, size) = division.cell_box(at);
            DeviceCell {
                low,
                size,
                at,
                slot: division.slot(at),
                parts: u64::MAX,
                key,
            }
        })
        .collect();
    let slots = vec![0; cells.len()];
    let device_pairs = DevicePairs {
        grid: &division,
        cells: &division_cells,
        reached: &[],
        slots: &slots,
        joins: [1; 2],
    };
    let block = DeviceBlock {
        pairs: Some(device_pairs),
        ..block
    };
    let (line_scene, rounds_kit) = kit.for_rounds();
    let rounds = GpuRounds::new(&backend.gpu, line_scene, rounds_kit, &block)
        .unwrap()
        .unwrap();
    let bits = SeenBits::new(scene.triangles().len(), grid.words());
    rounds.restart(&bits, None).unwrap();
    // One part of uniform lines, without a flood, so that the lists still contain it.
    let tiles = 2;
    let items: Vec<[u32; 4]> = (0..cells.len() as u32)
        .map(|c| [c, tiles, 0, c * 3 * tiles * tiles])
        .collect();
    let count = items.len() as u32 * 3 * tiles * tiles * LANES as u32;
    assert!(count <= rounds.capacity / 2);
    let (block_lists, mut encoder) = rounds.begin(&items).unwrap();
    let offset = rounds.part(
        block_lists,
        &Part {
            count,
            items: items.len() as u32,
            joins: 1,
            ..Part::default()
        },
    );
    rounds.run(&mut encoder, block_lists, offset, &KERNELS);
    let bytes = 16 * u64::from(count);
    let floats = |numbers: Vec<u32>| -> Vec<[f32; 3]> {
        numbers
            .chunks_exact(4)
            .map(|v| [0, 1, 2].map(|a: usize| f32::from_bits(v[a])))
            .collect()
    };
    let origins = floats(
        rounds
            .read(encoder, block_lists, &[(&block_lists.from, 0, bytes)])
            .unwrap(),
    );
    let directions = floats(
        rounds
            .read(
                rounds.encoder(),
                block_lists,
                &[(&block_lists.to, 0, bytes)],
            )
            .unwrap(),
    );
    let found = rounds
        .end(block_lists, rounds.encoder(), items.len())
        .unwrap();
    let mut by_device = vec![0u64; bits.places()];
    found
        .words
        .iter()
        .for_each(|(at, word)| by_device[*at as usize] |= word);

    let joined: BTreeMap<u32, u64> = found.pair_words.iter().copied().collect();

    let mut by_host = vec![0u64; bits.places()];
    let pairs = Pairs::new(division.clone());
    for (origins, directions) in origins.chunks(LANES).zip(directions.chunks(LANES)) {
        let mut ahead = Packet::default();
        origins
            .iter()
            .zip(directions)
            .for_each(|(o, d)| ahead.push(*o, *d));
        let mut both = [ahead.clone(), ahead.reversed(step)];
        tracer.trace(&mut both, Halves::Rays, true).unwrap();
        let [ahead, behind] = &both;
        credited(
            &grid,
            ahead,
            behind,
            step,
            far,
            one_way,
            |triangle, crossed| {
                for (word, bits) in crossed {
                    by_host[triangle as usize * grid.words() + *word as usize] |= bits;
                }
            },
        );
        for lane in 0..ahead.count {
            let limit = far / ahead.length(lane);
            let end = |half: &Packet| half.distance[lane].min(limit);
            let (from, to) = (ahead.advance(lane, step) - end(behind), end(ahead));
            let halves = [
                (from.max(-limit), to.min(0.0)),
                (from.max(0.0), to.min(limit)),
            ];
            let whole = [(from, to)];
            let parts: &[_] = if one_way || far < f32::INFINITY {
                &halves
            } else {
                &whole
            };
            parts
                .iter()
                .for_each(|(a, b)| pairs.join_line(ahead.ray(lane), *a, *b, &mut Crossed::new()));
        }
    }
    let expected = pairs.copy();
    let has = |(at, word): (usize, &u64)| joined.get(&(at as u32)).copied().unwrap_or(0) == *word;
    assert!(expected.iter().map(|w| w.count_ones()).sum::<u32>() > 1000);
    assert!(expected.iter().enumerate().all(has), "pairs differ");
    let lit = by_host.iter().map(|w| w.count_ones()).sum::<u32>();
    assert!(lit > 1000, "{lit} bits test something");
    let differ: u32 = by_device
        .iter()
        .zip(&by_host)
        .map(|(d, h)| (d ^ h).count_ones())
        .sum();
    assert_eq!(differ, 0, "of {lit} bits");
}

#[test]
fn device_credits_like_host() {
    compare(town(), f32::INFINITY);
}

#[test]
fn lines_that_end_at_distance_are_credited_like_on_host() {
    let scene = town();
    let far = (scene.bounds().max - scene.bounds().min).length() * 0.1;
    compare(scene, far);
}

#[test]
fn one_sided_triangles_are_credited_like_on_host() {
    let scene = town();
    let sides = Sides::from_runs([(scene.len(), Side::CounterClockwise)]);
    compare(scene.with_sides("town", sides).unwrap(), f32::INFINITY);
}

#[test]
fn lost_device_is_error() {
    let scene = Arc::new(town());
    let Some(backend) = backend(&scene) else {
        return;
    };
    let all: Vec<u32> = (0..scene.len()).collect();
    let surface = Surface::new(&scene, &all);
    let tracer = backend.lines(LineSet::Blocking, &all).unwrap();
    let grid = CellGrid::new(Vec3::ZERO, Vec3::ONE, [1; 3]);
    let (low, size) = grid.cell_box([0; 3]);
    let cells = [DeviceCell {
        low,
        size,
        at: [0; 3],
        slot: grid.slot([0; 3]),
        parts: u64::MAX,
        key: 1,
    }];
    let block = DeviceBlock {
        scene: &scene,
        surface: &surface,
        rows: &[],
        row_count: scene.triangles().len(),
        grid: &grid,
        cells: &cells,
        reached: &[],
        step: 1e-6,
        far: f32::INFINITY,
        one_way: false,
        key: 1,
        pairs: None,
    };
    let rounds = tracer.rounds(&block).unwrap().unwrap();
    let work = [UniformWork {
        cell: 0,
        tiles: 2,
        base: 0,
    }];
    rounds
        .restart(&SeenBits::new(scene.triangles().len(), 1), None)
        .unwrap();
    rounds.uniform(&work, &|_| true).unwrap();
    backend.gpu.device.destroy();
    assert!(matches!(
        rounds.uniform(&work, &|_| true),
        Err(TracerError::Failed { .. })
    ));
    assert!(matches!(
        rounds.seeds(&|_| true),
        Err(TracerError::Failed { .. })
    ));
}

/// Checks that an error in a compiling thread is not an error of the device. The host then casts the rounds.
#[test]
fn rejected_kernels_leave_device_usable() {
    let scene = Arc::new(town());
    let Some(backend) = backend(&scene) else {
        return;
    };
    let all: Vec<u32> = (0..scene.len()).collect();
    let tracer = backend.lines(LineSet::Blocking, &all).unwrap();
    let kit = backend.lines[LineSet::Blocking as usize]
        .get()
        .unwrap()
        .as_ref()
        .unwrap();
    let (line_scene, _) = kit.for_rounds();
    let refused = Kernels::with(
        &backend.gpu.device,
        line_scene,
        &[("NO_SUCH_CONSTANT", 1.0)],
    );
    assert!(matches!(refused, Err(DeviceFault::Refused(_))));
    backend.gpu.check().unwrap();
    let mut packet = Packet::default();
    packet.push([0.0; 3], [1.0, 0.5, 0.25]);
    tracer.trace(&mut [packet], Halves::Rays, true).unwrap();
}
