//! Example program that times exact cell queries on random cells of a baked result.
//!
//! `cargo run --release -p sightline-exact --example cells -- SCENE OUT.pvs [COUNT [SEED [SECONDS]]]`

#![allow(clippy::print_stdout, reason = "the example prints its measurements")]

use std::time::{Duration, Instant};

use glam::Vec3;
use sightline_certificate::{Witness, codec};
use sightline_exact::Cell;
use sightline_exact::{CellTask, ExactScene, QueryLimits, decide};
use sightline_pvs::Pvs;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [scene, result] = [1, 2].map(|i| {
        args.get(i)
            .cloned()
            .ok_or("usage: cells SCENE OUT.pvs [COUNT [SEED [SECONDS]]]")
    });
    let count: usize = args.get(3).map_or(Ok(5), |s| s.parse())?;
    let seed: u64 = args.get(4).map_or(Ok(1), |s| s.parse())?;
    let most = Duration::from_secs(args.get(5).map_or(Ok(u64::MAX), |s| s.parse())?);
    let scene = sightline_scene::load(std::path::Path::new(&scene?))?;
    let pvs = Pvs::open(result?)?;
    let start = Instant::now();
    let prepared = ExactScene::prepare(&scene)?;
    let (triangles, occluders) = (scene.len(), prepared.occluders().count());
    println!(
        "{triangles} triangles, {occluders} occluders, with surfaces, in {:.2?}",
        start.elapsed()
    );
    let mut state = seed;
    for _ in 0..count {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let cell = ((state >> 33) % u64::from(pvs.cells())) as u32;
        let mut ids = Vec::new();
        pvs.visible(cell, &mut ids)?;
        let [min, max] = pvs.cell_bounds(cell).ok_or("no such cell")?.map(Vec3::from);
        let cell_box = Cell::new(min, max).ok_or("the cell is flat")?;
        let start = Instant::now();
        let decided = decide(&CellTask {
            scene: &prepared,
            cell: cell_box,
            region: None,
            seen: &ids,
            above: &[],
            listed: None,
            limits: QueryLimits::default(),
            seed,
            keep: true,
            stop: &|| start.elapsed() > most,
            asked: &|| (),
        });
        let took = start.elapsed();
        let (e, c, d) = (
            decided.statistics,
            decided.statistics.cost,
            decided.statistics.cost.decisions,
        );
        let all = d.filtered + d.refined + d.spanned + d.exact;
        let floats = decided
            .certificate
            .seen
            .iter()
            .filter(|w| matches!(w.1, Witness::Floats(_)))
            .count();
        let bytes = codec::encode(&decided.certificate)?.len();
        println!(
            "cell {cell}: {took:.2?}; sampled {}, visible {}, missed {}, refuted {}, hidden {} ({} boxes, \
             {} by surfaces), undecided {} {:?}; {} rays, {} of {} witnesses in floats, {} bytes of \
             certificate; {} queries, {} regions, {} lines, {all} decisions, {:.2} % exact ({} zero, {} \
             spanned, {} refined), {} halvings",
            ids.len(),
            decided.visible.len(),
            e.missed,
            e.refuted,
            e.hidden,
            e.boxes,
            e.enclosed,
            decided.undecided.len(),
            e.open,
            e.rays,
            floats,
            decided.certificate.seen.len(),
            bytes,
            e.queries,
            c.regions,
            c.lines,
            100.0 * d.exact as f64 / all.max(1) as f64,
            d.zero,
            d.spanned,
            d.refined,
            c.divisions,
        );
    }
    Ok(())
}
