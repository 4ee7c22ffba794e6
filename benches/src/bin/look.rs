//! Measures the cost of exact sets from points:
//! `look SCENE… [--points N] [--seed S] [--check] [--skip-cells]`.
//!
//! For each scene, the program measures the time to build the cells. From random points of the scene's box
//! outside closed solids, it measures the time, the cells and the beams per point, with both engines and in
//! all modes. For comparison, the program renders six item buffers of 512² pixels with Embree from the same
//! points. The program also compares all sets: both engines must agree, and aggressive ⊆ exact ⊆ conservative
//! must hold. Finally, the program compares a box's visible share with rays to the box. One thread does all
//! work except the build. Times are means; ratios are ratios of whole runs. The output is a Markdown table.

#![allow(clippy::print_stdout, reason = "a program for people at a terminal")]

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use glam::Vec3;
use sightline_numbers::random::SplitMix64;
use sightline_scene::{Scene, TriangleId};
use sightline_tetra::check::check;
use sightline_tetra::file::write;
use sightline_tetra::{Engine, Mode, Quiet, Scratch, Target, Tets, View, build};
use sightline_trace::embree::EmbreeBackend;
use sightline_trace::packet::{Halves, LANES, Packet};
use sightline_trace::{CubeSpec, LineSet, Strata, Tracer as _};

type AnyError = Box<dyn std::error::Error + Send + Sync>;

#[derive(Parser)]
struct Args {
    /// Scenes: .obj, .ply, .gltf or .glb.
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Number of points per scene.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..))]
    points: u32,
    /// Seed of the points.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The angle of the modes aggressive and conservative, in degrees.
    #[arg(long, default_value_t = 0.2)]
    angle: f64,
    /// Check the cells as `sightline tetra --check` does, and print the duration.
    #[arg(long)]
    check: bool,
    /// Skip the engine that traverses cells.
    #[arg(long)]
    skip_cells: bool,
}

fn main() -> Result<(), AnyError> {
    let args = Args::parse();
    for path in &args.scenes {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let scene = Arc::new(sightline_scene::load(path)?);
        let start = Instant::now();
        let built = build(&scene, &Quiet)?;
        let seconds = start.elapsed().as_secs_f64();
        let mut file = Vec::new();
        write(&mut file, &built.contents())?;
        println!("\n### {name}\n");
        println!(
            "{} triangles, {} Delaunay tetrahedra, {} cut, {} cells, {} added vertices, {:.2} cells a \
             triangle, {:.2} % of {} signs in integers; built in {seconds:.1} s; {:.0} MB\n",
            scene.len(),
            built.tetrahedra,
            built.counts.cut,
            built.cells.view().cell_count(),
            built.cells.meets.len(),
            built.cells.view().cell_count() as f64 / f64::from(scene.len()),
            100.0 * built.counts.decisions.integers as f64
                / built.counts.decisions.all.max(1) as f64,
            built.counts.decisions.all,
            file.len() as f64 / 1e6
        );
        if args.check {
            let start = Instant::now();
            check(&built.contents())?;
            println!("checked in {:.1} s\n", start.elapsed().as_secs_f64());
        }
        drop(built);
        let tets = Tets::from_bytes(&file)?;
        drop(file);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        pool.install(|| measured(&args, &scene, &tets))?;
    }
    Ok(())
}

/// Draws random points of the scene's box that are in no closed solid.
fn points(args: &Args, scene: &Scene, tets: &Tets) -> Result<Vec<Vec3>, AnyError> {
    let (mut stream, mut scratch, mut out) =
        (SplitMix64::new(args.seed), Scratch::default(), Vec::new());
    let bounds = scene.bounds();
    let mut tries = 0u64;
    while out.len() < args.points as usize {
        tries += 1;
        if tries > 1000 * u64::from(args.points) {
            return Err(
                "fewer than one in 1000 points of the scene's box is outside of closed solids; \
             choose another scene"
                    .into(),
            );
        }
        let part = Vec3::new(stream.unit_f32(), stream.unit_f32(), stream.unit_f32());
        let x = bounds.min + (bounds.max - bounds.min) * part;
        if !tets.inside(x.as_dvec3().to_array(), &mut scratch)? {
            out.push(x);
        }
    }
    Ok(out)
}

