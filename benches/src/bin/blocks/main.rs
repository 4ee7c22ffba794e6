//! What blocks cost beside one block of everything, and what an exchange of finds between them would save:
//! `blocks SCENE CELLS TARGETS VARIANT...`, for example `blocks level.glb 16x16x8 0.001,0.0003 512 2048`.
//!
//! A variant is a number of cells a block, beyond the limit of a job as well. `512:1,3,6` samples the blocks
//! in step and gives each, after rounds 1, 3 and 6, what lines of other blocks have shown to its cells;
//! `512:all` does so after every round. `512:1,3,6?` also counts which part of the new finds came from other
//! blocks alone, and the packed bytes of all that was sent, which takes time. `512?` samples one block of
//! everything and counts by round which finds came only from lines cast outside the cell's part of 512 cells.
//!
//! The missed share is the mean over cells of the fraction of 4000 held-out lines that meet a triangle
//! outside the cell's set: the same lines for every variant. Rays are those that search, seeds included.
//! Seconds are of all processors. "seen" is the mean size of a set. "same missed" are rays and seconds
//! divided by those of the first variant at the same missed share, between its targets by a straight line
//! through the logarithms.

#![allow(clippy::print_stdout)] // A program for people at a terminal.

mod exchange;

use std::fs::read_to_string;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

use exchange::{Caster, Exchange, Map, Member, Noting, round_of};
use rayon::prelude::*;
use sightline_model::{CellStats, Granularity, SamplingParams};
use sightline_sampling::crew::{Alone, Crew};
use sightline_sampling::embree::CpuBackend;
use sightline_sampling::lines::block::{Block, Tools};
use sightline_sampling::lines::grid::CellGrid;
use sightline_sampling::lines::rounds::Tolerance;
use sightline_sampling::sight::Sight;
use sightline_sampling::{Backend, CubeSpec, LineSet, PreparedScene, Watcher};
use sightline_scene::{Aabb, overlap};
use sightline_viewcells::{Division, Lattice, Layout, Plan, Tile, UNITS_PER_CELL};

type AnyError = Box<dyn std::error::Error + Send + Sync>;

/// Held-out lines of a cell.
const HELD_OUT: u64 = 4000;
/// Above this target no seeds are cast, and phases are counted differently.
const MOST_TARGET: f64 = 0.002;
/// Rounds that a cell has at most.
const MOST_ROUNDS: u32 = 24;

/// Counts rays.
#[derive(Default)]
struct Rays(AtomicU64);

impl Watcher for Rays {
    fn rendered(&self, rays: u64) {
        self.0.fetch_add(rays, Relaxed);
    }
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

/// How the division is sampled.
enum Variant {
    /// Blocks of so many cells that share nothing.
    Apart(u32),
    /// Blocks of so many cells, with an exchange after these rounds.
    InStep {
        cells: u32,
        rounds: Vec<u32>,
        counts: bool,
    },
    /// One block, of which parts of so many cells are told apart.
    Counted(u32),
}

impl Variant {
    fn parse(text: &str) -> Result<Self, AnyError> {
        let (rest, counts) = text
            .strip_suffix('?')
            .map_or((text, false), |rest| (rest, true));
        Ok(match (rest.split_once(':'), counts) {
            (Some((cells, rounds)), counts) => {
                let rounds: Result<_, _> = match rounds {
                    "all" => Ok((1..=MOST_ROUNDS).collect()),
                    some => some.split(',').map(str::parse).collect(),
                };
                Self::InStep {
                    cells: cells.parse()?,
                    rounds: rounds?,
                    counts,
                }
            }
            (None, true) => Self::Counted(rest.parse()?),
            (None, false) => Self::Apart(rest.parse()?),
        })
    }
}

/// The scene and its division.
struct Job<'a> {
    scene: &'a PreparedScene,
    backend: &'a CpuBackend,
    division: Division,
    lattice: Lattice,
    seed: u64,
}

/// What sampling the division took and missed.
#[derive(Default)]
struct Outcome {
    blocks: usize,
    rays: u64,
    stats: Vec<CellStats>,
    seconds: f64,
    /// Size of the sets of all cells, before the held-out lines.
    seen: u64,
    exchanged: Vec<exchange::Counts>,
}

impl Outcome {
    fn sum(&self, of: impl Fn(&CellStats) -> u64) -> u64 {
        self.stats.iter().map(of).sum()
    }

