//! `sightline show`: prints one job, or its tiles.

use sightline::Error;

use crate::args::remote::ShowArgs;
use crate::jobs::print::show_whole;
use crate::jobs::tiles;
use crate::terminal::progress::Terminal;

/// Prints one job, or its tiles.
pub fn run(args: &ShowArgs, json: bool) -> Result<(), Error> {
    if args.tiles {
        return tiles::show(&args.job.remote, args.job.id, json);
    }
    let client = args.job.remote.client()?;
    let handle = client.job(args.job.id, &Terminal::new())?;
    show_whole(handle.job(), json)
}
