//! Benchmarks of time against error: every sampler from coarse to fine, whole command against whole command.
//!
//! The crate also measures undecided triangles over time, the time of exact cells, and the growth of time and
//! memory. [`run`] bakes and measures, and returns tables. `docs/measure.md` describes the command.
//!
//! # Modules
//!
//! - `options`, `ladder`: the [`Options`] of a benchmark, and the parameters of each [`Sampler`].
//! - `curves`, `repeats`, `children`, `timing`: the points of a scene, each from one or several child
//!   processes.
//! - `frontier`: the time for a given error, interpolated between points and never extrapolated.
//! - `growth`: time and memory by triangles, cells and workers.
//! - `load`, `machine`: the load by other processes, and the facts about the machine.
//! - `table`, `points`, `results`, `csv`, `svg`, `panel`, `axis`, `shapes`: tables and curves.
//!
//! # Invariants
//!
//! - Every point is a bake by a child process. The measuring process only waits, so that it uses no time of
//!   the measured process.
//! - Measured times depend on the machine; compare only times of one run.
//!
//! # Example
//!
//! ```no_run
//! use sightline_bench::{Host, Options};
//!
//! let options = Options { scenes: vec!["level.glb".into()], ..Options::default() };
//! let host = Host { program: "sightline".into(), say: &|line| eprintln!("{line}"), on_stop: &|_| {} };
//! println!("{}", sightline_bench::run(&options, &host)?.tables);
//! # Ok::<(), sightline_bench::BenchError>(())
//! ```

mod axis;
mod children;
mod csv;
mod curves;
mod error;
mod frontier;
mod growth;
mod host;
mod input;
mod ladder;
mod load;
mod machine;
mod options;
mod panel;
mod percent;
mod points;
mod repeats;
mod results;
mod shapes;
mod svg;
mod table;
mod timing;

use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

use crate::curves::SceneCurves;
pub use crate::error::BenchError;
pub use crate::frontier::ERRORS;
use crate::growth::Grown;
pub use crate::host::Host;
use crate::ladder::Shows;
pub use crate::ladder::{Ladder, Rung, Sampler};
use crate::load::Load;
use crate::machine::{MachineFacts, command_line};
pub use crate::options::{Growth, Options};
use crate::percent::percent;

/// The outcome of a benchmark.
#[derive(Clone, Debug)]
pub struct Report {
    /// All measurements as JSON.
    pub document: Value,
    /// The tables in Markdown.
    pub tables: String,
}

/// Runs a benchmark, and writes the files of `args.out` and `args.results`.
///
/// # Errors
/// [`BenchError`] if options are wrong, a bake fails, a file cannot be written, or the user stops the
/// benchmark.
pub fn run(args: &Options, host: &Host<'_>) -> Result<Report, BenchError> {
    args.check()?;
    std::fs::create_dir_all(&args.out).map_err(|e| BenchError::writing(&args.out, &e))?;
    writable(
        &args.out.join("curves.csv"),
        "--out a folder where you may write",
    )?;
    if let Some(page) = &args.results {
        writable(page, "--results a file in a folder where you may write")?;
    }
    let inputs = input::inputs(&args.scenes)?;
    let machine = MachineFacts::here();
    let children = children::Children::new(host);
    warn_if_busy(host);

    let mut scenes = Vec::new();
    if !args.samplers().is_empty() {
        for input in &inputs {
            scenes.push(curves::measure(args, host, &children, input)?);
            // Write the files after every scene, so that later failures do not lose measurements.
            write(host, &args.out.join("curves.csv"), &csv::curves(&scenes)?)?;
            write(host, &args.out.join("curves.svg"), &svg::draw(&scenes))?;
        }
    }
    let mut grown = Vec::new();
    for &grows in &args.grow {
        grown.extend(growth::measure(args, host, &children, &inputs, grows)?);
        write(host, &args.out.join("growth.csv"), &csv::growth(&grown)?)?;
    }
    if let Some(page) = &args.results {
        write(
            host,
            page,
            &results::markdown(args, &machine, load(&scenes, &grown), &scenes, &grown, page),
        )?;
    }
    let mut tables = Vec::new();
    if table::has_errors(&scenes) {
        tables.push(table::needed(&scenes).markdown());
    }
    for scene in &scenes {
        if !scene.showing(Shows::Undecided).is_empty() {
            tables.push(format!(
                "{}\n\n{}",
                scene.scene,
                points::undecided(scene).markdown()
            ));
        }
        if !scene.showing(Shows::CellTime).is_empty() {
            tables.push(format!(
                "{}\n\n{}",
                scene.scene,
                points::cell_times(scene).markdown()
            ));
        }
    }
    if !grown.is_empty() {
        tables.push(table::growth(&grown).markdown());
    }
    let tables = tables.join("\n").trim_end().to_owned();
    Ok(Report {
        document: document(args, &machine, &scenes, &grown)?,
        tables,
    })
}

