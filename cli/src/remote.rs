//! The commands of a client that already has jobs: watch, jobs, show, cancel, pause, resume, retry, priority,
//! fetch; and health.

use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;

use crate::client;
use crate::error::CliError;
use crate::farm;
use crate::output::{Format, Output};
use crate::progress::{Progress, has_receivers, say};
use crate::remote_args::{FetchArgs, JobRefArgs, JobsArgs, PriorityArgs, RemoteArgs, ShowArgs};
use crate::serve::{print, runtime};
use crate::showing::{ending, listing, show_job, show_whole, value};

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
    f: impl FnOnce(JobsClient<Connection>) -> F,
) -> Result<T, CliError> {
    with_until(remote, crate::serve::stop_signal(), f)
}

/// [`with`] that ends when `stop` resolves instead.
pub fn with_until<T, F: Future<Output = Result<T, CliError>>>(
    remote: &RemoteArgs,
    stop: impl Future<Output = ()>,
    f: impl FnOnce(JobsClient<Connection>) -> F,
) -> Result<T, CliError> {
    runtime()?.block_on(async {
        let work = async {
            // Lists of jobs are the largest messages; gRPC's default limit of 4 MiB holds thousands of jobs.
            f(JobsClient::new(client::channel(remote).await?)).await
        };
        tokio::select! {
            r = work => r,
            () = stop => {
                Err(CliError::Interrupted("interrupted; the job continues at the coordinator".to_owned()))
            }
        }
    })
}

/// Checks whether a coordinator serves.
pub fn health(args: &RemoteArgs, json: bool) -> Result<(), CliError> {
    runtime()?.block_on(async {
        let channel = client::channel(args).await?;
        let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
        let request = tonic_health::pb::HealthCheckRequest {
            service: "sightline.v1.Jobs".to_owned(),
        };
        let answer = health
            .check(request)
            .await
            .map_err(|s| CliError::status(&s))?
            .into_inner();
        match answer.status() {
            tonic_health::pb::health_check_response::ServingStatus::Serving => print(if json {
                r#"{"status":"serving"}"#
            } else {
                "serving"
            }),
            other => Err(CliError::Coordinator(format!(
                "the coordinator is {}",
                other.as_str_name()
            ))),
        }
    })
}

/// Follows a job until it ends, and says how it ended.
pub fn watch(args: &JobRefArgs, json: bool) -> Result<(), CliError> {
    let progress = Progress::new();
    let mut show = |job: &v1::Job| progress.job(job, false);
    let remote = &args.remote;
    let job = with(remote, |client| {
        client::follow_on(client, remote, args.id, &mut show)
    })?;
    progress.end();
    say(&ending(&job));
    show_job(&job, json)?;
    client::must_be_done(&job)
}

/// Lists jobs, ascending by id, and says how to see those that were left out.
pub fn jobs(args: &JobsArgs, json: bool) -> Result<(), CliError> {
    let (list, older) = with(&args.remote, |client| listed(client, args))?;
    if json {
        print(&serde_json::Value::from_iter(list.iter().map(value)).to_string())?;
    } else {
        list.iter().try_for_each(|j| print(&listing(j)))?;
    }
    if let Some(first) = list.first().filter(|_| older) {
        let id = first.id;
        say(&format!(
            "there are older jobs: `sightline jobs --before {id}` lists them, --all lists all"
        ));
    }
    Ok(())
}

/// The wanted jobs, ascending by id, and whether there are older ones.
pub async fn listed(
    mut client: JobsClient<Connection>,
    args: &JobsArgs,
) -> Result<(Vec<v1::Job>, bool), CliError> {
    let mut list: Vec<v1::Job> = Vec::new();
    let mut before = args.before.unwrap_or(0);
    loop {
        let limit = if args.all { 0 } else { args.limit };
        let request = v1::ListRequest {
            limit,
            before,
            states: args
                .states
                .iter()
                .filter_map(|state| state_named(state))
                .map(i32::from)
                .collect(),
            name: args.name.clone(),
            user: args.user.clone(),
            scene: Vec::new(),
        };
        let page = client.list(request).await;
        let v1::ListResponse { jobs, older } = page.map_err(|s| CliError::status(&s))?.into_inner();
        before = jobs.first().map_or(0, |job| job.id);
        list.splice(0..0, jobs);
        if !(args.all && older && before > 0) {
            return Ok((list, older));
        }
    }
}

