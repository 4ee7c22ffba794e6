//! Compares the cpu backend with Embree on the rays of the sampler: rates, hits and build times.
//!
//! ```sh
//! cargo run --release -p sightline-sample --example tracers -- SCENE 8x8x8 0.001
//! ```
//!
//! The example samples the cells as one tile with all triangles opaque, and records one in `--every` calls of
//! the tracer (default 8). Both tracers then trace the recorded calls in turns on one thread. It prints a
//! table in Markdown: millions of rays per second (medians of `--runs` runs, default 7), their ratio, and the
//! shares of rays with the same triangle, with another triangle at nearly the same distance, and with another
//! hit. Rows: tiles are packets of similar directions; aimed lines are traced separately. The last row has
//! the seconds to build each hierarchy on all threads of the pool.

#![allow(clippy::print_stdout, reason = "this program's output is its purpose")]

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use sightline_sample::Unwatched;
use sightline_sample::crew::SoleMember;
use sightline_sample::lines::block::{Block, BlockInputs};
use sightline_sample::lines::rounds::Tolerance;
use sightline_scene::Scene;
use sightline_trace::cpu::CpuBackend;
use sightline_trace::embree::EmbreeBackend;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::packet::{Halves, LANES, LineTracer, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sight::SightLineTracer;
use sightline_trace::surface::Surface;
use sightline_trace::{CubeSpec, LineSet, SKY, Strata, Tracer, TracerError};

const USAGE: &str = "usage: tracers [--every N] [--runs N] SCENE NXxNYxNZ TARGET";

type Answer<T> = Result<T, Box<dyn std::error::Error>>;

/// A call of a tracer: its packets before the trace, and its parameters.
struct Call {
    packets: Vec<Packet>,
    halves: Halves,
    coherent: bool,
}

/// A tracer that records some of its calls.
struct Recorder<'a> {
    tracer: Box<dyn LineTracer + 'a>,
    every: u64,
    /// The number of calls so far, and the recorded calls.
    calls: Mutex<(u64, Vec<Call>)>,
}

impl LineTracer for &Recorder<'_> {
    fn trace(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError> {
        {
            let mut calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
            calls.0 += 1;
            if calls.0.is_multiple_of(self.every) {
                let packets = packets.to_vec();
                calls.1.push(Call {
                    packets,
                    halves,
                    coherent,
                });
            }
        }
        self.tracer.trace(packets, halves, coherent)
    }
}

fn main() -> Answer<()> {
    let (mut every, mut runs, mut rest) = (8, 7, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut number = || -> Answer<u64> { Ok(arguments.next().ok_or(USAGE)?.parse()?) };
        match argument.as_str() {
            "--every" => every = number()?.max(1),
            "--runs" => runs = number()?.max(1),
            _ => rest.push(argument),
        }
    }
    let [scene, cells, target] = rest.as_slice() else {
        return Err(USAGE.into());
    };
    let scene = Arc::new(sightline_scene::load(scene.as_ref())?);
    let cells: Vec<u32> = cells.split('x').map(str::parse).collect::<Result<_, _>>()?;
    let cells: [u32; 3] = cells.try_into().map_err(|_| USAGE)?;
    let spec = CubeSpec {
        resolution: 8,
        strata: Strata::One,
        keep_pixels: false,
    };
    let all: Vec<u32> = (0..scene.len())
        .filter(|id| !scene.triangles()[*id as usize].is_degenerate())
        .collect();
    let mut builds = [f64::INFINITY; 2];
    for _ in 0..3 {
        let own = CpuBackend::new(Arc::clone(&scene), spec)?;
        builds[0] = builds[0].min(seconds(|| own.lines(LineSet::Blocking, &all).map(drop))?);
        let embree = EmbreeBackend::new(Arc::clone(&scene), spec)?;
        builds[1] = builds[1].min(seconds(|| embree.lines(LineSet::Blocking, &all).map(drop))?);
    }
    let own = CpuBackend::new(Arc::clone(&scene), spec)?;
    let embree = EmbreeBackend::new(Arc::clone(&scene), spec)?;
    let recorder = Recorder {
        tracer: own.lines(LineSet::Blocking, &all)?,
        every,
        calls: Mutex::default(),
    };
    sample(&scene, &all, &recorder, cells, target.parse()?)?;
    let (_, calls) = recorder
        .calls
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner);
    let tracers = [recorder.tracer, embree.lines(LineSet::Blocking, &all)?];
    println!(
        "{} triangles, {} and {}\n",
        scene.len(),
        own.profile(),
        embree.profile()
    );
    println!("| lines | rays | cpu M/s | embree M/s | ratio | same | coplanar | other |");
    println!("|---|--:|--:|--:|--:|--:|--:|--:|");
    for (name, coherent) in [("tiles", true), ("aimed", false)] {
        let calls: Vec<&Call> = calls.iter().filter(|c| c.coherent == coherent).collect();
        row(name, &calls, &tracers, runs as usize)?;
    }
    let [own, embree] = builds;
    println!(
        "| build, seconds | | {own:.4} | {embree:.4} | {:.2} | | | |",
        embree / own
    );
    Ok(())
}

