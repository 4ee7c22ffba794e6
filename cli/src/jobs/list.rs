//! `sightline jobs`: lists the jobs of a coordinator.

use sightline::{Error, JobFilter};

use crate::args::remote::JobsArgs;
use crate::jobs::print::listing;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Lists jobs in ascending order of their numbers, and prints the command that lists the older ones.
pub fn run(args: &JobsArgs, json: bool) -> Result<(), Error> {
    let filter = JobFilter {
        limit: (!args.all).then_some(args.limit),
        before: args.before,
        states: args.states.clone(),
        name: args.name.clone(),
        user: args.user.clone(),
    };
    let list = args.remote.client()?.jobs(&filter, &Terminal::new())?;
    if json {
        print(&serde_json::json!(list.jobs).to_string())?;
    } else {
        list.jobs.iter().try_for_each(|j| print(&listing(j)))?;
    }
    if let Some(first) = list.jobs.first().filter(|_| list.has_older) {
        let id = first.id();
        say(&format!(
            "the coordinator has older jobs: `sightline jobs --before {id}` lists these jobs, --all lists \
             all jobs"
        ));
    }
    Ok(())
}
