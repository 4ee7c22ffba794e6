//! Compares whole rounds of sight lines on the device with rounds on the CPU: time, rays, error and bytes
//! over the bus.
//!
//! ```sh
//! cargo run --release -p sightline-sample --example rounds -- SCENE 8x8x8 0.003 0.0003
//! ```
//!
//! The example samples the cells as one tile with the default sampler and all triangles opaque, first with
//! the cpu backend on all threads, then on the best adapter. It prints a table in Markdown. Seconds are only
//! for the rounds: scene, hierarchy and kernels are ready before. The error is the fraction of 2000 held-out
//! lines from each cell that meet a triangle that the cell lacks, traced by the same backend. The last column
//! has the number of times that the host waited for the device, and the seconds of waiting.
//!
//! A number of at least 1 is not a target error, but the rays per cell of the sampler guided.
//!
//! `--adapter NAME` selects another adapter; `--no-cpu` and `--no-gpu` skip one of the two, and `--embree`
//! adds Embree. `--complete` completes the sets with likely triangles: these are not missed, and the column
//! after the error has their number as a fraction of the seen triangles. `--profile` adds the time of each
//! kernel, which lengthens the rounds. `--pace` sets the four numbers of [`LinePacing`].

#![allow(clippy::print_stdout, reason = "this program's output is its purpose")]

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use sightline_sample::Unwatched;
use sightline_sample::crew::SoleMember;
use sightline_sample::lines::block::{Block, BlockInputs};
use sightline_sample::lines::rounds::{LinePacing, Tolerance};
use sightline_scene::Scene;
use sightline_trace::cpu::CpuBackend;
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::embree::EmbreeBackend;
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer, least_step};
use sightline_trace::surface::Surface;
use sightline_trace::{CubeSpec, LineSet, Strata, Tracer};

/// The number of held-out lines per cell.
const HELD: usize = 2000;
/// The name of the stream of random numbers for held-out lines.
const STREAM: u64 = 77;

const USAGE: &str = "usage: rounds [--adapter NAME] [--no-cpu] [--no-gpu] [--embree] [--complete] \
                     [--profile] [--pace FIRST,COARSE,GROWTH,AIMED] SCENE NXxNYxNZ TARGET...";

type Answer<T> = Result<T, Box<dyn std::error::Error>>;

/// Parses the four numbers of a [`LinePacing`]: first, first_coarse, growth, aimed.
fn paced(text: &str) -> Answer<LinePacing> {
    let numbers: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let [first, coarse, growth, aimed] = numbers[..] else {
        return Err("--pace needs four numbers".into());
    };
    Ok(LinePacing {
        first: first as u32,
        first_coarse: coarse as u32,
        growth,
        aimed: aimed as u64,
    })
}

