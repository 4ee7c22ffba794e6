//! Times exact ambient occlusion against rays: `ambient SCENE [--distances 1,2,inf] [--squares N]`
//! prints tables.
//!
//! The points are texels of a lightmap: squares of 8 × 8 on triangles that are drawn by area. The texels are
//! a sixteenth of the distance apart, but at most a 400th of the diagonal; texels outside the triangle are
//! skipped. Rays are jittered, 16 to a packet of Embree, and stop at the first hit. The times do not include
//! reading files. A point is right if its openness differs from the exact openness by at most half a step of
//! 8 bits (0.5/255). All times are from the same process and cores.

#![allow(clippy::print_stdout, reason = "a measurement")]

use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use rayon::prelude::*;
use sightline_ambient::{AmbientScene, Falloff, Receiver, Solver, SolverSettings};
use sightline_numbers::random::SplitMix64;
use sightline_scene::{Scene, TriangleId, load};
use sightline_trace::embree::Occlusion;
use sightline_trace::packet::{LANES, Packet};

/// Exact ambient occlusion against rays.
#[derive(Parser)]
struct Args {
    /// The scene.
    scene: PathBuf,
    /// Distances in units of the scene, or inf.
    #[arg(long, value_delimiter = ',', default_values_t = [f64::INFINITY])]
    distances: Vec<f64>,
    /// Number of squares of 8 × 8 texels, each around a random point of the surface.
    #[arg(long, default_value_t = 100)]
    squares: u32,
    /// Numbers of rays per point.
    #[arg(long, value_delimiter = ',', default_values_t = [256, 1024, 4096, 8192, 16_384, 65_536])]
    rays: Vec<u32>,
    /// Maximum number of points that are traced with each number of rays.
    #[arg(long, default_value_t = 1000)]
    traced: usize,
    /// Also solve the points one by one, and with falloff.
    #[arg(long)]
    variants: bool,
}

fn unit(random: &mut SplitMix64) -> f64 {
    (random.bits() >> 11) as f64 / (1u64 << 53) as f64
}

fn points(scene: &Scene, squares: u32, texel: f64) -> Vec<Receiver> {
    let mut random = SplitMix64::new(7);
    let mut sum = 0.0;
    let corners = |id: usize| scene.triangles()[id].v.map(|v| v.as_dvec3());
    let areas: Vec<f64> = (0..scene.triangles().len())
        .map(|id| {
            let [a, b, c] = corners(id);
            sum += if scene.blocks(TriangleId(id as u32)) {
                (b - a).cross(c - a).length()
            } else {
                0.0
            };
            sum
        })
        .collect();
    let mut all = Vec::new();
    for _ in 0..squares {
        let at = unit(&mut random) * sum;
        let id = areas.partition_point(|a| *a < at).min(areas.len() - 1);
        let v = corners(id);
        let normal = (v[1] - v[0]).cross(v[2] - v[0]).normalize();
        let u = (v[1] - v[0]).normalize();
        let w = normal.cross(u);
        let (a, b) = (unit(&mut random).sqrt(), unit(&mut random));
        let middle = v[0] * (1.0 - a) + v[1] * (a * (1.0 - b)) + v[2] * (a * b);
        for i in 0..64 {
            let (x, y) = (f64::from(i % 8) - 3.5, f64::from(i / 8) - 3.5);
            let point = middle + (u * x + w * y) * texel;
            if (0..3).all(|k| normal.dot((v[(k + 1) % 3] - v[k]).cross(point - v[k])) > 0.0) {
                all.push(Receiver {
                    point,
                    normal,
                    triangle: Some(TriangleId(id as u32)),
                });
            }
        }
    }
    all
}