/// The state of this name.
fn state_named(name: &str) -> Option<v1::JobState> {
    v1::JobState::from_str_name(&format!("JOB_STATE_{}", name.to_ascii_uppercase()))
}

/// Shows one job.
pub fn show(args: &ShowArgs, json: bool) -> Result<(), CliError> {
    if args.tiles {
        return farm::tiles(&args.job.remote, args.job.id, json);
    }
    let job = with(&args.job.remote, |client| shown(client, args.job.id))?;
    show_whole(&job, json)
}

/// A job as it is now.
pub async fn shown(mut client: JobsClient<Connection>, job: u64) -> Result<v1::Job, CliError> {
    let request = v1::ShowRequest { job };
    client
        .show(request)
        .await
        .map(tonic::Response::into_inner)
        .map_err(|s| CliError::status(&s))
}

/// Cancels, pauses, resumes, retries or deletes.
pub fn turn(args: &JobRefArgs, turn: Turn, json: bool) -> Result<(), CliError> {
    let is_deleted = matches!(turn, Turn::Delete);
    let job = with(&args.remote, |client| turned(client, args.id, turn))?;
    if is_deleted && !json {
        return print(&format!("job {} is deleted", job.id));
    }
    show_job(&job, json)
}

/// Cancels, pauses, resumes, retries or deletes; returns the job.
pub async fn turned(
    mut client: JobsClient<Connection>,
    job: u64,
    turn: Turn,
) -> Result<v1::Job, CliError> {
    let request = v1::ShowRequest { job };
    match turn {
        Turn::Cancel => client.cancel(request).await,
        Turn::Pause { now } => client.pause(v1::PauseRequest { job, now }).await,
        Turn::Resume => client.resume(request).await,
        Turn::Retry => client.retry(request).await,
        Turn::Delete => client.delete(request).await,
    }
    .map(tonic::Response::into_inner)
    .map_err(|s| CliError::status(&s))
}

/// Gives a job another priority.
pub fn prioritize(args: &PriorityArgs, json: bool) -> Result<(), CliError> {
    let request = v1::PrioritizeRequest {
        job: args.job.id,
        priority: args.priority,
    };
    let job = with(&args.job.remote, |client| prioritized(client, request))?;
    show_job(&job, json)
}

/// Gives a job another priority; returns the job.
pub async fn prioritized(
    mut client: JobsClient<Connection>,
    request: v1::PrioritizeRequest,
) -> Result<v1::Job, CliError> {
    client
        .prioritize(request)
        .await
        .map(tonic::Response::into_inner)
        .map_err(|s| CliError::status(&s))
}

/// Downloads a result.
pub fn fetch(args: &FetchArgs, json: bool) -> Result<(), CliError> {
    let output = Output::check(&args.output, Format::Pvs, None)?;
    let bytes = with(&args.job.remote, |client| {
        fetched(client, args.job.id, args.partial, &output)
    })?;
    if json {
        let value =
            serde_json::json!({"output": args.output.display().to_string(), "bytes": bytes});
        return print(&value.to_string());
    }
    print(&format!("wrote {} ({bytes} bytes)", args.output.display()))
}

/// Downloads the result of a finished job to `output`, or what is done of one that has not ended; returns the
/// number of bytes.
pub async fn fetched(
    mut client: JobsClient<Connection>,
    job: u64,
    partial: bool,
    output: &Output,
) -> Result<u64, CliError> {
    let job = shown(client.clone(), job).await?;
    if has_receivers(&job) {
        return Err(CliError::Usage(format!(
            "job {} computes ambient occlusion and has no sets; whoever submitted it fetches its result",
            job.id
        )));
    }
    if partial && job.state() != v1::JobState::Done {
        return client::fetch_partial(&mut client, &job, output).await;
    }
    client::must_be_done(&job)?;
    client::fetch(&mut client, &job, output).await
}
