//! The commands of a client: submit, watch, jobs, show, cancel, pause, resume, retry, fetch, health.

use std::sync::Arc;
use std::time::Duration;

use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use tonic::transport::Channel;

use crate::args::{FetchArgs, JobRefArgs, RemoteArgs, SubmitArgs};
use crate::client;
use crate::error::CliError;
use crate::opening;
use crate::output::{Format, Output};
use crate::progress::{human, say};
use crate::serve::{print, runtime};

/// A change of a job's state.
#[derive(Clone, Copy)]
pub enum Turn {
    /// End it.
    Cancel,
    /// Grant no more tiles.
    Pause,
    /// Continue after a pause.
    Resume,
    /// Continue after a failure or a cancellation.
    Retry,
}

/// Connects and runs `f`; Ctrl-C ends only this client.
fn with<T, F: Future<Output = Result<T, CliError>>>(
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

/// Uploads a scene and submits a job.
pub fn submit(args: &SubmitArgs, json: bool) -> Result<(), CliError> {
    let scene = Arc::new(opening::scene(&args.scene, &args.kinds)?);
    opening::scene_in_words(&scene).iter().for_each(|line| say(line));
    let spec = args.job.spec(&args.scene, &scene)?;
    let file_name = || args.scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let name = args.name.clone().unwrap_or_else(file_name);
    let request = v1::SubmitRequest {
        request_id: args.request_id.clone().unwrap_or_else(client::fresh_request_id),
        name: name.chars().filter(|c| !c.is_control()).take(32).collect(),
        spec: Some(spec.to_proto()),
    };
    let answer = with(&args.remote, |mut client| async move {
        client::upload(&mut client, &scene).await?;
        client.submit(request).await.map(tonic::Response::into_inner).map_err(|s| CliError::status(&s))
    })?;
    let job = answer.job.unwrap_or_default();
    if answer.existing {
        say(&format!("job {} does this already", job.id));
    }
    if json { print(&value(&job).to_string()) } else { print(&job.id.to_string()) }
}

/// Follows a job until it ends, and says how it ended.
pub fn watch(args: &JobRefArgs, json: bool) -> Result<(), CliError> {
    let job =
        with(&args.remote, |mut client| async move { client::follow(&mut client, args.id, false).await })?;
    say(&ending(&job));
    show_job(&job, json)?;
    client::must_be_done(&job)
}

/// Lists jobs.
pub fn jobs(args: &RemoteArgs, json: bool) -> Result<(), CliError> {
    let list = with(args, |mut client| async move {
        client
            .list(v1::ListRequest {})
            .await
            .map(tonic::Response::into_inner)
            .map_err(|s| CliError::status(&s))
    })?;
    if json {
        return print(&serde_json::Value::from_iter(list.jobs.iter().map(value)).to_string());
    }
    list.jobs.iter().try_for_each(|j| print(&line(j)))
}

/// Shows one job.
pub fn show(args: &JobRefArgs, json: bool) -> Result<(), CliError> {
    let request = v1::ShowRequest { job: args.id };
    let job = with(&args.remote, |mut client| async move {
        client.show(request).await.map(tonic::Response::into_inner).map_err(|s| CliError::status(&s))
    })?;
    show_job(&job, json)
}

/// Cancels, pauses, resumes or retries.
pub fn turn(args: &JobRefArgs, turn: Turn, json: bool) -> Result<(), CliError> {
    let request = v1::ShowRequest { job: args.id };
    let job = with(&args.remote, |mut client| async move {
        match turn {
            Turn::Cancel => client.cancel(request).await,
            Turn::Pause => client.pause(request).await,
            Turn::Resume => client.resume(request).await,
            Turn::Retry => client.retry(request).await,
        }
        .map(tonic::Response::into_inner)
        .map_err(|s| CliError::status(&s))
    })?;
    show_job(&job, json)
}

/// Downloads a result.
pub fn fetch(args: &FetchArgs, json: bool) -> Result<(), CliError> {
    let request = v1::ShowRequest { job: args.job.id };
    let output = Output::check(&args.output, Format::Pvs, None)?;
    let bytes = with(&args.job.remote, |mut client| async move {
        let job = client.show(request).await.map_err(|s| CliError::status(&s))?.into_inner();
        client::must_be_done(&job)?;
        client::fetch(&mut client, &job, &output).await
    })?;
    if json {
        let value = serde_json::json!({"output": args.output.display().to_string(), "bytes": bytes});
        return print(&value.to_string());
    }
    print(&format!("wrote {} ({bytes} bytes)", args.output.display()))
}

/// How a job ended, after how long, and the next command. For a failed or cancelled job, the error at the end
/// of the program gives the reason or the next command.
fn ending(job: &v1::Job) -> String {
    let took = Duration::from_millis(job.finished_at_ms.saturating_sub(job.submitted_at_ms));
    let next = match job.state() {
        v1::JobState::Done => {
            let bytes = job.result_bytes;
            format!("; its result has {bytes} bytes, `sightline fetch {} -o FILE.pvs` downloads it", job.id)
        }
        _ => String::new(),
    };
    format!("job {} ended as {} {} after its submission{next}", job.id, state(job), human(took))
}

fn show_job(job: &v1::Job, json: bool) -> Result<(), CliError> {
    print(&if json { value(job).to_string() } else { line(job) })
}

fn state(job: &v1::Job) -> &'static str {
    match job.state() {
        v1::JobState::Unspecified => "unknown",
        v1::JobState::Queued => "queued",
        v1::JobState::Running => "running",
        v1::JobState::Paused => "paused",
        v1::JobState::Cancelled => "cancelled",
        v1::JobState::Failed => "failed",
        v1::JobState::Done => "done",
    }
}

