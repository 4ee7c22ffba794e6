//! Counts the rays of a bake by kind, by round and by the knowledge about a candidate. For the hits of
//! held-out lines, the example counts the kinds of line that could have found the hit triangles, and how the
//! misses of a cell are distributed over directions.
//!
//! ```sh
//! cargo run --release -p sightline-sample --example rays -- SCENE 8x8x8 0.0003
//! ```
//!
//! The example samples the cells as one tile with the default sampler on the CPU, with all triangles opaque,
//! and prints tables in Markdown. Times are sums over all threads.

#![allow(clippy::print_stdout, reason = "this program's output is its purpose")]

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rayon::prelude::*;
use sightline_model::LineKind;
use sightline_sample::Unwatched;
use sightline_sample::crew::SoleMember;
use sightline_sample::lines::block::{Block, BlockInputs};
use sightline_sample::lines::observer::{Attempt, LineObserver};
use sightline_sample::lines::rounds::Tolerance;
use sightline_trace::cpu::CpuBackend;
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer, least_step};
use sightline_trace::surface::Surface;
use sightline_trace::{CubeSpec, LineSet, Strata, Tracer as _, TracerError};

/// The number of held-out lines per cell.
const HELD: u64 = 20_000;
/// The number of bins of directions along an edge of a cube's face: 96 bins in total.
const BINS: usize = 4;
/// The name of the stream of random numbers for held-out lines.
const STREAM: u64 = 77;

type Answer<T> = Result<T, Box<dyn std::error::Error>>;

/// The cost and the yield of lines of a kind in a round.
#[derive(Clone, Copy, Default)]
struct Spent {
    rays: u64,
    finds: u64,
    time: Duration,
}

/// The attempts at candidates of a class.
#[derive(Clone, Copy, Default)]
struct Tries {
    tries: u64,
    found: u64,
    /// The sum of the fractions of the sphere that the found triangles cover.
    gain: f64,
}

