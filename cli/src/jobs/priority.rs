//! `sightline priority`: changes the priority of a job.

use sightline::Error;

use crate::args::remote::PriorityArgs;
use crate::jobs::print::show_job;
use crate::terminal::progress::Terminal;

/// Changes the priority of a job.
pub fn run(args: &PriorityArgs, json: bool) -> Result<(), Error> {
    let client = args.job.remote.client()?;
    let job = client.prioritize(args.job.id, args.priority, &Terminal::new())?;
    show_job(&job, json)
}