/// Computes the openness of a point with jittered rays.
fn by_rays(
    tracer: &Occlusion,
    r: &Receiver,
    rays: u32,
    near: f64,
    distance: f64,
    seed: u64,
) -> f64 {
    let mut random = SplitMix64::new(seed);
    let (u, v) = r.normal.any_orthonormal_pair();
    // The rays form whole packets of 4 × 4.
    let side = (f64::from(rays).sqrt() / 4.0).round() as u32 * 4;
    let origin = (r.point + r.normal * near).as_vec3().to_array();
    let (mut free, mut packet) = (0usize, Packet::default());
    let mut flush = |packet: &mut Packet| {
        let hidden = tracer.hidden(packet, 0.0, distance as f32);
        free += hidden[..packet.count].iter().filter(|h| !**h).count();
        packet.count = 0;
    };
    // Each packet has 4 × 4 neighbours.
    for block in 0..(side / 4) * (side / 4) {
        for k in 0..16 {
            let (i, j) = (
                block / (side / 4) * 4 + k / 4,
                block % (side / 4) * 4 + k % 4,
            );
            let s = (f64::from(i) + unit(&mut random)) / f64::from(side);
            let turn = (f64::from(j) + unit(&mut random)) / f64::from(side) * std::f64::consts::TAU;
            let (y, x) = turn.sin_cos();
            let ray = (u * x + v * y) * s.sqrt() + r.normal * (1.0 - s).sqrt();
            packet.push(origin, ray.as_vec3().to_array());
            if packet.count == LANES {
                flush(&mut packet);
            }
        }
    }
    free as f64 / f64::from(side / 4 * 4 * (side / 4 * 4))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    let scene = load(&args.scene)?;
    let bounds = scene.bounds();
    let diagonal = f64::from((bounds.max - bounds.min).length());
    let threads = rayon::current_num_threads() as f64;
    println!(
        "{}: {} triangles, diagonal {diagonal:.1}, {threads} threads\n",
        args.scene.display(),
        scene.len()
    );
    println!(
        "| distance | what | µs a point and thread | by exact | right to 8 bits | root mean square | most |"
    );
    println!("|---|---|--:|--:|--:|--:|--:|");
    let begun = Instant::now();
    let tracer = Occlusion::new(&scene)?;
    let built = begun.elapsed();
    for distance in &args.distances {
        let texel = (distance / 16.0).min(diagonal / 400.0);
        let receivers = points(&scene, args.squares, texel);
        let per_point = |seconds: f64, n: usize| seconds * 1e6 * threads / n as f64;
        let begun = Instant::now();
        let prepared_scene = AmbientScene::new(&scene, false)?;
        let prepared = begun.elapsed();
        let solver = Solver::new(&prepared_scene, SolverSettings::new(*distance));
        let begun = Instant::now();
        let answers = solver.solve(&receivers, |_| {});
        let exact = per_point(begun.elapsed().as_secs_f64(), receivers.len());
        let parts = answers
            .iter()
            .map(|a| f64::from(a.openness.parts))
            .sum::<f64>()
            / answers.len() as f64;
        let bound = answers.iter().map(|a| a.openness.bound).fold(0.0, f64::max);
        println!(
            "| {distance} | exact, {} points, {parts:.0} parts, prepared in {:.2} s (Embree {:.2} s) \
             | {exact:.1} | 1 | all | | {bound:.0e} |",
            receivers.len(),
            prepared.as_secs_f64(),
            built.as_secs_f64()
        );
        if args.variants {
            let mut alone = SolverSettings::new(*distance);
            alone.block.0 = 1;
            let mut variants = vec![("each point alone", alone)];
            if distance.is_finite() {
                variants.push((
                    "falloff",
                    SolverSettings {
                        falloff: Falloff::Sqrt,
                        ..SolverSettings::new(*distance)
                    },
                ));
            }
            for (name, settings) in variants {
                let solver = Solver::new(&prepared_scene, settings);
                let begun = Instant::now();
                solver.solve(&receivers, |_| {});
                let took = per_point(begun.elapsed().as_secs_f64(), receivers.len());
                println!(
                    "| {distance} | {name} | {took:.1} | {:.2} | | | |",
                    took / exact
                );
            }
        }
        let step = receivers.len().div_ceil(args.traced).max(1);
        let some: Vec<(&Receiver, f64)> = receivers
            .iter()
            .zip(&answers)
            .step_by(step)
            .map(|(r, a)| (r, a.openness.open))
            .collect();
        for rays in &args.rays {
            let begun = Instant::now();
            let traced: Vec<f64> = some
                .par_iter()
                .enumerate()
                .map(|(i, (r, _))| by_rays(&tracer, r, *rays, diagonal * 1e-6, *distance, i as u64))
                .collect();
            let took = per_point(begun.elapsed().as_secs_f64(), some.len());
            let off: Vec<f64> = some
                .iter()
                .zip(&traced)
                .map(|((_, open), t)| (open - t).abs())
                .collect();
            let right = off.iter().filter(|d| **d <= 0.5 / 255.0).count() as f64 / off.len() as f64;
            let square = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
            println!(
                "| {distance} | {rays} rays | {took:.1} | {:.1} | {:.1} % | {square:.1e} | {:.1e} |",
                took / exact,
                right * 100.0,
                off.iter().copied().fold(0.0, f64::max)
            );
        }
    }
    Ok(())
}
