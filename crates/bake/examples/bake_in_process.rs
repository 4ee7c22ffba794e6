//! Bakes one tile of a generated scene in this process and prints the size of each cell's set.
//!
//! `cargo run --release -p sightline-bake --example bake_in_process`

#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::sync::Arc;

use sightline_bake::{BakeScene, Control, Inputs, SoleMember, Watcher, run};
use sightline_model::{
    CellSets, GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling, TileOutput,
    codec,
};
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_trace::CubeSpec;
use sightline_trace::cpu::CpuBackend;
use sightline_viewcells::TileIndex;

/// A watcher that ignores progress and never cancels the tile.
struct Unwatched;

impl Watcher for Unwatched {
    fn rendered(&self, _samples: u64) {}
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

/// Bakes the first tile of a scene of a few rooms, with 4×2×4 cells over the scene's bounds.
///
/// # Errors
/// Returns an error if the bake fails.
pub fn bake() -> Result<CellSets, Box<dyn Error>> {
    let params = SceneParams {
        triangles: Some(2000),
        ..SceneParams::default()
    };
    let scene = Arc::new(generate(SceneKind::Rooms, &params)?);
    // The defaults: sight lines, a target error of 0.0001, blocks of up to 512 cells, so the job has one
    // tile.
    let cells = KnownCells::Grid(GridCells::new(scene.bounds(), [4, 2, 4])?);
    let sampling = Sampling::new(Sampler::lines(cells));
    let backend = CpuBackend::new(
        Arc::clone(&scene),
        CubeSpec::from_sampler(&sampling.sampler),
    )?;
    let job = PlannedJob::new(JobSpec::new(scene.digest().0, Method::aggressive(sampling)))?;
    let control = Control {
        watcher: &Unwatched,
        deadline: None,
        crew: &SoleMember,
    };
    let prepared = BakeScene::new(Arc::clone(&scene))?;
    let done = run(
        &job,
        TileIndex(0),
        Inputs::new(&prepared).with_tracer(&backend),
        control,
    )?;
    // A worker sends these bytes to its coordinator. This example decodes them at once.
    match codec::decode(&done.bytes, scene.len())? {
        TileOutput::Cells(cells) => Ok(cells),
        TileOutput::Pack(_) => Err("only tiles of visibility cubes have packs".into()),
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    for (number, cell) in bake()?.cells.iter().enumerate() {
        println!("cell {number}: {} triangles", cell.visible.len());
    }
    Ok(())
}
