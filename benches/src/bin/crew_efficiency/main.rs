//! How efficient is a crew? Measures a bake with one thread, item by item, and simulates crews of any number
//! of workers with the measured times: `crew_efficiency SCENE [--cells 8x8x8] [--workers 2,4,8,32,1000]`.
//!
//! Efficiency is the core-seconds of one process with one thread, divided by the workers times the simulated
//! time. "whole job" counts from submission, with the scene at the client alone, to the assembled result;
//! "sampling" counts the sampling of a job whose scene all workers know.

#![allow(clippy::print_stdout, clippy::print_stderr)] // A program for people at a terminal.

mod clock;
mod measure;
mod record;
mod report;
mod simulation;
mod trace;

use std::path::PathBuf;

use clap::Parser;
use sightline_numbers::random::SplitMix64;

use crate::measure::Wanted;
use crate::simulation::{Job, Network, Settings};
use crate::trace::Trace;

type AnyError = Box<dyn std::error::Error>;

#[derive(Parser)]
#[command(about = "Simulates crews with the measured times of a bake")]
struct Args {
    /// The scene; not needed with --load.
    #[arg(required_unless_present = "load")]
    scene: Option<PathBuf>,
    /// Cells along each axis.
    #[arg(long, default_value = "8x8x8", value_parser = cells)]
    cells: [u32; 3],
    /// The target error of the bake; the program's default when left out.
    #[arg(long)]
    target_error: Option<f64>,
    /// Tiles to measure, chosen by chance. The tiles of the simulated job are drawn from them when it has
    /// more.
    #[arg(long, default_value_t = 12)]
    blocks: usize,
    /// Recordings of each tile, of which the least times count, beside one of a helper.
    #[arg(long, default_value_t = 2)]
    repeats: usize,
    /// Numbers of workers.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8,32,1000")]
    workers: Vec<usize>,
    /// Cores that all workers share; one each when left out.
    #[arg(long)]
    cores: Option<u64>,
    /// Helpers that a crew gets at most, if that is fewer than the scheduler sends.
    #[arg(long, default_value_t = 31)]
    most_helpers: usize,
    /// Milliseconds between a worker and the coordinator, one way.
    #[arg(long, default_value_t = 0.2)]
    latency: f64,
    /// Gigabits per second of a worker, each way.
    #[arg(long, default_value_t = 1.0)]
    bandwidth: f64,
    /// Gigabits per second of the coordinator, each way.
    #[arg(long, default_value_t = 10.0)]
    coordinator_bandwidth: f64,
    /// Seed of the choice of tiles.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Writes what was measured to a file.
    #[arg(long)]
    save: Option<PathBuf>,
    /// Simulates with what was measured before.
    #[arg(long)]
    load: Option<PathBuf>,
}

/// Reads `8x8x8`.
fn cells(text: &str) -> Result<[u32; 3], String> {
    let sides: Result<Vec<u32>, _> = text.split('x').map(str::parse).collect();
    let sides = sides.ok().and_then(|s| <[u32; 3]>::try_from(s).ok());
    sides
        .filter(|s| !s.contains(&0))
        .ok_or_else(|| "give three numbers, as in 8x8x8".to_owned())
}

fn trace(args: &Args) -> Result<Trace, AnyError> {
    if let Some(path) = &args.load {
        return Ok(serde_json::from_slice(&std::fs::read(path)?)?);
    }
    // One thread computes at a time, so the time of the process is that of the work.
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global()?;
    let wanted = Wanted {
        cells: args.cells,
        target_error: args.target_error,
        blocks: args.blocks,
        repeats: args.repeats,
        seed: args.seed,
    };
    let scene = args.scene.as_deref().ok_or("give a scene")?;
    let trace = measure::measure(scene, &wanted)?;
    if let Some(path) = &args.save {
        std::fs::write(path, serde_json::to_vec(&trace)?)?;
    }
    Ok(trace)
}

fn main() -> Result<(), AnyError> {
    let args = Args::parse();
    let trace = trace(&args)?;
    let mut random = SplitMix64::named(&[args.seed, 1]);
    let all = trace.blocks.len();
    let tiles = (0..trace.tiles).map(|i| match trace.tiles == all {
        true => &trace.blocks[i],
        false => &trace.blocks[(random.bits() % all as u64) as usize],
    });
    let job = Job {
        scene: &trace.scene,
        tiles: tiles.collect(),
    };
    let network = Network {
        latency: (args.latency * 1e6) as u64,
        worker: args.bandwidth * 1e9,
        coordinator: args.coordinator_bandwidth * 1e9,
    };
    let settings = |workers, is_warm| Settings {
        workers,
        cores: args.cores,
        most_helpers: args.most_helpers,
        network,
        is_warm,
    };
    report::print(&trace, &job, &args.workers, settings);
    Ok(())
}