fn main() -> Answer<()> {
    let mut choice = AdapterChoice::AllowSoftware;
    let (mut with_cpu, mut with_gpu, mut with_embree) = (true, true, false);
    let (mut profile, mut pace, mut rest) = (false, None, Vec::new());
    let mut completes = false;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--adapter" => {
                choice = AdapterChoice::Named(arguments.next().ok_or("--adapter needs a name")?)
            }
            "--no-cpu" => with_cpu = false,
            "--no-gpu" => with_gpu = false,
            "--embree" => with_embree = true,
            "--complete" => completes = true,
            "--profile" => profile = true,
            "--pace" => {
                pace = Some(paced(
                    &arguments.next().ok_or("--pace needs four numbers")?,
                )?)
            }
            _ => rest.push(argument),
        }
    }
    let [scene, cells, targets @ ..] = rest.as_slice() else {
        return Err(USAGE.into());
    };
    let scene = Arc::new(sightline_scene::load(scene.as_ref())?);
    let cells: Vec<u32> = cells.split('x').map(str::parse).collect::<Result<_, _>>()?;
    let cells: [u32; 3] = cells.try_into().map_err(|_| {
        "give the numbers of cells along x, y and z, such \
     as 8x8x8"
    })?;
    let spec = CubeSpec {
        resolution: 8,
        strata: Strata::One,
        keep_pixels: false,
    };
    let all: Vec<u32> = (0..scene.len())
        .filter(|id| !scene.triangles()[*id as usize].is_degenerate())
        .collect();
    let surface = Surface::new(&scene, &all);
    println!(
        "{} triangles, {} cells\n",
        scene.len(),
        cells.iter().product::<u32>()
    );
    println!(
        "| backend | target | seconds | million rays | a second | of these uniform, flood, aimed | error | \
         likely | bytes per ray up, down | waits |"
    );
    println!("|---|--:|--:|--:|--:|---|--:|--:|---|--:|");
    let mut backends: Vec<Box<dyn Tracer>> = Vec::new();
    if with_cpu {
        backends.push(Box::new(CpuBackend::new(Arc::clone(&scene), spec)?));
    }
    if with_embree {
        backends.push(Box::new(EmbreeBackend::new(Arc::clone(&scene), spec)?));
    }
    if with_gpu {
        let start = Instant::now();
        let gpu = GpuBackend::new(Arc::clone(&scene), spec, choice)?;
        println!(
            "<!-- the adapter is open after {:.3} s -->",
            start.elapsed().as_secs_f64()
        );
        backends.push(Box::new(if profile { gpu.measuring() } else { gpu }));
    }
    for backend in &backends {
        let start = Instant::now();
        let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all)?);
        let built = start.elapsed().as_secs_f64();
        // The first run is not timed, because a device compiles and allocates at its first use.
        sample(&scene, &surface, &sight, [2; 3], 0.1, None, false)?;
        println!(
            "| {} | | {built:.3} hierarchy, {:.3} to be ready | | | | | | |",
            backend.profile(),
            start.elapsed().as_secs_f64()
        );
        for target in targets {
            line(
                &scene,
                &surface,
                &**backend,
                &sight,
                cells,
                target.parse()?,
                pace,
                completes,
            )?;
        }
    }
    Ok(())
}

/// Computes one block and returns its results: seconds, rays by kind, error, and traffic over the bus.
fn sample(
    scene: &Scene,
    surface: &Surface,
    sight: &SightLineTracer<'_>,
    cells: [u32; 3],
    target: f64,
    pace: Option<LinePacing>,
    completes: bool,
) -> Answer<(f64, [u64; 4], [f64; 2], String)> {
    let rows = Rows::triangles(scene);
    let bounds = scene.bounds();
    let [nx, ny, _] = cells.map(u64::from);
    let number = |c: [u32; 3]| (u64::from(c[2]) * ny + u64::from(c[1])) * nx + u64::from(c[0]);
    let inputs = BlockInputs {
        scene,
        surface,
        rows: &rows,
        sight,
        seed: 1,
        watcher: &Unwatched,
        deadline: None,
        pairs: None,
        region: None,
        crew: &SoleMember,
        observer: None,
    };
    let start = Instant::now();
    let mut block = Block::new(
        inputs,
        CellGrid::new(bounds.min, bounds.max, cells),
        number,
        |_| u64::MAX,
    );
    if let Some(pace) = pace {
        block.ask_for_device()?;
        block.set_pace(pace);
    }
    if completes {
        block.enable_completion(&[]);
    }
    if target < 1.0 {
        block.sample(target, &[], Tolerance::Raised)?;
    } else {
        block.sample_guided_shared(target as u64)?;
    }
    block.complete_all();
    let seconds = start.elapsed().as_secs_f64();
    let mut rays = [0; 4];
    block.stats().iter().for_each(|s| {
        rays.iter_mut()
            .zip(s.rays)
            .for_each(|(all, own)| *all += own)
    });
    let mut times = block.kernel_times();
    times.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    for t in times {
        println!(
            "<!-- {:<17} {:>8.1} ms in {} runs -->",
            t.name,
            1e3 * t.seconds,
            t.runs
        );
    }
    let bus = block.traffic().map_or("host | |".to_owned(), |t| {
        let a_ray = |bytes: u64| bytes as f64 / t.rays as f64;
        format!(
            "{:.3}, {:.3} | {}, {:.3} s |",
            a_ray(t.up),
            a_ray(t.down),
            t.waits,
            t.seconds
        )
    });
    Ok((seconds, rays, error(&block, scene, sight)?, bus))
}

