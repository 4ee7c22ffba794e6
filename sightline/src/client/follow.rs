//! The following of a job until it ends, also across restarts of its coordinator.

use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;

use super::endpoint::Endpoint;
use super::job::Job;
use crate::error::Error;
use crate::observer::{Observer, note};
use crate::progress::JobRate;

/// The time between two attempts to reach a coordinator again.
const RECONNECT: Duration = Duration::from_secs(1);

/// Follows a job while the connection exists, and passes each received state of the job to `show`. Returns
/// the last state if the job has ended.
async fn follow_once(
    client: &mut JobsClient<Connection>,
    job: u64,
    show: &mut (dyn FnMut(&Job) + Send),
) -> Result<Option<Job>, tonic::Status> {
    let mut stream = client.watch(v1::ShowRequest { job }).await?.into_inner();
    while let Some(message) = stream.next().await {
        let job = Job::from(message?);
        show(&job);
        if job.message().finished_at_ms > 0 {
            return Ok(Some(job));
        }
    }
    // The coordinator is stopping, and has ended the stream gracefully.
    Ok(None)
}

/// Follows a job of a coordinator in this process until the job ends. Returns the last state of the job.
pub(crate) async fn follow(
    client: &mut JobsClient<Connection>,
    job: u64,
    observer: &dyn Observer,
) -> Result<Job, Error> {
    let mut rate = JobRate::new(true);
    let ended = follow_once(client, job, &mut |job| rate.show(job, observer)).await;
    let ended = ended.map_err(|s| Error::status(&s))?;
    ended.ok_or_else(|| {
        Error::coordinator(
            "the coordinator ended the stream before the job ended; run \
    the same command again",
        )
    })
}

/// Follows a job until it ends, regardless of the number of coordinator restarts in between.
pub(crate) async fn follow_across_restarts(
    mut client: JobsClient<Connection>,
    endpoint: &Endpoint,
    job: u64,
    observer: &dyn Observer,
) -> Result<Job, Error> {
    let mut rate = JobRate::new(false);
    let mut is_reached = false;
    loop {
        let ended = follow_once(&mut client, job, &mut |job| {
            is_reached = true;
            rate.show(job, observer);
        })
        .await;
        match ended {
            Ok(Some(last)) => return Ok(last),
            // If the coordinator is absent at the first attempt, report the error.
            Err(s) if !is_reached || !is_lost(&s) => return Err(Error::status(&s)),
            Ok(None) | Err(_) => {}
        }
        let url = endpoint.url();
        note(
            observer,
            format!(
                "the connection to {url} is lost; the job continues on the farm; connecting again"
            ),
        );
        loop {
            tokio::time::sleep(RECONNECT).await;
            if let Ok(connection) = endpoint.connect().await {
                client = JobsClient::new(connection);
                break;
            }
        }
    }
}

/// Returns true if the connection caused the error, and false if the coordinator answered with it.
fn is_lost(s: &tonic::Status) -> bool {
    std::error::Error::source(s).is_some() || s.code() == tonic::Code::Unavailable
}
