//! `sightline watch`: follows a job until it ends.

use sightline::Error;

use crate::args::remote::JobRefArgs;
use crate::jobs::print::{ending, show_job};
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;

/// Follows a job until it ends, and prints its final state.
pub fn run(args: &JobRefArgs, json: bool) -> Result<(), Error> {
    let (client, terminal) = (args.remote.client()?, Terminal::new());
    let mut handle = client.job(args.id, &terminal)?;
    let job = handle.wait(&terminal)?;
    terminal.end();
    say(&ending(job));
    show_job(job, json)?;
    job.ensure_done()
}
