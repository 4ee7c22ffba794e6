//! Times openness on blocks of texels of a scene:
//! `cargo run --release -p sightline-ambient --example points -- SCENE DISTANCE [BLOCKS] [TEXEL]`.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "an example")]

use std::time::Instant;

use glam::DVec3;
use sightline_ambient::Receiver;
use sightline_ambient::{Settings, Solver};
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
    let begun = Instant::now();
    let mut settings = Settings::new(distance);
    settings.block.0 = block;
    if std::env::var_os("FIRST").is_some() {
        settings.falloff = sightline_ambient::Falloff::Sqrt;
    }
    let solver = Solver::new(&scene, settings).unwrap();
    println!(
        "{} triangles, diagonal {diagonal:.1}, texel {texel:.3}, prepared in {:.3} s",
        scene.triangles().len(),
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
    let begun = Instant::now();
    let answers: Vec<_> = solver.solve(&receivers, |_| {}).into_iter().map(|a| a.openness).collect();
    let seconds = begun.elapsed().as_secs_f64();
    if std::env::var_os("DUMP").is_some() {
        for (r, a) in receivers.iter().zip(&answers) {
            println!("{:?} {} {} {:.12} {:.1e}", r.triangle.unwrap(), r.point, r.normal, a.open, a.bound);
        }
    }
    if let Some(rays) = std::env::var_os("RAYS").map(|r| r.to_str().unwrap().parse::<u32>().unwrap()) {
        // Every so many points against rays.
        let step = (answers.len() / 100).max(1);
        let (mut worst, mut sigmas) = (0.0f64, 0.0f64);
        for (r, a) in receivers.iter().zip(&answers).step_by(step) {
            let near: Vec<[DVec3; 3]> = scene
                .triangles()
                .iter()
                .enumerate()
                .filter(|(id, t)| {
                    let b = t.bounds();
                    let p = r.point.clamp(b.min.as_dvec3(), b.max.as_dvec3());
                    scene.blocks(*id as u32)
                        && (p - r.point).length() < distance
                        && *id as u32 != r.triangle.unwrap()
                })
                .map(|(_, t)| t.v.map(|v| v.as_dvec3() - r.point))
                .collect();
            let (u, w) = r.normal.any_orthonormal_pair();
            let (mut free, side) = (0u32, f64::from(rays).sqrt() as u32);
            for i in 0..side {
                for j in 0..side {
                    let s = (f64::from(i) + random()) / f64::from(side);
                    let (y, x) =
                        ((f64::from(j) + random()) / f64::from(side) * std::f64::consts::TAU).sin_cos();
                    let ray = (u * x + w * y) * s.sqrt() + r.normal * (1.0 - s).sqrt();
                    let hit = near.iter().any(|[a, b, c]| {
                        let n = (*b - *a).cross(*c - *a);
                        let t = n.dot(*a) / n.dot(ray);
                        let (p, q, s) = (a.cross(*b).dot(ray), b.cross(*c).dot(ray), c.cross(*a).dot(ray));
                        t > 0.0
                            && t < distance
                            && ((p > 0.0 && q > 0.0 && s > 0.0) || (p < 0.0 && q < 0.0 && s < 0.0))
                    });
                    free += u32::from(!hit);
                }
            }
            let sampled = f64::from(free) / f64::from(side * side);
            let sigma = (sampled * (1.0 - sampled) / f64::from(side * side)).sqrt().max(1e-9);
            let d = (sampled - a.open).abs();
            if d > 4.0 * sigma + 1e-6 {
                println!(
                    "{} {} {:?} open {} rays {sampled} off by {d:.2e} = {:.1} sigma",
                    r.point,
                    r.normal,
                    r.triangle.unwrap(),
                    a.open,
                    d / sigma
                );
            }
            worst = worst.max(d);
            sigmas = sigmas.max(d / sigma);
        }
        println!("worst {worst:.2e}, {sigmas:.1} sigma");
    }
    let n = answers.len() as f64;
    let mean = |of: &dyn Fn(&sightline_ambient::Openness) -> f64| answers.iter().map(of).sum::<f64>() / n;
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