    fn missed(&self) -> f64 {
        self.sum(|s| s.bound_misses) as f64 / self.sum(|s| s.bound_lines).max(1) as f64
    }
}

impl Job<'_> {
    fn plan(&self, cells: u32) -> Vec<Tile> {
        Plan::new(&self.division, &self.lattice, Layout::Blocks(cells)).tiles
    }

    /// The first cell of a tile, and its grid.
    fn grid(&self, tile: &Tile) -> ([u32; 3], CellGrid) {
        let first = tile.cell.lo.map(|u| u / UNITS_PER_CELL);
        let (min, max) = tile.cell.world(&self.lattice);
        let cells = [0, 1, 2].map(|a| tile.cell.hi[a] / UNITS_PER_CELL - first[a]);
        (first, CellGrid::new(min, max, cells))
    }

    /// Samples a tile and calls `end` before its held-out lines.
    fn sample(
        &self,
        tile: &Tile,
        target: f64,
        (sight, crew, rays): (&Sight<'_>, &dyn Crew, &Rays),
        begin: impl FnOnce(&Block<'_>),
        end: impl FnOnce(),
    ) -> Result<(Vec<CellStats>, u64), AnyError> {
        let lines = self.scene.for_lines();
        let tools = Tools {
            scene: lines.scene,
            surface: lines.surface,
            rows: self.scene.fine_rows(Granularity::Triangles),
            sight,
            seed: self.seed,
            watcher: rays,
            deadline: None,
            pairs: None,
            places: None,
            crew,
            ledger: None,
        };
        let (first, grid) = self.grid(tile);
        let whole = self.lattice.units().map(|u| u64::from(u / UNITS_PER_CELL));
        let number = |c: [u32; 3]| {
            let [x, y, z] = [0, 1, 2].map(|a| u64::from(first[a] + c[a]));
            (z * whole[1] + y) * whole[0] + x
        };
        let mut block = Block::new(tools, grid, number, |_| u64::MAX);
        self.credit_meeting(&block, first, lines.shown);
        block.bits_mut().publish();
        begin(&block);
        block.sample(target, &[], Tolerance::Raised)?;
        end();
        let bits = block.bits();
        let row = |id: &u32| {
            bits.row(*id)
                .iter()
                .map(|w| u64::from(w.count_ones()))
                .sum::<u64>()
        };
        let seen = lines.shown.par_iter().map(row).sum();
        block.look(1, HELD_OUT)?;
        Ok((block.stats().to_vec(), seen))
    }

    /// Credits every cell with the triangles that meet it, as a bake does.
    fn credit_meeting(&self, block: &Block<'_>, first: [u32; 3], shown: &[u32]) {
        let cells = block.grid().cells();
        let planes: [Vec<f32>; 3] = [0, 1, 2].map(|a| {
            let at = |k| self.lattice.coordinate(a, (first[a] + k) * UNITS_PER_CELL);
            (0..=cells[a]).map(at).collect()
        });
        let corner = |at: [u32; 3]| glam::Vec3::from([0, 1, 2].map(|a| planes[a][at[a] as usize]));
        let triangles = self.scene.scene().triangles();
        shown.par_iter().with_min_len(1024).for_each(|id| {
            let triangle = &triangles[*id as usize];
            let bounds = triangle.bounds();
            let range = |a: usize| {
                let from = planes[a][1..].partition_point(|p| *p < bounds.min[a]) as u32;
                from..planes[a][..cells[a] as usize].partition_point(|p| *p <= bounds.max[a]) as u32
            };
            let rows = range(2).flat_map(|z| range(1).map(move |y| (z, y)));
            for at in rows.flat_map(|(z, y)| range(0).map(move |x| [x, y, z])) {
                let cell = Aabb {
                    min: corner(at),
                    max: corner(at.map(|c| c + 1)),
                };
                if overlap::triangle_touches_box(triangle, &cell) {
                    let slot = block.grid().slot(at);
                    block.bits().credit(*id, &[(slot.word, 1 << slot.bit)]);
                }
            }
        });
    }

    /// Samples blocks that share nothing.
    fn apart(&self, cells: u32, target: f64) -> Result<Outcome, AnyError> {
        let sight = Sight::new(self.backend, self.scene.traced())?;
        let tiles = self.plan(cells);
        let rays = Rays::default();
        let mut outcome = Outcome {
            blocks: tiles.len(),
            ..Outcome::default()
        };
        let mut seconds = 0.0;
        for tile in &tiles {
            let start = processor_seconds()?;
            let mut end = start;
            let before = rays.0.load(Relaxed);
            let mut cast = before;
            let (stats, seen) = self.sample(
                tile,
                target,
                (&sight, &Alone, &rays),
                |_| {},
                || {
                    end = processor_seconds().unwrap_or(f64::NAN);
                    cast = rays.0.load(Relaxed);
                },
            )?;
            seconds += end - start;
            outcome.rays += cast - before;
            outcome.stats.extend(stats);
            outcome.seen += seen;
        }
        outcome.seconds = seconds;
        Ok(outcome)
    }

    /// Samples blocks in step with an exchange after `rounds`, or one block whose finds are counted by parts.
    fn in_step(
        &self,
        cells: u32,
        (rounds, counts): (Option<&[u32]>, bool),
        target: f64,
    ) -> Result<Outcome, AnyError> {
        let parts = self.plan(cells);
        let grids: Vec<_> = parts.iter().map(|tile| self.grid(tile)).collect();
        let all = self.plan(u32::MAX);
        let (_, whole) = self.grid(all.first().ok_or("there are no cells")?);
        let map = Map::new(&whole, &grids)?;
        let rows = self.scene.fine_rows(Granularity::Triangles).count();
        let tiles = if rounds.is_some() { &parts } else { &all };
        let exchange = Exchange::new(whole, map, rows, tiles.len(), counts);
        let rays = Rays::default();
        let distinct = self.scene.traced().distinct;
        let (start, seconds) = (processor_seconds()?, Mutex::new(f64::INFINITY));
        let run = |(number, tile): (usize, &Tile)| -> Result<(Vec<CellStats>, u64), AnyError> {
            let (min, max) = tile.cell.world(&self.lattice);
            let step = (max - min).max_element() / (1 << 24) as f32;
            let block = rounds.is_some().then_some(number as u32);
            let caster = block.map_or(Caster::Origin, Caster::Block);
            let member = Member::new(&exchange, caster, step, rounds);
            let tracer = self.backend.lines(LineSet::Blocking, distinct)?;
            let sight = Sight::opaque(Box::new(Noting {
                tracer,
                member: &member,
            }));
            let cast = Rays::default();
            self.sample(
                tile,
                target,
                (&sight, &member, &cast),
                |begun| exchange.begin(block, begun.bits(), rows),
                || {
                    rays.rendered(cast.0.load(Relaxed));
                    member.leave();
                    let now = processor_seconds().unwrap_or(f64::NAN) - start;
                    let mut seconds = seconds.lock().unwrap_or_else(PoisonError::into_inner);
                    *seconds = seconds.min(now);
                },
            )
        };
        let run = &run;
        let done: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = tiles
                .iter()
                .enumerate()
                .map(|t| scope.spawn(move || run(t)))
                .collect();
            threads
                .into_iter()
                .map(|t| t.join().unwrap_or_else(|_| Err("a block failed".into())))
                .collect()
        });
        let mut outcome = Outcome {
            blocks: tiles.len(),
            ..Outcome::default()
        };
        for result in done {
            let (stats, seen) = result?;
            outcome.stats.extend(stats);
            outcome.seen += seen;
        }
        outcome.rays = rays.0.load(Relaxed);
        outcome.exchanged = exchange.counts();
        outcome.seconds = *seconds.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(outcome)
    }

    fn run(&self, variant: &Variant, target: f64) -> Result<Outcome, AnyError> {
        match variant {
            Variant::Apart(cells) => self.apart(*cells, target),
            Variant::InStep {
                cells,
                rounds,
                counts,
            } => self.in_step(*cells, (Some(rounds), *counts), target),
            Variant::Counted(cells) => self.in_step(*cells, (None, true), target),
        }
    }
}