/// The duration of the measurement of the machine's load before the first bake.
const WATCHED: Duration = Duration::from_millis(500);

/// Warns before the first bake if other processes use the machine.
fn warn_if_busy(host: &Host<'_>) {
    let Some(load) = Load::watch(WATCHED).filter(|load| load.is_busy()) else {
        return;
    };
    (host.say)(&format!(
        "warning: the machine is busy: other processes use {} of all cores (/proc/stat, half a \
         second), so times will be too long; stop these processes, or rely on CPU seconds and --repeat",
        percent(load.share().unwrap_or(0.0))
    ));
}

/// Sums up the load by other processes during all timed bakes.
fn load(scenes: &[SceneCurves], grown: &[Grown]) -> Load {
    let mut sum = Load::default();
    let points = scenes.iter().flat_map(|s| &s.points).map(|p| p.times.load);
    for part in points.chain(grown.iter().map(|g| g.times.load)) {
        sum += part;
    }
    sum
}

/// Checks, before the first bake, that a file can be written.
fn writable(path: &Path, remedy: &str) -> Result<(), BenchError> {
    sightline_files::check(path).map_err(|e| {
        BenchError::Usage(format!(
            "{} cannot be written: {e}; give {remedy}",
            path.display()
        ))
    })
}

fn write(host: &Host<'_>, path: &Path, text: &str) -> Result<(), BenchError> {
    sightline_files::write(path, text).map_err(|e| BenchError::writing(path, &e))?;
    (host.say)(&format!("wrote {}", path.display()));
    Ok(())
}

/// Returns all measurements as one JSON value.
fn document(
    args: &Options,
    machine: &MachineFacts,
    scenes: &[SceneCurves],
    grown: &[Grown],
) -> Result<Value, BenchError> {
    let mut list = Vec::new();
    for scene in scenes {
        let mut value = serde_json::to_value(scene).map_err(BenchError::internal)?;
        let needed = ERRORS.iter().map(|&error| {
            let seconds = scene
                .showing(Shows::Error)
                .into_iter()
                .map(|s| (s.name(), json!(scene.needed(s, error))));
            let seconds: serde_json::Map<_, _> = seconds
                .map(|(name, needed)| (name.to_owned(), needed))
                .collect();
            json!({"mean_error": error, "needed": seconds, "guided_over_lines": scene.ratio(error)})
        });
        value["errors"] = needed.collect();
        list.push(value);
    }
    let means = table::mean_ratios(scenes).into_iter().map(
        |(error, mean, count)| json!({"mean_error": error, "guided_over_lines": mean, "scenes": count}),
    );
    Ok(json!({
        "machine": machine,
        "command_line": command_line(),
        "cells": args.cells,
        "viewpoints": args.viewpoints,
        "seed": args.seed,
        "resolution": args.resolution,
        "repeat": args.repeat,
        "others_share": load(scenes, grown).share(),
        "scenes": list,
        "geometric_mean": means.collect::<Vec<_>>(),
        "growth": grown,
    }))
}
