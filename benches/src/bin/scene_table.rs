//! Bakes and measures scenes with the `sightline` program and prints a Markdown table: time, memory, sets, bytes, error.
//!
//! `scene_table SIGHTLINE_PROGRAM BACKENDS CELLS RESOLUTION FILE…`, for example
//! `scene_table target/release/sightline cpu,gpu 8x8x8 256 ../shared/scenes/*.glb`. Each bake starts from an empty store.
//! Times are whole commands on the machine at hand; compare them within one table only.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that prints its result")]

use std::path::Path;
use std::process::{Command, ExitCode};

use serde_json::Value;

/// Viewpoints of the measurement, and their seed.
const VIEWPOINTS: &str = "200";
const SEED: &str = "7";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [program, backends, cells, resolution, files @ ..] = arguments.as_slice() else {
        eprintln!("usage: scene_table SIGHTLINE_PROGRAM BACKENDS CELLS RESOLUTION FILE…");
        return ExitCode::from(2);
    };
    println!("| scene | triangles | backend | s | MB | samples | visible | B/cell | mean | p99 | max |");
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for file in files {
        for backend in backends.split(',') {
            match row(program, backend, cells, resolution, Path::new(file)) {
                Ok(row) => println!("{row}"),
                Err(e) => {
                    eprintln!("{file}, {backend}: {e}");
                    return ExitCode::FAILURE;
                }
            }
        }
    }
    ExitCode::SUCCESS
}

fn row(program: &str, backend: &str, cells: &str, resolution: &str, file: &Path) -> Result<String, String> {
    let folder = std::env::temp_dir().join(format!("sightline-table-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|e| e.to_string())?;
    let result = folder.join("out.pvs");
    let bake = json(
        Command::new(program)
            .arg("bake")
            .arg(file)
            .arg("-o")
            .arg(&result)
            .arg("--data-dir")
            .arg(folder.join("store"))
            .args(["--json", "--cells", cells, "--resolution", resolution, "--backend", backend]),
    );
    let measured = bake.and_then(|bake| {
        let command = json(Command::new(program).arg("measure").arg(file).arg(&result).args([
            "--viewpoints",
            VIEWPOINTS,
            "--seed",
            SEED,
        ]));
        command.map(|measured| (bake, measured))
    });
    std::fs::remove_dir_all(&folder).map_err(|e| e.to_string())?;
    let (bake, measured) = measured?;
    let number =
        |v: &Value, key: &str| v[key].as_f64().ok_or_else(|| format!("the output has no number {key}"));
    let percent = |v: &Value, key: &str| number(v, key).map(|n| format!("{:.3} %", 100.0 * n));
    Ok(format!(
        "| {} | {} | {backend} | {:.1} | {:.0} | {} | {} | {:.0} | {} | {} | {} |",
        file.file_stem().unwrap_or_default().to_string_lossy(),
        number(&bake, "triangles")?,
        number(&bake, "seconds")?,
        number(&bake, "peak_memory_bytes")? / 1e6,
        number(&bake, "samples")?,
        percent(&bake, "mean_visible_fraction")?,
        number(&bake, "bytes_per_cell")?,
        percent(&measured, "mean_error")?,
        percent(&measured, "p99_error")?,
        percent(&measured, "max_error")?,
    ))
}

fn json(command: &mut Command) -> Result<Value, String> {
    let output = command.output().map_err(|e| format!("{command:?} cannot be started: {e}"))?;
    if !output.status.success() {
        return Err(format!(
            "{command:?} ended with {}: {}",
            output.status,
            String::from_utf8_lossy(&output.stderr)
        ));
    }
    serde_json::from_slice(&output.stdout).map_err(|e| e.to_string())
}