fn seconds(run: impl FnOnce() -> Result<(), TracerError>) -> Result<f64, TracerError> {
    let start = Instant::now();
    run()?;
    Ok(start.elapsed().as_secs_f64())
}

/// Bakes a block of cells with the recorder as its tracer.
fn sample(
    scene: &Scene,
    ids: &[u32],
    recorder: &Recorder<'_>,
    cells: [u32; 3],
    target: f64,
) -> Answer<()> {
    let (rows, surface) = (Rows::triangles(scene), Surface::new(scene, ids));
    let sight = SightLineTracer::opaque(Box::new(recorder));
    let bounds = scene.bounds();
    let [nx, ny, _] = cells.map(u64::from);
    let number = |c: [u32; 3]| (u64::from(c[2]) * ny + u64::from(c[1])) * nx + u64::from(c[0]);
    let inputs = BlockInputs {
        scene,
        surface: &surface,
        rows: &rows,
        sight: &sight,
        seed: 1,
        watcher: &Unwatched,
        deadline: None,
        pairs: None,
        region: None,
        crew: &SoleMember,
        observer: None,
    };
    let grid = CellGrid::new(bounds.min, bounds.max, cells);
    Block::new(inputs, grid, number, |_| u64::MAX).sample(target, &[], Tolerance::Raised)?;
    Ok(())
}

/// Traces calls with both tracers and prints the row of the table.
fn row(
    name: &str,
    calls: &[&Call],
    tracers: &[Box<dyn LineTracer + '_>; 2],
    runs: usize,
) -> Answer<()> {
    let mut times = [Vec::new(), Vec::new()];
    let mut traced = [Vec::new(), Vec::new()];
    for _ in 0..runs {
        for (which, tracer) in tracers.iter().enumerate() {
            let mut packets: Vec<Vec<Packet>> = calls.iter().map(|c| c.packets.clone()).collect();
            let start = Instant::now();
            for (packets, call) in packets.iter_mut().zip(calls) {
                tracer.trace(packets, call.halves, call.coherent)?;
            }
            times[which].push(start.elapsed().as_secs_f64());
            traced[which] = packets;
        }
    }
    let rays: usize = calls.iter().flat_map(|c| &c.packets).map(|p| p.count).sum();
    let [own, embree] = times.map(|mut t| {
        t.sort_by(f64::total_cmp);
        rays as f64 / t[t.len() / 2] * 1e-6
    });
    let (mut same, mut coplanar) = (0u64, 0u64);
    let [a, b] = &traced;
    for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
        for lane in 0..a.count.min(LANES) {
            let (s, t) = (a.triangle[lane], b.triangle[lane]);
            let (near, far) = (a.distance[lane], b.distance[lane]);
            let is_close =
                s != SKY && t != SKY && (near - far).abs() <= 1e-4 * near.abs().max(far.abs());
            same += u64::from(s == t);
            coplanar += u64::from(s != t && is_close);
        }
    }
    let share = |count: u64| 100.0 * count as f64 / rays.max(1) as f64;
    println!(
        "| {name} | {rays} | {own:.2} | {embree:.2} | {:.2} | {:.4} % | {:.4} % | {:.5} % |",
        own / embree,
        share(same),
        share(coplanar),
        share(rays as u64 - same - coplanar)
    );
    Ok(())
}
