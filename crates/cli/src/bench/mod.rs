//! `sightline bench`: time against error, whole command against whole command, and how both grow.
//!
//! Every point is a bake by a child process; this process only waits, so that it takes nothing from what it times.

pub mod args;
mod children;
mod csv;
mod curves;
mod frontier;
mod growth;
mod ladder;
mod machine;
mod results;
mod svg;
mod table;

use std::path::Path;

use serde_json::{Value, json};

use crate::bench::args::BenchArgs;
use crate::bench::curves::SceneCurves;
use crate::bench::frontier::ERRORS;
use crate::bench::growth::Grown;
use crate::bench::machine::{Machine, command_line};
use crate::error::CliError;
use crate::progress::say;
use crate::serve::print;

/// Measures, writes the files, prints the tables.
pub fn run(args: &BenchArgs, json: bool) -> Result<(), CliError> {
    args.check()?;
    std::fs::create_dir_all(&args.out).map_err(|e| CliError::writing(&args.out, &e))?;
    if let Some(page) = &args.results {
        writable(page)?;
    }
    let inputs = curves::inputs(&args.scenes)?;
    let machine = Machine::here();
    let children = children::Children::new()?;

    let mut scenes = Vec::new();
    if !args.samplers().is_empty() {
        for input in &inputs {
            scenes.push(curves::measure(args, &children, input)?);
            // After every scene: what is measured by then survives what happens next.
            write(&args.out.join("curves.csv"), &csv::curves(&scenes))?;
            write(&args.out.join("curves.svg"), &svg::draw(&scenes))?;
        }
    }
    let mut grown = Vec::new();
    for &grows in &args.grow {
        grown.extend(growth::measure(args, &children, &inputs, grows)?);
        write(&args.out.join("growth.csv"), &csv::growth(&grown))?;
    }
    if let Some(page) = &args.results {
        write(page, &results::markdown(args, &machine, &scenes, &grown, page))?;
    }
    if json {
        return print(&document(args, &machine, &scenes, &grown)?.to_string());
    }
    let mut tables = Vec::new();
    if !scenes.is_empty() {
        tables.push(table::needed(&scenes).markdown());
    }
    if !grown.is_empty() {
        tables.push(table::growth(&grown).markdown());
    }
    print(tables.join("\n").trim_end())
}

/// Refuses a page that cannot be written before bakes are spent on it.
fn writable(page: &Path) -> Result<(), CliError> {
    let folder = page.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if page.is_dir() || !folder.is_dir() {
        return Err(CliError::Usage(format!(
            "{} cannot be written; give --results a file in a folder that exists",
            page.display()
        )));
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    std::fs::write(path, text).map_err(|e| CliError::writing(path, &e))?;
    say(&format!("wrote {}", path.display()));
    Ok(())
}

/// Everything as one value.
fn document(
    args: &BenchArgs,
    machine: &Machine,
    scenes: &[SceneCurves],
    grown: &[Grown],
) -> Result<Value, CliError> {
    let mut list = Vec::new();
    for scene in scenes {
        let mut value = serde_json::to_value(scene).map_err(CliError::internal)?;
        let needed = ERRORS.iter().map(|&error| {
            let seconds =
                scene.samplers.iter().map(|&s| (s.name().to_owned(), json!(scene.needed(s, error))));
            let seconds: serde_json::Map<_, _> = seconds.collect();
            json!({"mean_error": error, "needed": seconds, "guided_over_lines": scene.ratio(error)})
        });
        value["errors"] = needed.collect();
        list.push(value);
    }
    let means = table::mean_ratios(scenes)
        .into_iter()
        .map(|(error, mean, of)| json!({"mean_error": error, "guided_over_lines": mean, "scenes": of}));
    Ok(json!({
        "machine": machine,
        "command_line": command_line(),
        "cells": args.cells,
        "viewpoints": args.viewpoints,
        "seed": args.seed,
        "resolution": args.resolution,
        "scenes": list,
        "geometric_mean": means.collect::<Vec<_>>(),
        "growth": grown,
    }))
}
