//! Times openness on blocks of texels of a scene:
//! `cargo run --release -p sightline-ambient --example points -- SCENE DISTANCE [BLOCKS] [TEXEL]`.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "an example")]

use std::time::Instant;

use glam::DVec3;
use sightline_ambient::blockers::Blockers;
use sightline_ambient::receivers::Receiver;
use sightline_ambient::solve::{Options, solve};
use sightline_scene::load;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scene = load(std::path::Path::new(&args[1])).unwrap();
    let number = |k: usize, default: f64| args.get(k).map_or(default, |a| a.parse().unwrap());
    let distance = number(2, f64::INFINITY);
    let blocks = number(3, 100.0) as usize;
    let diagonal = scene.bounds();
    let diagonal = f64::from((diagonal.max - diagonal.min).length());
    let texel = number(4, (distance / 16.0).min(diagonal / 400.0));
    let block = number(5, 64.0) as usize;
    let open_above = number(6, -1.0);
    let begun = Instant::now();
    let blockers = Blockers::new(&scene, true).unwrap();
    println!(
        "{} triangles, {} polygons, diagonal {diagonal:.1}, texel {texel:.3}, prepared in {:.3} s",
        scene.triangles().len(),
        blockers.count(),
        begun.elapsed().as_secs_f64()
    );
    let mut state = 7u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut sum = 0.0;
    let areas: Vec<f64> = scene
        .triangles()
        .iter()
        .enumerate()
        .map(|(id, t)| {
            let v = t.v.map(|v| v.as_dvec3());
            if scene.blocks(id as u32) {
                sum += (v[1] - v[0]).cross(v[2] - v[0]).length();
            }
            sum
        })
        .collect();
    let mut receivers = Vec::new();
    for _ in 0..blocks {
        let at = random() * sum;
        let id = areas.partition_point(|a| *a < at).min(areas.len() - 1);
        let v = scene.triangles()[id].v.map(|v| v.as_dvec3());
        let normal = (v[1] - v[0]).cross(v[2] - v[0]).normalize();
        let u = (v[1] - v[0]).normalize();
        let w = normal.cross(u);
        let (a, b) = (random().sqrt(), random());
        let middle = v[0] * (1.0 - a) + v[1] * (a * (1.0 - b)) + v[2] * (a * b);
        for i in 0..8 {
            for j in 0..8 {
                let p = middle + u * (f64::from(i) - 3.5) * texel + w * (f64::from(j) - 3.5) * texel;
                let inside = (0..3).all(|k| normal.dot((v[(k + 1) % 3] - v[k]).cross(p - v[k])) > 0.0);
                if inside {
                    receivers.push(Receiver { point: p, normal, triangle: Some(id as u32) });
                }
            }
        }
    }
    let mut options = Options { block, ..Options::new(distance) };
    if open_above >= 0.0 {
        options.open_above = open_above;
    }
    let begun = Instant::now();
    let answers = solve(&blockers, &receivers, &options);
    let seconds = begun.elapsed().as_secs_f64();
    let n = answers.len() as f64;
    let mean =
        |of: &dyn Fn(&sightline_ambient::query::Openness) -> f64| answers.iter().map(of).sum::<f64>() / n;
    println!(
        "{} points, {:.1} µs a point and thread of {}, mean open {:.6}, {:.1} parts, {:.1} occluders, largest bound {:.1e}",
        answers.len(),
        seconds * 1e6 / n * rayon::current_num_threads() as f64,
        rayon::current_num_threads(),
        mean(&|a| a.open),
        mean(&|a| f64::from(a.parts)),
        mean(&|a| f64::from(a.occluders)),
        answers.iter().map(|a| a.bound).fold(0.0, f64::max),
    );
}