fn line(job: &v1::Job) -> String {
    let reason = if job.reason.is_empty() { String::new() } else { format!(": {}", job.reason) };
    // Only a job that has ended can be retried.
    let again = match job.state() {
        v1::JobState::Done | v1::JobState::Failed | v1::JobState::Cancelled => {
            format!(" (`sightline retry {}` tries them again)", job.id)
        }
        _ => String::new(),
    };
    let aside = match job.tiles_set_aside {
        0 => String::new(),
        some => format!(", {some} SET ASIDE{again}"),
    };
    let workers = match (job.state(), job.workers) {
        (v1::JobState::Queued | v1::JobState::Running, 0) => {
            ", NO WORKERS: start some with `sightline worker`"
        }
        _ => "",
    };
    format!(
        "job {} {} {}{reason}: {}/{} tiles{aside}, {} cells, {} samples{workers}",
        job.id,
        job.name,
        state(job),
        job.tiles_done,
        job.tiles_total,
        job.cells_done,
        job.samples
    )
}

fn value(job: &v1::Job) -> serde_json::Value {
    let hex = |b: &[u8]| b.iter().map(|b| format!("{b:02x}")).collect::<String>();
    serde_json::json!({
        "job": job.id, "name": job.name, "state": state(job), "reason": job.reason,
        "scene": job.spec.as_ref().map(|s| hex(&s.scene)), "profile": job.profile,
        "tiles_total": job.tiles_total, "tiles_done": job.tiles_done,
        "tiles_set_aside": job.tiles_set_aside, "tiles_running": job.tiles_running,
        "cells_total": job.cells_total, "cells_done": job.cells_done, "samples": job.samples,
        "tile_millis": job.tile_millis, "submitted_at_ms": job.submitted_at_ms,
        "finished_at_ms": job.finished_at_ms, "result": hex(&job.result),
        "result_bytes": job.result_bytes, "workers": job.workers,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_of_a_job_names_its_state_its_time_and_the_next_command() {
        let mut job = v1::Job {
            id: 7,
            submitted_at_ms: 1000,
            finished_at_ms: 62_000,
            result_bytes: 12,
            ..v1::Job::default()
        };
        job.set_state(v1::JobState::Done);
        let text = ending(&job);
        assert!(text.starts_with("job 7 ended as done ") && text.contains("sightline fetch 7"), "{text}");
        job.set_state(v1::JobState::Cancelled);
        let text = ending(&job);
        assert!(text.starts_with("job 7 ended as cancelled ") && !text.contains("fetch"), "{text}");
    }
}
