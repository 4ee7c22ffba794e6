//! Example program that times random queries between a face of one of 8×8×8 cells over the scene's bounds,
//! and a triangle.
//!
//! `cargo run --release -p sightline-exact --example pairs -- SCENE [COUNT [SEED [check]]]`

#![allow(clippy::print_stdout, reason = "the example prints its measurements")]

use std::time::{Duration, Instant};

use glam::DVec3;
use sightline_certificate::checker;
use sightline_exact::{Occluders, Polygon, QueryCost, QueryLimits, Verdict, sightlines};
use sightline_numbers::random::SplitMix64;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let path = args
        .get(1)
        .ok_or("usage: pairs SCENE [COUNT [SEED [check]]]")?;
    let count: usize = args.get(2).map_or(Ok(2000), |s| s.parse())?;
    let mut stream = SplitMix64::new(args.get(3).map_or(Ok(1), |s| s.parse())?);
    let mut random = move || stream.bits();
    let scene = sightline_scene::load(std::path::Path::new(path))?;
    let start = Instant::now();
    let occluders = Occluders::new(&scene)?;
    println!(
        "{} triangles, {} occluders in {:.2?}",
        scene.len(),
        occluders.count(),
        start.elapsed()
    );
    let (lo, hi) = (scene.bounds().min.as_dvec3(), scene.bounds().max.as_dvec3());
    let mut kinds: [(&str, Vec<Duration>, QueryCost); 3] =
        ["visible", "hidden", "undecided"].map(|n| (n, Vec::new(), QueryCost::default()));
    let (mut blockers, mut proved) = (0usize, 0usize);
    // For each hidden pair: the number of effective occluders, the seconds and the number of regions.
    let mut grown: Vec<(f64, f64, f64)> = Vec::new();
    let limits = QueryLimits::default();
    let check = args.get(4).is_some_and(|a| a == "check");
    let mut checking = Duration::ZERO;
    let raw: Vec<[glam::Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
    while kinds.iter().map(|k| k.1.len()).sum::<usize>() < count {
        let cell = [random() % 8, random() % 8, random() % 8].map(|c| c as f64);
        let step = (hi - lo) / 8.0;
        let min = lo + DVec3::from(cell) * step;
        let max = min + step;
        let (axis, up) = ((random() % 3) as usize, random() % 2 == 0);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let face: Vec<DVec3> = [[0, 0], [1, 0], [1, 1], [0, 1]]
            .iter()
            .map(|[s, t]| {
                let mut p = min;
                p[axis] = if up { max[axis] } else { min[axis] };
                p[u] = if *s == 1 { max[u] } else { min[u] };
                p[v] = if *t == 1 { max[v] } else { min[v] };
                p.as_vec3().as_dvec3()
            })
            .collect();
        let id = (random() % scene.len() as u64) as usize;
        let corners = scene.triangles()[id].v.map(|v| v.as_dvec3());
        // Query only triangles that are entirely on the outer side of the face.
        let outside = corners.iter().all(|p| {
            if up {
                p[axis] > face[0][axis]
            } else {
                p[axis] < face[0][axis]
            }
        });
        let (Ok(a), Some(b)) = (Polygon::checked(&face), Polygon::triangle(corners)) else {
            continue;
        };
        if !outside {
            continue;
        }
        let start = Instant::now();
        let (verdict, cost) = sightlines(&occluders, &a, &[b], &limits);
        let took = start.elapsed();
        let kind = match &verdict {
            Verdict::Visible(ends) => {
                if check {
                    let [p, q] = [0, 1].map(|i| sightline_exact::predicates::integers(&ends[i]));
                    if let Err(e) = checker::check_witness(
                        &raw,
                        &[checker::corners(&face)],
                        &[checker::corners(&corners)],
                        &p,
                        &q,
                    ) {
                        println!("REJECTED witness for {face:?} {id}: {e}");
                    }
                }
                0
            }
            Verdict::Hidden(proof) => {
                if check {
                    let start = Instant::now();
                    if let Err(e) = checker::check_hidden(
                        &raw,
                        &[checker::corners(&face)],
                        &[checker::corners(&corners)],
                        proof,
                    ) {
                        println!("REJECTED proof for {face:?} {id}: {e}");
                    }
                    checking += start.elapsed();
                }
                blockers += proof.occluders.len();
                proved += 1;
                grown.push((
                    proof.occluders.len() as f64,
                    took.as_secs_f64(),
                    cost.regions as f64,
                ));
                1
            }
            Verdict::Undecided(reason) => {
                println!("undecided: {face:?} {corners:?} {id}: {reason}");
                2
            }
        };
        kinds[kind].1.push(took);
        kinds[kind].2 += cost;
    }
    for (name, times, cost) in &mut kinds {
        if times.is_empty() {
            continue;
        }
        times.sort();
        let n = times.len() as f64;
        let total: Duration = times.iter().sum();
        let d = cost.decisions;
        println!(
            "{name}: {} pairs, mean {:.4} ms, p50 {:.4}, p99 {:.3}, max {:.1}; per pair: {:.1} regions, \
             {:.1} lines, {:.1} occluders, {:.2} halvings; {:.0} decisions, {:.3} % exact ({:.3} % zero)",
            times.len(),
            total.as_secs_f64() * 1e3 / n,
            times[times.len() / 2].as_secs_f64() * 1e3,
            times[(times.len() * 99 / 100).min(times.len() - 1)].as_secs_f64() * 1e3,
            times[times.len() - 1].as_secs_f64() * 1e3,
            cost.regions as f64 / n,
            cost.lines as f64 / n,
            cost.occluders as f64 / n,
            cost.divisions as f64 / n,
            (d.filtered + d.refined + d.spanned + d.exact) as f64 / n,
            100.0 * d.exact as f64 / (d.filtered + d.refined + d.spanned + d.exact).max(1) as f64,
            100.0 * d.zero as f64 / (d.filtered + d.refined + d.spanned + d.exact).max(1) as f64,
        );
    }
    println!(
        "checking a proof: {:.3} ms",
        checking.as_secs_f64() * 1e3 / proved.max(1) as f64
    );
    println!(
        "occluders per proof: {:.2}",
        blockers as f64 / proved.max(1) as f64
    );
    growth(&grown);
    Ok(())
}

