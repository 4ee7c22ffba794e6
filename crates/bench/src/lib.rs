//! Time against error: every sampler from coarse to fine, whole command against whole command; undecided
//! triangles over time; the time of exact cells; and how time and memory grow.
//!
//! Every point is a bake by a child process. The process that measures only waits, so that it takes no time
//! from what it measures. Measured times depend on the machine; compare those of one run.
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
use crate::machine::{Machine, command_line};
pub use crate::options::{Growth, Options};
use crate::percent::percent;

/// The outcome of a benchmark.
#[derive(Clone, Debug)]
pub struct Report {
    /// Everything that was measured.
    pub document: Value,
    /// The tables in Markdown.
    pub tables: String,
}

/// Measures, and writes the files of `args.out` and `args.results`.
///
/// # Errors
/// [`BenchError`]: wrong options, a bake that failed, a file that cannot be written, or a stop.
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
    let machine = Machine::here();
    let children = children::Children::new(host);
    warn_if_busy(host);

    let mut scenes = Vec::new();
    if !args.samplers().is_empty() {
        for input in &inputs {
            scenes.push(curves::measure(args, host, &children, input)?);
            // After every scene: what is measured by then survives what happens next.
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

/// How long the machine is watched before the first bake.
const WATCHED: Duration = Duration::from_millis(500);

/// Says so before bakes are spent on a machine that has other work.
fn warn_if_busy(host: &Host<'_>) {
    let Some(load) = Load::watch(WATCHED).filter(|load| load.is_busy()) else {
        return;
    };
    (host.say)(&format!(
        "warning: the machine is busy: other processes take {} of all cores (/proc/stat, half a second), so \
         times will be too long; stop them, or rely on CPU seconds and --repeat",
        percent(load.share().unwrap_or(0.0))
    ));
}

/// What others took of the machine during all bakes that were timed.
fn load(scenes: &[SceneCurves], grown: &[Grown]) -> Load {
    let mut sum = Load::default();
    let points = scenes.iter().flat_map(|s| &s.points).map(|p| p.times.load);
    for part in points.chain(grown.iter().map(|g| g.times.load)) {
        sum += part;
    }
    sum
}

/// Checks that a file can be written, before bakes are spent on it.
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

/// Everything as one value.
fn document(
    args: &Options,
    machine: &Machine,
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
        |(error, mean, of)| json!({"mean_error": error, "guided_over_lines": mean, "scenes": of}),
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
