//! Following a job until it ends, also across restarts of its coordinator.

use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;

use super::endpoint::Endpoint;
use super::job::Job;
use crate::error::Error;
use crate::observer::{Observer, note};
use crate::progress::JobRate;

/// Time between two attempts to reach a coordinator again.
const RECONNECT: Duration = Duration::from_secs(1);

/// Follows a job while the connection holds; returns its last state if it has ended.
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
    // The coordinator is stopping, and had time to end the stream.
    Ok(None)
}

/// Follows a job of a coordinator in this process until it ends; returns its last state.
pub(crate) async fn follow(
    client: &mut JobsClient<Connection>,
    job: u64,
    observer: &dyn Observer,
) -> Result<Job, Error> {
    let mut rate = JobRate::new(true);
    let ended = follow_once(client, job, &mut |job| rate.show(job, observer)).await;
    let ended = ended.map_err(|s| Error::status(&s))?;
    ended.ok_or_else(|| Error::coordinator("the coordinator ended the stream before the job"))
}

/// Follows a job until it ends, however often the coordinator restarts in between.
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
            // The first attempt reports a coordinator that is absent.
            Err(s) if !is_reached || !is_lost(&s) => return Err(Error::status(&s)),
            Ok(None) | Err(_) => {}
        }
        let url = endpoint.url();
        note(
            observer,
            format!("the connection to {url} is lost; the job continues there: connecting again"),
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

/// Returns true if an error is one of the connection.
fn is_lost(s: &tonic::Status) -> bool {
    std::error::Error::source(s).is_some() || s.code() == tonic::Code::Unavailable
}
