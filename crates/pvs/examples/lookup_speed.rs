//! Measures the time of look-ups: `lookup_speed RESULT.pvs` prints the time to open the file, to find the
//! cell of a point, and to decode the set of a cell in each of its three forms.

#![allow(clippy::print_stdout)] // Users read the output at a terminal.

use std::hint::black_box;
use std::time::Instant;

use sightline_pvs::Pvs;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("usage: lookup_speed RESULT.pvs")?;
    let start = Instant::now();
    let pvs = Pvs::open(&path)?;
    let [file, ..] = pvs.file_bytes();
    let opened = start.elapsed();
    println!(
        "{} triangles, {} cells, {file} bytes",
        pvs.triangle_count(),
        pvs.cells()
    );
    println!(
        "open and check: {:.2} ms ({:.1} GB/s)",
        opened.as_secs_f64() * 1e3,
        file as f64 / opened.as_secs_f64() / 1e9
    );

    let [lo, hi] = pvs.tree().view_box();
    // The points of an additive recurrence are far from each other, so no look-up warms the cache for the
    // next.
    let points: Vec<[f32; 3]> = (0..1_000_000u32)
        .map(|i| {
            let part = |step: u32| (i.wrapping_mul(step) >> 8) as f32 / (1 << 24) as f32;
            let s = [
                part(3_518_319_155),
                part(2_882_110_345),
                part(2_360_945_575),
            ];
            std::array::from_fn(|a| lo[a] + (hi[a] - lo[a]) * s[a])
        })
        .collect();
    let start = Instant::now();
    for &p in &points {
        black_box(pvs.find_cell(black_box(p)));
    }
    println!(
        "find_cell: {:.1} ns",
        start.elapsed().as_secs_f64() * 1e9 / points.len() as f64
    );

    if pvs.cell_pairs()?.is_some() {
        let cells: Vec<u32> = points.iter().filter_map(|p| pvs.find_cell(*p)).collect();
        let pairs = || cells.iter().zip(cells.iter().rev()).zip(&points);
        let start = Instant::now();
        for ((a, b), _) in pairs() {
            black_box(pvs.sees(black_box(*a), black_box(*b))?);
        }
        println!(
            "sees: {:.1} ns",
            start.elapsed().as_secs_f64() * 1e9 / points.len() as f64
        );
        // Boxes with a fiftieth of the size of the view box represent moving objects.
        let size: [f32; 3] = std::array::from_fn(|a| (hi[a] - lo[a]) / 50.0);
        let start = Instant::now();
        for ((a, _), p) in pairs() {
            let far: [f32; 3] = std::array::from_fn(|k| (p[k] + size[k]).min(hi[k]));
            black_box(pvs.sees_box(black_box(*a), *p, far)?);
        }
        println!(
            "sees_box: {:.1} ns",
            start.elapsed().as_secs_f64() * 1e9 / points.len() as f64
        );
    }

    // Keep the minimum of several times for each cell, which excludes other load of the machine.
    let mut ids = Vec::new();
    let mut runs = Vec::new();
    let mut bits = vec![0u64; (pvs.triangle_count() as usize).div_ceil(64)];
    let (mut total, mut spent, mut worst) = (0u64, [0.0f64; 3], 0.0f64);
    for cell in 0..pvs.cells() {
        let mut best = [f64::INFINITY; 3];
        for _ in 0..7 {
            let start = Instant::now();
            pvs.visible(cell, &mut ids)?;
            best[0] = best[0].min(start.elapsed().as_secs_f64());
            let start = Instant::now();
            pvs.visible_runs(cell, &mut runs)?;
            best[1] = best[1].min(start.elapsed().as_secs_f64());
            let start = Instant::now();
            pvs.visible_bits(cell, &mut bits)?;
            best[2] = best[2].min(start.elapsed().as_secs_f64());
            black_box((&ids, &runs, &bits));
        }
        total += ids.len() as u64;
        worst = worst.max(best[0]);
        for (sum, one) in spent.iter_mut().zip(best) {
            *sum += one;
        }
    }
    let cells = f64::from(pvs.cells());
    let [as_ids, as_runs, as_bits] = spent.map(|s| s * 1e6 / cells);
    println!("{:.0} ids per cell on average", total as f64 / cells);
    println!(
        "decode to ids: {as_ids:.1} µs per cell (worst {:.1}), {:.2} ns per id",
        worst * 1e6,
        spent[0] * 1e9 / total.max(1) as f64
    );
    println!("decode to runs: {as_runs:.1} µs per cell");
    println!("decode to bits: {as_bits:.1} µs per cell");
    Ok(())
}
