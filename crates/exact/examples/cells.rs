//! Times exact cell queries on random cells of a baked result.
//!
//! `cargo run --release -p sightline-exact --example cells -- SCENE OUT.pvs [COUNT [SEED]]`

#![allow(clippy::print_stdout, reason = "it prints what it measured")]

use std::time::Instant;

use glam::Vec3;
use sightline_exact::cell::{Cell, solve};
use sightline_exact::{Limits, Occluders};
use sightline_pvs::Pvs;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [scene, result] =
        [1, 2].map(|i| args.get(i).cloned().ok_or("usage: cells SCENE OUT.pvs [COUNT [SEED]]"));
    let count: usize = args.get(3).map_or(Ok(5), |s| s.parse())?;
    let seed: u64 = args.get(4).map_or(Ok(1), |s| s.parse())?;
    let scene = sightline_scene::load(std::path::Path::new(&scene?))?;
    let pvs = Pvs::open(result?)?;
    let start = Instant::now();
    let occluders = Occluders::new(&scene)?;
    println!("{} triangles, {} occluders in {:.2?}", scene.len(), occluders.count(), start.elapsed());
    let mut state = seed;
    for _ in 0..count {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let cell = ((state >> 33) % u64::from(pvs.cells())) as u32;
        let mut ids = Vec::new();
        pvs.visible(cell, &mut ids)?;
        let mut known = vec![false; scene.len() as usize];
        ids.iter().for_each(|i| known[*i as usize] = true);
        let [min, max] = pvs.cell_bounds(cell).ok_or("no such cell")?.map(Vec3::from);
        let cell_box = Cell::new(min, max).ok_or("the cell is flat")?;
        let start = Instant::now();
        let answer = solve(&occluders, cell_box, &known, &Limits::default());
        let d = answer.cost.decisions;
        println!(
            "cell {cell}: {:.2?}; sampled {}, new {}, hidden {} ({} boxes), undecided {}; {} queries, {} regions, {} lines, {} decisions, {:.2} % exact ({} zero, {} spanned, {} refined), {} halvings",
            start.elapsed(),
            ids.len(),
            answer.seen.len(),
            answer.hidden,
            answer.boxes,
            answer.undecided.len(),
            answer.queries,
            answer.cost.regions,
            answer.cost.lines,
            d.filtered + d.refined + d.spanned + d.exact,
            100.0 * d.exact as f64 / (d.filtered + d.refined + d.spanned + d.exact).max(1) as f64,
            d.zero,
            d.spanned,
            d.refined,
            answer.cost.divisions,
        );
    }
    Ok(())
}
