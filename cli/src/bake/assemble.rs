//! `sightline assemble`: joins the tiles of a planned bake to a result.

use serde_json::json;
use sightline::{Error, tiles};

use crate::args::tiles::AssembleArgs;
use crate::terminal::stdout::print;

/// Joins the tiles of a planned bake.
pub fn run(args: &AssembleArgs, json: bool) -> Result<(), Error> {
    let assembled = tiles::assemble(&args.dir, &args.output)?;
    if json {
        return print(&json!(assembled).to_string());
    }
    let (name, bytes) = (assembled.output, assembled.bytes);
    print(&format!(
        "wrote {name} ({bytes} bytes); `sightline info {name}` prints a summary"
    ))
}