/// Tables of attempts, by the name of the criterion and the class.
type Classes = BTreeMap<(&'static str, u32), Tries>;

struct Account {
    of_tries: bool,
    spent: Mutex<BTreeMap<(u32, usize), Spent>>,
    classes: Mutex<Classes>,
    /// For each cell, the number of attempts at each triangle.
    tried: Vec<Mutex<BTreeMap<u32, u32>>>,
}

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LineObserver for Account {
    fn spent(&self, round: u32, kind: LineKind, rays: u64, finds: u64, time: Duration) {
        let mut all = locked(&self.spent);
        let totals = all.entry((round, kind as usize)).or_default();
        (totals.rays, totals.finds, totals.time) =
            (totals.rays + rays, totals.finds + finds, totals.time + time);
    }

    fn wants_attempts(&self) -> bool {
        self.of_tries
    }

    fn attempted(&self, _: u32, attempt: Attempt) {
        let before = {
            let mut tried = locked(&self.tried[attempt.cell]);
            let count = tried.entry(attempt.triangle.0).or_default();
            *count += 1;
            *count - 1
        };
        let decade = (-attempt.part.log10()).floor().clamp(0.0, 8.0) as u32;
        let mut all = locked(&self.classes);
        for class in [
            ("decade of the part of the sphere", decade),
            ("faces through which a neighbour sees it", attempt.faces),
            ("triangles beside it that the cell sees", attempt.beside),
            ("tries before, in all rounds", before.min(9)),
            (
                "faces, and tries before (10 × faces + tries)",
                10 * attempt.faces + before.min(9),
            ),
        ] {
            let sum = all.entry(class).or_default();
            sum.tries += 1;
            if attempt.found {
                sum.found += 1;
                sum.gain += f64::from(attempt.part);
            }
        }
    }
}

fn main() -> Answer<()> {
    let args: Vec<String> = std::env::args().collect();
    let [_, scene, cells, target] = args.as_slice() else {
        return Err("usage: rays SCENE NXxNYxNZ TARGET".into());
    };
    let scene = Arc::new(sightline_scene::load(scene.as_ref())?);
    let cells: Vec<u32> = cells.split('x').map(str::parse).collect::<Result<_, _>>()?;
    let cells: [u32; 3] = cells.try_into().map_err(|_| {
        "give the numbers of cells along x, y and z, such \
     as 8x8x8"
    })?;
    let target: f64 = target.parse()?;

    let spec = CubeSpec {
        resolution: 8,
        strata: Strata::One,
        keep_pixels: false,
    };
    let backend = CpuBackend::new(Arc::clone(&scene), spec)?;
    let all: Vec<u32> = (0..scene.len())
        .filter(|id| !scene.triangles()[*id as usize].is_degenerate())
        .collect();
    let sight = SightLineTracer::opaque(backend.lines(LineSet::Blocking, &all)?);
    let (surface, rows) = (Surface::new(&scene, &all), Rows::triangles(&scene));
    let bounds = scene.bounds();
    let [nx, ny, _] = cells.map(u64::from);
    let number = |c: [u32; 3]| (u64::from(c[2]) * ny + u64::from(c[1])) * nx + u64::from(c[0]);
    // The block is sampled twice, because recording every attempt costs more time than the attempts.
    for of_tries in [false, true] {
        let grid = CellGrid::new(bounds.min, bounds.max, cells);
        let account = Account {
            of_tries,
            spent: Mutex::default(),
            classes: Mutex::default(),
            tried: (0..grid.count()).map(|_| Mutex::default()).collect(),
        };
        let inputs = BlockInputs {
            scene: &scene,
            surface: &surface,
            rows: &rows,
            sight: &sight,
            seed: 1,
            watcher: &Unwatched,
            deadline: None,
            pairs: None,
            region: None,
            crew: &SoleMember,
            observer: Some(&account),
        };
        let mut block = Block::new(inputs, grid, number, |_| u64::MAX);
        let start = Instant::now();
        block.sample(target, &[], Tolerance::Raised)?;
        if of_tries {
            print_classes(&locked(&account.classes));
            print_missed(&block, &scene, &sight, &surface, &account)?;
        } else {
            let (triangles, cells, seconds) = (
                scene.len(),
                block.grid().count(),
                start.elapsed().as_secs_f64(),
            );
            println!("{triangles} triangles, {cells} cells, target {target}: {seconds:.2} s\n");
            print_spent(&locked(&account.spent));
        }
    }
    Ok(())
}

fn print_spent(spent: &BTreeMap<(u32, usize), Spent>) {
    let whole: Duration = spent.values().map(|s| s.time).sum();
    println!("| round | kind | rays | finds | rays a find | time |\n|--:|---|--:|--:|--:|--:|");
    let mut sums = [Spent::default(); 3];
    let line = |round: &str, kind: usize, s: &Spent| {
        let name = ["uniform", "flood", "candidate"][kind];
        let a_find = s.rays as f64 / s.finds.max(1) as f64;
        let share = 100.0 * s.time.as_secs_f64() / whole.as_secs_f64();
        println!(
            "| {round} | {name} | {} | {} | {a_find:.0} | {share:.1} % |",
            s.rays, s.finds
        );
    };
    for ((round, kind), s) in spent {
        line(&round.to_string(), *kind, s);
        let sum = &mut sums[*kind];
        (sum.rays, sum.finds, sum.time) =
            (sum.rays + s.rays, sum.finds + s.finds, sum.time + s.time);
    }
    sums.iter()
        .enumerate()
        .for_each(|(kind, s)| line("all", kind, s));
    println!();
}

fn print_classes(classes: &Classes) {
    let mut last = "";
    for ((by, class), t) in classes {
        if *by != last {
            println!("\n| {by} | tries | found | part found a try |\n|--:|--:|--:|--:|");
            last = by;
        }
        let found = 100.0 * t.found as f64 / t.tries as f64;
        println!(
            "| {class} | {} | {found:.1} % | {:.2e} |",
            t.tries,
            t.gain / t.tries as f64
        );
    }
    println!();
}

/// The facts about a triangle that a held-out line met.
///
/// The array contains the number of faces through which neighbouring cells see the triangle, the number of
/// the triangle's seen neighbours, and the number of attempts at the triangle.
type Missed = [u32; 3];

/// The numbers of lines by the facts about the met triangle.
type MissedCounts = BTreeMap<Missed, u64>;

/// The misses of a cell by bin of directions, of every second held-out line and of the other lines.
type Directions = [[u64; 6 * BINS * BINS]; 2];

/// Returns the fraction of the misses of the second half of the lines that are in the fifth of the bins with
/// the most misses of the first half, over all cells. The misses of the first half would overestimate the
/// fraction.
fn share_of_fifth(cells: &[Directions]) -> f64 {
    let (mut inside, mut all) = (0, 0);
    for [first, second] in cells {
        let mut bins: Vec<usize> = (0..first.len()).collect();
        bins.sort_by_key(|bin| std::cmp::Reverse(first[*bin]));
        inside += bins[..bins.len() / 5]
            .iter()
            .map(|bin| second[*bin])
            .sum::<u64>();
        all += second.iter().sum::<u64>();
    }
    inside as f64 / (all as f64).max(1.0)
}

fn print_missed(
    block: &Block<'_>,
    scene: &sightline_scene::Scene,
    sight: &SightLineTracer<'_>,
    surface: &Surface,
    account: &Account,
) -> Answer<()> {
    let grid = block.grid();
    let step = least_step(scene.bounds());
    let cells: Vec<[u32; 3]> = grid.each().collect();
    let found: Result<Vec<(MissedCounts, Directions)>, TracerError> = cells
        .par_iter()
        .enumerate()
        .map(|(cell, at)| {
            let slot = grid.slot(*at);
            let mut random = Hashed::new(&[STREAM, cell as u64]);
            let (lo, size) = grid.cell_box(*at);
            let mut missed = BTreeMap::new();
            let mut directions = [[0; 6 * BINS * BINS]; 2];
            let mut bins = Vec::new();
            let mut packets = Vec::new();
            for k in 0..HELD {
                if k.is_multiple_of(LANES as u64) {
                    packets.push(Packet::default());
                }
                let origin = lo + size * random.point();
                let [forward, right, up] = face_basis((k % 6) as u32);
                let (x, y) = (2.0 * random.unit() - 1.0, 2.0 * random.unit() - 1.0);
                let [column, row] =
                    [x, y].map(|at| ((at * 0.5 + 0.5) * BINS as f32) as usize % BINS);
                bins.push(((k % 6) as usize * BINS + row) * BINS + column);
                if let Some(last) = packets.last_mut() {
                    last.push(origin.to_array(), (forward + right * x + up * y).to_array());
                }
            }
            sight.trace_each(&mut packets, &mut Passed::default(), step)?;
            for (number, packet) in packets.iter().enumerate() {
                for (lane, triangle) in packet.triangle[..packet.count].iter().copied().enumerate()
                {
                    if triangle == SKY || block.bits().seen(triangle, slot) {
                        continue;
                    }
                    let line = number * LANES + lane;
                    directions[line / 6 % 2][bins[line]] += 1;
                    let faces = (0..6usize).filter(|face| {
                        let mut next = *at;
                        let axis = face / 2;
                        next[axis] = if face % 2 == 0 {
                            at[axis] + 1
                        } else {
                            at[axis].wrapping_sub(1)
                        };
                        grid.has(next) && block.bits().seen(triangle, grid.slot(next))
                    });
                    let beside = surface.neighbours[triangle as usize]
                        .iter()
                        .filter(|t| **t != SKY);
                    let beside = beside.filter(|t| block.bits().seen(**t, slot)).count() as u32;
                    let tried = locked(&account.tried[cell])
                        .get(&triangle)
                        .copied()
                        .unwrap_or(0);
                    *missed
                        .entry([faces.count() as u32, beside, tried.min(9)])
                        .or_default() += 1;
                }
            }
            Ok((missed, directions))
        })
        .collect();
    let mut all: BTreeMap<Missed, u64> = BTreeMap::new();
    let (found, directions): (Vec<_>, Vec<_>) = found?.into_iter().unzip();
    found
        .into_iter()
        .flatten()
        .for_each(|(key, n)| *all.entry(key).or_default() += n);
    let sum: u64 = all.values().sum();
    let lines = HELD * cells.len() as u64;
    println!(
        "held-out lines: {sum} of {lines} met a triangle outside the set, {:.5} %",
        100.0 * sum as f64 / lines as f64
    );
    println!(
        "the fifth of a cell's directions with the most misses has {:.0} % of the misses of other lines",
        100.0 * share_of_fifth(&directions)
    );
    for (k, by) in [
        "faces through which a neighbour sees it",
        "triangles beside it that are seen",
        "tries",
    ]
    .into_iter()
    .enumerate()
    {
        println!("\n| {by} | of what was missed |\n|--:|--:|");
        let mut by_class: BTreeMap<u32, u64> = BTreeMap::new();
        all.iter()
            .for_each(|(key, n)| *by_class.entry(key[k]).or_default() += n);
        for (class, n) in by_class {
            println!(
                "| {class} | {:.1} % |",
                100.0 * n as f64 / sum.max(1) as f64
            );
        }
    }
    let candidates = |missed: &Missed| missed[0] > 0 && missed[1] > 0;
    let share = |test: &dyn Fn(&Missed) -> bool| {
        100.0
            * all
                .iter()
                .filter(|(key, _)| test(key))
                .map(|(_, n)| n)
                .sum::<u64>() as f64
            / sum.max(1) as f64
    };
    println!(
        "\ncandidates that were tried: {:.1} %",
        share(&|missed| missed[2] > 0)
    );
    println!(
        "candidates that were not tried: {:.1} %",
        share(&|missed| candidates(missed) && missed[2] == 0)
    );
    println!(
        "seen by a neighbour, and next to nothing that is seen: {:.1} %",
        share(&|missed| missed[0] > 0 && missed[1] == 0 && missed[2] == 0)
    );
    println!(
        "next to what is seen, and seen by no neighbour: {:.1} %",
        share(&|missed| missed[0] == 0 && missed[1] > 0 && missed[2] == 0)
    );
    Ok(())
}