/// Seconds that this process has used on all processors; the clock has a hundred ticks a second.
fn processor_seconds() -> Result<f64, AnyError> {
    let stat = read_to_string("/proc/self/stat")?;
    let rest = stat
        .rsplit_once(") ")
        .ok_or("/proc/self/stat has another form")?
        .1;
    let ticks: u64 = rest
        .split(' ')
        .skip(11)
        .take(2)
        .filter_map(|n| n.parse::<u64>().ok())
        .sum();
    Ok(ticks as f64 / 100.0)
}

/// The cost at a missed share, by a curve of missed shares and costs: between its two nearest points, or
/// beyond its last two.
fn cost_at(curve: &[(f64, f64)], missed: f64) -> Option<f64> {
    let mut curve: Vec<_> = curve.iter().map(|(m, r)| (m.ln(), r.ln())).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = missed.ln();
    let upper = curve
        .partition_point(|(m, _)| *m < at)
        .clamp(1, curve.len().checked_sub(1)?.max(1));
    let [(m0, r0), (m1, r1)] = [*curve.get(upper - 1)?, *curve.get(upper)?];
    Some((r0 + (r1 - r0) * (at - m0) / (m1 - m0)).exp())
}

/// Prints by round how many finds there were and which part came from other parts' lines alone.
fn print_rounds(outcome: &Outcome) {
    let (mut sum, mut all) = (exchange::Counts::default(), exchange::Counts::default());
    println!("\n| round | finds | from other parts' lines alone |\n|---|---|---|");
    for (phase, counts) in outcome.exchanged.iter().enumerate() {
        for total in [&mut sum, &mut all] {
            total.all += counts.all;
            total.by_others += counts.by_others;
        }
        if let Some(round) = round_of(phase as u32) {
            println!("| {round} | {} | {} |", sum.all, percent(&sum));
            sum = exchange::Counts::default();
        }
    }
    println!("| all | {} | {} |\n", all.all, percent(&all));
}

