//! `sightline tile`: computes one tile of a planned bake.

use serde_json::json;
use sightline::tiles::TileIndex;
use sightline::{Error, tiles};

use crate::args::tiles::TileArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Computes a tile, unless a complete file of the tile exists.
pub fn run(args: &TileArgs, json: bool) -> Result<(), Error> {
    let terminal = Terminal::new();
    let tile = tiles::run_tile(&args.dir, TileIndex(args.number), &terminal)?;
    terminal.end();
    if json {
        return print(&json!(tile).to_string());
    }
    let how = match tile.computed {
        true => "computed",
        false => "exists already",
    };
    let (samples, bytes) = (tile.samples, tile.bytes);
    print(&format!(
        "{}: {how}, {samples} samples, {bytes} bytes",
        tile.output
    ))
}