/// Prints the growth of a hidden pair's cost with its effective occluders, m.
///
/// The output contains means by classes of m, and the power of m that fits the pairs best (least squares of
/// logarithms, for pairs with at least two occluders).
fn growth(pairs: &[(f64, f64, f64)]) {
    let mut from = 1.0;
    while pairs.iter().any(|p| p.0 >= from) {
        let class: Vec<_> = pairs
            .iter()
            .filter(|p| (from..2.0 * from).contains(&p.0))
            .collect();
        if !class.is_empty() {
            let mean = |f: fn(&(f64, f64, f64)) -> f64| {
                class.iter().map(|p| f(p)).sum::<f64>() / class.len() as f64
            };
            println!(
                "{from} to {} effective occluders: {} pairs, mean {:.3} ms, {:.1} regions",
                2.0 * from - 1.0,
                class.len(),
                mean(|p| p.1) * 1e3,
                mean(|p| p.2)
            );
        }
        from *= 2.0;
    }
    let power = |f: fn(&(f64, f64, f64)) -> f64| {
        let logs: Vec<[f64; 2]> = pairs
            .iter()
            .filter(|p| p.0 >= 2.0)
            .map(|p| [p.0.ln(), f(p).ln()])
            .collect();
        let n = logs.len() as f64;
        let [mx, my] = [0, 1].map(|k| logs.iter().map(|l| l[k]).sum::<f64>() / n);
        let over: f64 = logs.iter().map(|l| (l[0] - mx) * (l[1] - my)).sum();
        over / logs.iter().map(|l| (l[0] - mx).powi(2)).sum::<f64>()
    };
    if !power(|p| p.1).is_finite() {
        println!("too few pairs to say how time grows with effective occluders");
        return;
    }
    println!(
        "growth with effective occluders m: time m^{:.2}, regions m^{:.2}",
        power(|p| p.1),
        power(|p| p.2)
    );
}
