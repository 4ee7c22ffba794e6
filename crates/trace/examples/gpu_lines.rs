//! Measures the speed of tracing lines: `gpu_lines [--adapter name] [--millions n] scene...`.
//!
//! The example compares the cpu backend with the GPU, for rays of cube tiles (coherent) and for unrelated
//! rays. It also prints how often the two meet different triangles.
//!
//! The example does not bake or compare pictures. Times are only of the tracers' calls, the best of three:
//! the cpu backend on all threads, and one call of the GPU from one thread.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use sightline_scene::Aabb;
use sightline_trace::cpu::CpuBackend;
use sightline_trace::cube::face_basis;
use sightline_trace::gpu::{AdapterChoice, GpuBackend};
use sightline_trace::packet::{Halves, LANES, LineTracer, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeSpec, LineSet, SKY, Strata, Tracer};

/// The side length of a cube's face in pixels.
const SIDE: u32 = 128;
/// The number of packets of a call of the CPU tracer. The GPU tracer receives all packets at once.
const CPU_CALL: usize = 256;
/// The relative difference below which two distances count as equal.
const SAME: f32 = 1e-4;

/// Returns the packets of cubes from random points, in tiles of 4 × 4 pixels.
fn coherent(bounds: Aabb, count: usize, random: &mut Hashed) -> Vec<Packet> {
    let mut packets = Vec::new();
    while packets.len() < count {
        let o = bounds.min + (bounds.max - bounds.min) * random.point();
        for face in 0..6 {
            let [forward, right, up] = face_basis(face);
            let at = |x: u32| (2 * x + 1) as f32 / SIDE as f32 - 1.0;
            for tile in 0..SIDE / 4 * (SIDE / 4) {
                let (x, y) = (tile % (SIDE / 4) * 4, tile / (SIDE / 4) * 4);
                let mut packet = Packet::default();
                for lane in 0..LANES as u32 {
                    let d = forward + right * at(x + lane % 4) + up * at(y + lane / 4);
                    packet.push(o.to_array(), d.to_array());
                }
                packets.push(packet);
            }
        }
    }
    packets.truncate(count);
    packets
}

/// Returns packets of rays between random points of the bounds.
fn incoherent(bounds: Aabb, count: usize, random: &mut Hashed) -> Vec<Packet> {
    let size = bounds.max - bounds.min;
    (0..count)
        .map(|_| {
            let mut packet = Packet::default();
            for _ in 0..LANES {
                let o = bounds.min + size * random.point();
                let d = bounds.min + size * random.point() - o;
                packet.push(o.to_array(), d.to_array());
            }
            packet
        })
        .collect()
}

/// Returns the speed in millions of rays per second, the best of three.
fn rate(packets: &mut [Packet], mut trace: impl FnMut(&mut [Packet])) -> f64 {
    let rays = (packets.len() * LANES) as f64;
    (0..3)
        .map(|_| {
            let start = Instant::now();
            trace(packets);
            rays / start.elapsed().as_secs_f64() / 1e6
        })
        .fold(0.0, f64::max)
}

/// Counts the rays that meet different triangles in `a` and `b`. Of these rays, it also counts the rays whose
/// distances differ and the rays without a hit in `b`.
fn differing(a: &[Packet], b: &[Packet]) -> (usize, usize, usize) {
    let (mut ids, mut distances, mut holes) = (0, 0, 0);
    for (p, q) in a.iter().zip(b) {
        for l in 0..LANES {
            if p.triangle[l] != q.triangle[l] {
                ids += 1;
                let (x, y) = (p.distance[l], q.distance[l]);
                // The comparison also holds if one distance is infinite.
                distances += usize::from((x - y).abs() > SAME * x.abs().min(y.abs()));
                holes += usize::from(q.triangle[l] == SKY);
            }
        }
    }
    (ids, distances, holes)
}

#[allow(clippy::print_stdout, reason = "this program's output is its purpose")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut choice = AdapterChoice::AllowSoftware;
    let mut millions = 2.0f64;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--adapter" => {
                choice = AdapterChoice::Named(arguments.next().ok_or("--adapter needs a name")?)
            }
            "--millions" => {
                millions = arguments
                    .next()
                    .ok_or("--millions needs a number")?
                    .parse()?
            }
            file => measure(Path::new(file), &choice, millions)?,
        }
    }
    Ok(())
}

#[allow(clippy::print_stdout, reason = "this program's output is its purpose")]
fn measure(
    file: &Path,
    choice: &AdapterChoice,
    millions: f64,
) -> Result<(), Box<dyn std::error::Error>> {
    let scene = Arc::new(sightline_scene::load(file)?);
    let spec = CubeSpec {
        resolution: 64,
        strata: Strata::One,
        keep_pixels: false,
    };
    println!("{}: {} triangles", file.display(), scene.len());
    let cpu = CpuBackend::new(scene.clone(), spec)?;
    let gpu = GpuBackend::new(scene.clone(), spec, choice.clone())?;
    let ids: Vec<u32> = (0..scene.len()).collect();
    let made = |backend: &dyn Tracer| -> Result<(), Box<dyn std::error::Error>> {
        let start = Instant::now();
        backend.lines(LineSet::Blocking, &ids)?;
        println!(
            "  {}: ready in {:.3} s",
            backend.profile(),
            start.elapsed().as_secs_f64()
        );
        Ok(())
    };
    made(&cpu)?;
    made(&gpu)?;
    let (cpu, gpu) = (
        cpu.lines(LineSet::Blocking, &ids)?,
        gpu.lines(LineSet::Blocking, &ids)?,
    );
    let count = (millions * 1e6) as usize / LANES;
    let mut random = Hashed::new(&[1]);
    for alike in [true, false] {
        let make = if alike { coherent } else { incoherent };
        let mut a = make(scene.bounds(), count, &mut random);
        let mut b = a.clone();
        let trace =
            |tracer: &dyn LineTracer, run: &mut [Packet]| tracer.trace(run, Halves::Rays, alike);
        let mut fault = None;
        let cpu_rate = rate(&mut a, |packets| {
            let done = packets
                .par_chunks_mut(CPU_CALL)
                .try_for_each(|run| trace(&*cpu, run));
            fault = fault.take().or(done.err());
        });
        let compute = rate(&mut b, |packets| {
            fault = fault.take().or(trace(&*gpu, packets).err());
        });
        if let Some(error) = fault {
            return Err(error.into());
        }
        let (ids, distances, holes) = differing(&a, &b);
        let rays = count * LANES;
        println!(
            "  {}: cpu {cpu_rate:.2} Mrays/s, compute {compute:.2} Mrays/s; of {rays} rays {ids} meet \
             another triangle, {distances} of them elsewhere, {holes} only on the cpu",
            if alike { "coherent" } else { "incoherent" },
        );
    }
    Ok(())
}