fn measured(args: &Args, scene: &Arc<Scene>, tets: &Tets) -> Result<(), AnyError> {
    let points = points(args, scene, tets)?;
    let spec = CubeSpec {
        resolution: 512,
        strata: Strata::One,
        keep_pixels: false,
    };
    let embree = EmbreeBackend::new(scene.clone(), spec)?;
    let renderer = embree.prepare(None)?;
    // The first image allocates memory, so it is not timed.
    renderer.image(points[0])?;
    let start = Instant::now();
    let mut drawn = 0usize;
    for x in &points {
        let mut ids = renderer.image(*x)?.ids;
        ids.sort_unstable();
        ids.dedup();
        drawn += ids.len();
    }
    let buffers = start.elapsed().as_secs_f64() / points.len() as f64;
    println!(
        "| mode | engine | ms | of buffers | seen | µs a triangle seen | cells or boxes | beams | dropped |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    println!(
        "| six item buffers | Embree | {:.1} | 1 | {:.0} | | | | |",
        buffers * 1e3,
        drawn as f64 / points.len() as f64
    );
    let angle = args.angle.to_radians();
    let modes = [
        ("exact".to_owned(), Mode::Exact),
        (
            format!("aggressive {}°", args.angle),
            Mode::Aggressive(angle),
        ),
        (
            format!("conservative {}°", args.angle),
            Mode::Conservative(angle),
        ),
    ];
    let mut scratch = Scratch::default();
    // The other sets are compared with the exact sets by boxes.
    let mut exact: Vec<Vec<u32>> = Vec::new();
    for (name, mode) in &modes {
        for (by, engine) in [("bvh", Engine::Boxes), ("tetra", Engine::Cells)] {
            if args.skip_cells && engine == Engine::Cells {
                continue;
            }
            let view = View {
                engine,
                ..View::default()
            };
            tets.look(points[0].as_dvec3().to_array(), &view, *mode, &mut scratch)?;
            let (mut seen, mut cells, mut beams, mut dropped) = (0usize, 0u64, 0u64, 0.0);
            let start = Instant::now();
            let mut sets = Vec::with_capacity(points.len());
            for x in &points {
                let found = tets.look(x.as_dvec3().to_array(), &view, *mode, &mut scratch)?;
                seen += found.visible.len();
                cells += found.cells;
                beams += found.beams;
                dropped += found.dropped;
                sets.push(found.visible.clone());
            }
            let seconds = start.elapsed().as_secs_f64();
            if exact.is_empty() {
                exact = sets.clone();
            }
            let within = |a: &[u32], b: &[u32]| a.iter().all(|id| b.binary_search(id).is_ok());
            for ((set, exact), x) in sets.iter().zip(&exact).zip(&points) {
                let holds = match mode {
                    Mode::Exact => set == exact,
                    Mode::Aggressive(_) => within(set, exact),
                    Mode::Conservative(_) => within(exact, set),
                };
                if !holds {
                    return Err(format!(
                        "{name} with the engine {by} from {x}: the set contradicts the exact set \
                         of the engine bvh"
                    )
                    .into());
                }
            }
            let per_point = |sum: f64| sum / points.len() as f64;
            println!(
                "| {name} | {by} | {:.1} | {:.2} | {:.0} | {:.1} | {:.0} | {:.0} | {:.1e} |",
                per_point(seconds) * 1e3,
                per_point(seconds) / buffers,
                per_point(seen as f64),
                seconds * 1e6 / seen.max(1) as f64,
                per_point(cells as f64),
                per_point(beams as f64),
                per_point(dropped)
            );
        }
    }
    targets(args, scene, tets, &points, &embree)
}

/// Measures the visibility of boxes from the points. The side of a box is a hundredth of the scene's largest
/// side. Compares the visible shares of the boxes with rays to random points in the boxes.
fn targets(
    args: &Args,
    scene: &Scene,
    tets: &Tets,
    points: &[Vec3],
    embree: &EmbreeBackend,
) -> Result<(), AnyError> {
    let ids: Vec<u32> = (0..scene.len())
        .filter(|id| scene.blocks(TriangleId(*id)))
        .collect();
    let tracer = embree.lines(LineSet::Blocking, &ids)?;
    let (bounds, mut stream) = (scene.bounds(), SplitMix64::new(args.seed + 1));
    let extent = bounds.max - bounds.min;
    let half = Vec3::splat(extent.max_element() / 200.0);
    let mut unit = || Vec3::new(stream.unit_f32(), stream.unit_f32(), stream.unit_f32());
    let boxes: Vec<(Vec3, Vec3)> = points
        .iter()
        .map(|x| (*x, bounds.min + extent * unit()))
        .collect();
    println!("\n| a box's share | µs | shown | mean difference from the share |");
    println!("|---|---|---|---|");
    let mut scratch = Scratch::default();
    let mut exact = Vec::new();
    for (by, engine) in [("bvh", Engine::Boxes), ("tetra", Engine::Cells)] {
        if args.skip_cells && engine == Engine::Cells {
            continue;
        }
        exact.clear();
        let start = Instant::now();
        for (x, middle) in &boxes {
            let [low, high] = [*middle - half, *middle + half].map(|p| p.as_dvec3().to_array());
            let view = View {
                engine,
                ..View::default()
            };
            let x = x.as_dvec3().to_array();
            exact.push(tets.sees_in(x, &Target { low, high }, &view, Mode::Exact, &mut scratch)?);
        }
        let micros = start.elapsed().as_secs_f64() * 1e6 / boxes.len() as f64;
        let shown = exact.iter().filter(|s| **s > 0.0).count();
        println!(
            "| exact, {by} | {micros:.0} | {shown} of {} | |",
            boxes.len()
        );
    }
    for rays in [64usize, 1024] {
        let (mut apart, mut shown) = (0.0, 0);
        let mut took = 0.0;
        for ((x, middle), share) in boxes.iter().zip(&exact) {
            let mut packets = vec![Packet::default(); rays / LANES];
            let ends: Vec<Vec3> = (0..rays)
                .map(|_| *middle - half + half * 2.0 * unit())
                .collect();
            let start = Instant::now();
            for (packet, ends) in packets.iter_mut().zip(ends.chunks(LANES)) {
                ends.iter()
                    .for_each(|end| packet.push(x.to_array(), (*end - *x).to_array()));
                packet.distance = [1.0; LANES];
            }
            tracer.trace(&mut packets, Halves::Rays, false)?;
            let free = packets
                .iter()
                .flat_map(|p| p.distance)
                .filter(|d| *d >= 1.0)
                .count();
            took += start.elapsed().as_secs_f64();
            apart += (free as f64 / rays as f64 - share).abs();
            shown += usize::from(free > 0);
        }
        let per_box = |sum: f64| sum / boxes.len() as f64;
        println!(
            "| {rays} rays | {:.0} | {shown} of {} | {:.3} |",
            per_box(took) * 1e6,
            boxes.len(),
            per_box(apart)
        );
    }
    Ok(())
}