fn percent(counts: &exchange::Counts) -> String {
    format!(
        "{:.1} %",
        100.0 * counts.by_others as f64 / counts.all.max(1) as f64
    )
}

fn main() -> Result<(), AnyError> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [path, cells, targets, variants @ ..] = args.as_slice() else {
        return Err("give SCENE CELLS TARGETS VARIANT...".into());
    };
    let cells: Vec<u32> = cells.split('x').map(str::parse).collect::<Result<_, _>>()?;
    let division = Division::Grid(cells.try_into().map_err(|_| "cells are given as 16x16x8")?);
    let mut targets: Vec<f64> = targets
        .split(',')
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    targets.retain(|t| *t <= MOST_TARGET);
    let scene = Arc::new(sightline_scene::load(Path::new(path))?);
    if !scene.kinds().all_opaque() || !scene.sides().are_both() {
        return Err("lines are noted in opaque scenes of two sides only".into());
    }
    let lattice = division.lattice(scene.bounds().min, scene.bounds().max)?;
    let params = SamplingParams::default();
    let backend = CpuBackend::new(Arc::clone(&scene), CubeSpec::of(&params))?;
    let scene = PreparedScene::new(scene)?;
    let job = Job {
        scene: &scene,
        backend: &backend,
        division,
        lattice,
        seed: 0,
    };
    println!(
        "| cells | target | blocks | rays, M | seeds, M | s | missed | seen | same missed: rays | s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut first: [Vec<(f64, f64)>; 2] = Default::default();
    for (number, text) in variants.iter().enumerate() {
        let variant = Variant::parse(text)?;
        let mut outcomes = Vec::new();
        for target in &targets {
            outcomes.push(job.run(&variant, *target)?);
        }
        if number == 0 {
            first = [|o: &Outcome| o.rays as f64, |o: &Outcome| o.seconds]
                .map(|cost| outcomes.iter().map(|o| (o.missed(), cost(o))).collect());
        }
        for (target, o) in targets.iter().zip(&outcomes) {
            let relative = |cost: f64, curve: &[(f64, f64)]| {
                cost_at(curve, o.missed())
                    .map_or_else(|| "-".to_owned(), |c| format!("{:.2}", cost / c))
            };
            let from_cells = o.sum(|s| s.rays[..3].iter().sum());
            println!(
                "| {text} | {target} | {} | {:.2} | {:.2} | {:.1} | {:.3e} | {:.1} | {} | {} |",
                o.blocks,
                o.rays as f64 / 1e6,
                (o.rays - from_cells) as f64 / 1e6,
                o.seconds,
                o.missed(),
                o.seen as f64 / o.stats.len() as f64,
                relative(o.rays as f64, &first[0]),
                relative(o.seconds, &first[1])
            );
            if matches!(variant, Variant::InStep { counts: true, .. }) {
                let gave = |c: &exchange::Counts| {
                    format!("{}, {:.1} MB", percent(c), c.bytes as f64 / 1e6)
                };
                let gave: Vec<String> = o.exchanged.iter().map(gave).collect();
                println!(
                    "New finds given by other blocks, and bytes sent: {}",
                    gave.join("; ")
                );
            }
            if matches!(variant, Variant::Counted(_)) {
                print_rounds(o);
            }
        }
    }
    Ok(())
}
