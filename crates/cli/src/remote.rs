//! The commands of a client that already has jobs: watch, jobs, show, cancel, pause, resume, retry, priority,
//! fetch; and health.

use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use tonic::transport::Channel;

use crate::client;
use crate::error::CliError;
use crate::farm;
use crate::output::{Format, Output};
use crate::progress::say;
use crate::remote_args::{FetchArgs, JobRefArgs, JobsArgs, PriorityArgs, RemoteArgs, ShowArgs};
use crate::serve::{print, runtime};
use crate::showing::{ending, listed, show_job, show_whole, value};

/// A change of a job's state.
#[derive(Clone, Copy)]
pub enum Turn {
    /// End it.
    Cancel,
    /// Grant no more tiles.
    Pause {
        /// Stop those at work, too.
        now: bool,
    },
    /// Continue after a pause.
    Resume,
    /// Continue after a failure or a cancellation.
    Retry,
    /// Remove it and its result.
    Delete,
}

/// Connects and runs `f`; Ctrl-C ends only this client.
pub fn with<T, F: Future<Output = Result<T, CliError>>>(
    remote: &RemoteArgs,
    f: impl FnOnce(JobsClient<Channel>) -> F,
) -> Result<T, CliError> {
    runtime()?.block_on(async {
        let work = async {
            // Lists of jobs are the largest messages; gRPC's default limit of 4 MiB holds thousands of jobs.
            f(JobsClient::new(client::channel(&remote.coordinator).await?)).await
        };
        tokio::select! {
            r = work => r,
            () = crate::serve::stop_signal() => {
                Err(CliError::Interrupted("interrupted; the job continues at the coordinator".to_owned()))
            }
        }
    })
}

/// Checks whether a coordinator serves.
pub fn health(args: &RemoteArgs, json: bool) -> Result<(), CliError> {
    runtime()?.block_on(async {
        let channel = client::channel(&args.coordinator).await?;
        let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
        let request = tonic_health::pb::HealthCheckRequest { service: "sightline.v1.Jobs".to_owned() };
        let answer = health.check(request).await.map_err(|s| CliError::status(&s))?.into_inner();
        match answer.status() {
            tonic_health::pb::health_check_response::ServingStatus::Serving => {
                print(if json { r#"{"status":"serving"}"# } else { "serving" })
            }
            other => Err(CliError::Coordinator(format!("the coordinator is {}", other.as_str_name()))),
        }
    })
}

/// Follows a job until it ends, and says how it ended.
pub fn watch(args: &JobRefArgs, json: bool) -> Result<(), CliError> {
    let job = with(&args.remote, |client| client::follow_on(client, &args.remote.coordinator, args.id))?;
    say(&ending(&job));
    show_job(&job, json)?;
    client::must_be_done(&job)
}

/// Lists jobs, ascending by id, and says how to see those that were left out.
pub fn jobs(args: &JobsArgs, json: bool) -> Result<(), CliError> {
    let (list, older) = with(&args.remote, |mut client| async move {
        let mut list: Vec<v1::Job> = Vec::new();
        let mut before = args.before.unwrap_or(0);
        loop {
            let limit = if args.all { 0 } else { args.limit };
            let page = client.list(v1::ListRequest { limit, before }).await;
            let v1::ListResponse { jobs, older } = page.map_err(|s| CliError::status(&s))?.into_inner();
            before = jobs.first().map_or(0, |job| job.id);
            list.splice(0..0, jobs);
            if !(args.all && older && before > 0) {
                return Ok((list, older));
            }
        }
    })?;
    if json {
        print(&serde_json::Value::from_iter(list.iter().map(value)).to_string())?;
    } else {
        list.iter().try_for_each(|j| print(&listed(j)))?;
    }
    if let Some(first) = list.first().filter(|_| older) {
        let id = first.id;
        say(&format!("there are older jobs: `sightline jobs --before {id}` lists them, --all lists all"));
    }
    Ok(())
}

/// Shows one job.
pub fn show(args: &ShowArgs, json: bool) -> Result<(), CliError> {
    if args.tiles {
        return farm::tiles(&args.job.remote, args.job.id, json);
    }
    let request = v1::ShowRequest { job: args.job.id };
    let job = with(&args.job.remote, |mut client| async move {
        client.show(request).await.map(tonic::Response::into_inner).map_err(|s| CliError::status(&s))
    })?;
    show_whole(&job, json)
}

/// Cancels, pauses, resumes, retries or deletes.
pub fn turn(args: &JobRefArgs, turn: Turn, json: bool) -> Result<(), CliError> {
    let request = v1::ShowRequest { job: args.id };
    let job = with(&args.remote, |mut client| async move {
        match turn {
            Turn::Cancel => client.cancel(request).await,
            Turn::Pause { now } => client.pause(v1::PauseRequest { job: args.id, now }).await,
            Turn::Resume => client.resume(request).await,
            Turn::Retry => client.retry(request).await,
            Turn::Delete => client.delete(request).await,
        }
        .map(tonic::Response::into_inner)
        .map_err(|s| CliError::status(&s))
    })?;
    show_job(&job, json)
}

/// Gives a job another priority.
pub fn prioritize(args: &PriorityArgs, json: bool) -> Result<(), CliError> {
    let request = v1::PrioritizeRequest { job: args.job.id, priority: args.priority };
    let job = with(&args.job.remote, |mut client| async move {
        client.prioritize(request).await.map(tonic::Response::into_inner).map_err(|s| CliError::status(&s))
    })?;
    show_job(&job, json)
}

/// Downloads a result.
pub fn fetch(args: &FetchArgs, json: bool) -> Result<(), CliError> {
    let request = v1::ShowRequest { job: args.job.id };
    let output = Output::check(&args.output, Format::Pvs, None)?;
    let bytes = with(&args.job.remote, |mut client| async move {
        let job = client.show(request).await.map_err(|s| CliError::status(&s))?.into_inner();
        if args.partial && job.state() != v1::JobState::Done {
            return client::fetch_partial(&mut client, &job, &output).await;
        }
        client::must_be_done(&job)?;
        client::fetch(&mut client, &job, &output).await
    })?;
    if json {
        let value = serde_json::json!({"output": args.output.display().to_string(), "bytes": bytes});
        return print(&value.to_string());
    }
    print(&format!("wrote {} ({bytes} bytes)", args.output.display()))
}
