//! `sightline invalidate`: makes a coordinator compute tiles again.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use sightline::Error;
use sightline_proto::v1;

use crate::args::remote::InvalidateArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Makes the coordinator compute tiles again whose results are not trusted.
pub fn run(args: &InvalidateArgs, json: bool) -> Result<(), Error> {
    if let (Some(since), Some(until)) = (args.since, args.until)
        && since <= until
    {
        let text =
            "--since must be a longer duration than --until, because both count back from now";
        return Err(Error::usage(text.to_owned()));
    }
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_err(Error::internal)?;
    let ago = |time: Duration| now.saturating_sub(time).as_millis() as u64;
    let request = v1::InvalidateRequest {
        job: args.id,
        tiles: args.tiles.clone(),
        worker: args.worker.clone().unwrap_or_default(),
        from_ms: args.since.map(ago),
        to_ms: args.until.map(ago),
    };
    let jobs = args
        .remote
        .client()?
        .invalidate(request, &Terminal::new())?;
    if json {
        let job = |job: &v1::InvalidatedJob| json!({"job": job.job, "tiles": job.tiles});
        return print(&Value::from_iter(jobs.iter().map(job)).to_string());
    }
    if jobs.is_empty() {
        return print(
            "no finished tile matches the selection; `sightline show JOB --tiles` lists the \
         tiles and their workers",
        );
    }
    jobs.iter().try_for_each(|job| {
        print(&format!(
            "job {}: {} tiles are computed again",
            job.job, job.tiles
        ))
    })
}
