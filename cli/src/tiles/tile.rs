//! `sightline tile`: computes one tile of a planned bake.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde_json::json;
use sightline_bake::{Alone, BakeError, Control, Inputs, PackBytes, TileDone, Watcher};
use sightline_sampling::CubeSpec;
use sightline_sampling::gpu::AdapterChoice;
use sightline_worker::{Backends, TracedScene, TracerSelection};

use super::place::PlanPlace;
use super::planned::PlannedBake;
use super::tile_file::TileFile;
use crate::error::CliError;
use crate::progress::{Progress, say};
use crate::serve::{self, threads};
use crate::tiles_args::TileArgs;

/// Computes a tile, unless its file exists.
///
/// # Errors
/// [`CliError`].
pub fn tile(args: &TileArgs, json: bool) -> Result<(), CliError> {
    serve::use_threads(threads(None))?;
    let bake = PlannedBake::read(PlanPlace::open(&args.dir)?)?;
    let number = args.number;
    let count = bake.job.plan().tiles.len();
    if number as usize >= count {
        return Err(CliError::Usage(format!(
            "there is no tile {number}: the plan has {count}, numbered from 0"
        )));
    }
    let name = bake.place.name(&PlannedBake::file(number));
    match bake.tile(number)? {
        Some(Ok(there)) => return report(&bake, &there, false, json),
        Some(Err(e)) => say(&format!("note: {name}: {e}; it is computed again")),
        None => {}
    }
    let packs = needed(&bake, number)?;
    let done = compute(&bake, number, &packs)?;
    let file = TileFile {
        bake: bake.identity(),
        tile: number,
        samples: done.samples,
        output: done.bytes,
    };
    bake.place
        .write(&PlannedBake::file(number), file.encode())?;
    report(&bake, &file, true, json)
}

fn report(bake: &PlannedBake, tile: &TileFile, computed: bool, json: bool) -> Result<(), CliError> {
    let (name, bytes) = (
        bake.place.name(&PlannedBake::file(tile.tile)),
        tile.output.len(),
    );
    if json {
        let value = json!({
            "tile": tile.tile, "output": name, "computed": computed, "samples": tile.samples, "bytes": bytes,
        });
        return serve::print(&value.to_string());
    }
    let how = match computed {
        true => "computed",
        false => "was there already",
    };
    serve::print(&format!(
        "{name}: {how}, {} samples, {bytes} bytes",
        tile.samples
    ))
}

/// Reads the outputs of the tiles that a tile needs.
fn needed(bake: &PlannedBake, number: u32) -> Result<Vec<Vec<u8>>, CliError> {
    let needs = &bake.job.plan().tiles[number as usize].needs;
    let mut absent = Vec::new();
    let mut packs = Vec::with_capacity(needs.len());
    for &need in needs {
        match bake.tile(need)? {
            Some(Ok(tile)) => packs.push(tile.output),
            Some(Err(e)) => {
                return Err(CliError::Input(format!(
                    "{}, which tile {number} needs: {e}; `sightline tile DIR {need}` computes it again",
                    bake.place.name(&PlannedBake::file(need))
                )));
            }
            None => absent.push(need.to_string()),
        }
    }
    match absent.is_empty() {
        true => Ok(packs),
        false => Err(CliError::Input(format!(
            "tile {number} needs tiles that are absent: {}; compute them first",
            absent.join(", ")
        ))),
    }
}

/// The progress of a tile.
#[derive(Default)]
struct Counts {
    cells: AtomicU64,
}

impl Watcher for Counts {
    fn rendered(&self, _samples: u64) {}

    fn cell_done(&self) {
        self.cells.fetch_add(1, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        false
    }
}

fn compute(bake: &PlannedBake, number: u32, packs: &[Vec<u8>]) -> Result<TileDone, CliError> {
    let scene = Arc::new(bake.scene()?);
    let loaded = TracedScene::new(scene).map_err(CliError::internal)?;
    let tracer = match bake.task()?.sampling() {
        Some(sampling) => {
            let backends = Backends::probe(selection(&bake.profile), AdapterChoice::default());
            if !backends.profiles().contains(&bake.profile) {
                return Err(CliError::Input(format!(
                    "the plan is for {}, and this machine has: {}; compute the tile on a machine like the \
                     one that planned it, or plan the bake here",
                    bake.profile,
                    backends.profiles().join(", ")
                )));
            }
            let cubes = CubeSpec::of(&sampling.sampler);
            let tracer = loaded.backend(&backends, &bake.profile, cubes, "");
            Some(tracer.map_err(CliError::internal)?)
        }
        None => None,
    };
    let packs: Vec<PackBytes<'_>> = packs
        .iter()
        .map(|bytes| PackBytes::Present(bytes))
        .collect();
    let inputs = Inputs {
        tracer: tracer.as_deref(),
        ..Inputs::new(&loaded.scene).with_packs(&packs)
    };
    let (counts, progress) = (Counts::default(), Progress::new());
    let cells = bake.job.plan().tiles[number as usize].cells;
    let done = std::thread::scope(|scope| {
        let tile = scope.spawn(|| {
            let control = Control {
                watcher: &counts,
                deadline: None,
                crew: &Alone,
            };
            sightline_bake::run(&bake.job, number, inputs, control)
        });
        while !tile.is_finished() {
            if cells > 0 {
                progress.count(counts.cells.load(Ordering::Relaxed), cells, "cells");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        tile.join()
    });
    progress.end();
    let done = done.map_err(|_| CliError::Internal("computing the tile panicked".to_owned()))?;
    done.map_err(|e| match e {
        BakeError::Cancelled | BakeError::Backend(_) => CliError::internal(e),
        BakeError::Tile(_) => CliError::Job(e.to_string()),
    })
}

/// Returns the kind of backend that has a profile.
fn selection(profile: &str) -> TracerSelection {
    match profile.starts_with("gpu/") {
        true => TracerSelection::Gpu,
        false => TracerSelection::Cpu,
    }
}
