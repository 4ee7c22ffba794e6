//! `sightline cancel`, `pause`, `resume`, `retry` and `delete`: change a job's state.

use sightline::{Error, JobAction};

use crate::args::remote::JobRefArgs;
use crate::jobs::print::show_job;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Cancels, pauses, resumes, retries or deletes a job.
pub fn run(args: &JobRefArgs, action: JobAction, json: bool) -> Result<(), Error> {
    let client = args.remote.client()?;
    let job = client.act(args.id, action, &Terminal::new())?;
    if action == JobAction::Delete && !json {
        return print(&format!("job {} is deleted", job.id()));
    }
    show_job(&job, json)
}
