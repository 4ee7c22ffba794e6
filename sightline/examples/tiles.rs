//! Bakes a scene without a coordinator, tile by tile:
//! `cargo run --release -p sightline --example tiles -- SCENE FOLDER OUT.pvs`. On a farm, each machine
//! computes some of the tiles.
#![allow(clippy::print_stdout, reason = "an example")]

use std::path::Path;

use sightline::{Cells, Error, JobOptions, LoadOptions, SceneSource, Silent, read_scene, tiles};

/// Plans the bake of a scene file in a folder, computes the tiles in reverse order, and joins them. Returns
/// the number of tiles.
pub fn bake_in_tiles(scene: &Path, folder: &str, output: &Path) -> Result<u32, Error> {
    let source = SceneSource::File(scene.to_owned());
    let scene = read_scene(&source, &LoadOptions::default(), &Silent)?;
    let options = JobOptions {
        cells: Some(Cells::Grid([4, 2, 4])),
        block_cells: Some(8),
        ..JobOptions::default()
    };
    let job = options.resolve(&scene, &Silent)?;
    let planned = tiles::plan(&scene, &job, folder, &Silent)?;
    // Tiles of a grid that is sampled by sight lines do not depend on other tiles.
    for number in (0..planned.tiles).rev() {
        tiles::run_tile(folder, tiles::TileIndex(number), &Silent)?;
    }
    tiles::assemble(folder, output)?;
    Ok(planned.tiles)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, scene, folder, output] = arguments.as_slice() else {
        return Err("usage: tiles SCENE FOLDER OUT.pvs".into());
    };
    let tiles = bake_in_tiles(Path::new(scene), folder, Path::new(output))?;
    println!("{tiles} tiles");
    Ok(())
}