fn line(
    scene: &Scene,
    surface: &Surface,
    backend: &dyn Tracer,
    sight: &SightLineTracer<'_>,
    cells: [u32; 3],
    target: f64,
    pace: Option<LinePacing>,
    completes: bool,
) -> Answer<()> {
    let (seconds, rays, [error, growth], bus) =
        sample(scene, surface, sight, cells, target, pace, completes)?;
    let kind = backend.profile().split('/').next().unwrap_or_default();
    let all = rays.iter().sum::<u64>() as f64 / 1e6;
    let [uniform, flood, aimed, _] = rays.map(|r| 100.0 * r as f64 / 1e6 / all);
    println!(
        "| {kind} | {target} | {seconds:.3} | {all:.1} | {:.0} | {uniform:.0} %, {flood:.0} %, \
         {aimed:.0} % | {:.4} % | {:.1} % | {bus}",
        all / seconds,
        100.0 * error,
        100.0 * growth
    );
    Ok(())
}

/// Returns the fraction of held-out lines that meet a triangle that their cell lacks, and the number of
/// likely triangles as a fraction of the seen triangles.
fn error(block: &Block<'_>, scene: &Scene, sight: &SightLineTracer<'_>) -> Answer<[f64; 2]> {
    let likely = block.likely_items();
    let grid = block.grid();
    let step = least_step(scene.bounds());
    let cells: Vec<[u32; 3]> = grid.each().collect();
    let misses: Result<Vec<u64>, sightline_trace::TracerError> = cells
        .par_chunks(16)
        .zip(likely.par_chunks(16))
        .map(|(some, likely)| {
            let (mut packets, mut passed) = (Vec::new(), Passed::default());
            for (number, at) in some.iter().enumerate() {
                let (low, size) = grid.cell_box(*at);
                let mut random =
                    Hashed::new(&[STREAM, u64::from(at[0]), u64::from(at[1]), u64::from(at[2])]);
                for i in 0..HELD {
                    if i % LANES == 0 {
                        packets.push((number, Packet::default()));
                    }
                    let [forward, right, up] = face_basis((random.bits() % 6) as u32);
                    let direction = forward
                        + right * (2.0 * random.unit() - 1.0)
                        + up * (2.0 * random.unit() - 1.0);
                    let origin = low + size * random.point();
                    if let Some((_, packet)) = packets.last_mut() {
                        packet.push(origin.to_array(), direction.to_array());
                    }
                }
            }
            let (owners, mut packets): (Vec<usize>, Vec<Packet>) = packets.into_iter().unzip();
            sight.trace_each(&mut packets, &mut passed, step)?;
            let mut misses = 0;
            for (owner, packet) in owners.iter().zip(&packets) {
                let slot = grid.slot(some[*owner]);
                let new = |t: &&u32| {
                    **t != SKY
                        && !block.bits().seen(**t, slot)
                        && likely[*owner].binary_search_by_key(*t, |l| l.item).is_err()
                };
                misses += packet.triangle[..packet.count].iter().filter(new).count() as u64;
            }
            Ok(misses)
        })
        .collect();
    let seen: u32 = block.bits().table().iter().map(|w| w.count_ones()).sum();
    let added: usize = likely.iter().map(Vec::len).sum();
    Ok([
        misses?.iter().sum::<u64>() as f64 / (cells.len() * HELD) as f64,
        added as f64 / f64::from(seen.max(1)),
    ])
}
