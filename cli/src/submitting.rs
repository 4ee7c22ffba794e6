//! `sightline submit`: sends a scene and a job, or says what the job would cost.

use std::sync::Arc;
use std::time::Duration;

use sightline_proto::chunks::CHUNK_BYTES;
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;
use sightline_traces::{Begun, Traces};

use crate::client;
use crate::error::CliError;
use crate::opening::{self, Source, plural};
use crate::progress::{human, say};
use crate::remote::with;
use crate::remote_args::SubmitArgs;
use crate::serve::{default_name, print};
use crate::showing::value;
use crate::traces;

/// Uploads a scene and submits a job.
pub fn submit(args: &SubmitArgs, json: bool) -> Result<(), CliError> {
    let (scene, request) = prepare(args, &Source::File(args.scene.clone()))?;
    if args.dry_run {
        return estimate(args, &scene, request, json);
    }
    let priority = request.priority;
    let traces = args.traces.start("sightline-submit", &default_name()?)?;
    let _sends_the_rest = traces.closing();
    let answer = with(&args.remote, |client| {
        submitted(client, &scene, request, &traces)
    })?;
    let job = answer.job.unwrap_or_default();
    if answer.existing {
        say(&format!("job {} does this already", job.id));
        if job.priority != priority && job.finished_at_ms == 0 {
            say(&format!(
                "it has priority {}; `sightline priority {} {priority}` changes that",
                job.priority, job.id
            ));
        }
    }
    if json {
        print(&value(&job).to_string())
    } else {
        print(&job.id.to_string())
    }
}

/// The scene, and the request for a job about it.
pub fn prepare(
    args: &SubmitArgs,
    source: &Source,
) -> Result<(Arc<Scene>, v1::SubmitRequest), CliError> {
    let scene = Arc::new(opening::read(source, &args.kinds)?);
    opening::scene_in_words(&scene)
        .iter()
        .for_each(|line| say(line));
    let spec = args.job.spec(source.path(), &scene)?;
    let file_name = || {
        source
            .path()
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let request = v1::SubmitRequest {
        request_id: args
            .request_id
            .clone()
            .unwrap_or_else(client::fresh_request_id),
        name: short(&args.name.clone().unwrap_or_else(file_name)),
        spec: Some(spec.to_message()),
        priority: args.priority,
        user: short(&args.user.clone().unwrap_or_else(login_name)),
    };
    Ok((scene, request))
}

/// Uploads a scene and submits a request about it.
pub async fn submitted(
    mut client: JobsClient<Connection>,
    scene: &Scene,
    request: v1::SubmitRequest,
    traces: &Traces,
) -> Result<v1::SubmitResponse, CliError> {
    let begun = Begun::now();
    client::upload(&mut client, scene).await?;
    let uploaded = Begun::now();
    let answer = client
        .submit(request)
        .await
        .map_err(|s| CliError::status(&s))?
        .into_inner();
    traces::submitted(traces, &answer, begun, uploaded);
    Ok(answer)
}

/// A name as the coordinator accepts it.
fn short(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(32).collect()
}

/// The name of the user who runs this program; empty if the system does not tell.
fn login_name() -> String {
    let of = |name| std::env::var(name).ok().filter(|user| !user.is_empty());
    let told = of("USER")
        .or_else(|| of("LOGNAME"))
        .or_else(|| of("USERNAME"));
    told.or_else(user_of_process).unwrap_or_default()
}

/// The user of this process by the system's list of users, where the environment does not tell, as in
/// containers and services.
#[cfg(target_os = "linux")]
fn user_of_process() -> Option<String> {
    use std::os::unix::fs::MetadataExt as _;
    let number = std::fs::metadata("/proc/self").ok()?.uid();
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(number)).then(|| name.to_owned())
    });
    Some(name.unwrap_or_else(|| format!("user {number}")))
}

#[cfg(not(target_os = "linux"))]
fn user_of_process() -> Option<String> {
    None
}

/// Says what a job would cost.
fn estimate(
    args: &SubmitArgs,
    scene: &Scene,
    request: v1::SubmitRequest,
    json: bool,
) -> Result<(), CliError> {
    let blob = scene.to_blob();
    // A stored scene is not kept in chunks any more, so it is asked for as a whole as well.
    let whole = blake3::hash(&blob).as_bytes().to_vec();
    let digest = |part: &[u8]| blake3::hash(part).as_bytes().to_vec();
    let digests = blob
        .chunks(CHUNK_BYTES)
        .map(digest)
        .chain([whole.clone()])
        .collect();
    let (estimate, missing) = with(&args.remote, |mut client| async move {
        let missing = client
            .missing_chunks(v1::MissingChunksRequest { digests })
            .await;
        let missing = missing
            .map_err(|s| CliError::status(&s))?
            .into_inner()
            .digests;
        let estimate = client
            .estimate(request)
            .await
            .map_err(|s| CliError::status(&s))?
            .into_inner();
        Ok((estimate, missing))
    })?;
    let upload: u64 = match missing.contains(&whole) {
        true => {
            let needed = blob
                .chunks(CHUNK_BYTES)
                .filter(|part| missing.contains(&digest(part)));
            needed.map(|part| part.len() as u64).sum()
        }
        false => 0,
    };
    if json {
        return print(&in_json(&estimate, upload).to_string());
    }
    in_words(&estimate, upload)
        .iter()
        .try_for_each(|line| print(line))
}

fn in_words(e: &v1::EstimateResponse, upload: u64) -> Vec<String> {
    let cells = match e.cells {
        0 => "cells that are divided as they are sampled".to_owned(),
        n => plural(n as usize, "cell"),
    };
    let upload = match upload {
        0 => "the coordinator has the scene".to_owned(),
        n => format!("{n} bytes of the scene, as it is sent, are to be uploaded"),
    };
    let mut lines = vec![format!(
        "{} in {}; {upload}",
        cells,
        plural(e.tiles as usize, "tile")
    )];
    if let Some(job) = &e.existing {
        lines.push(format!(
            "job {} does this already; nothing would be computed again",
            job.id
        ));
    }
    lines.push(match &e.cost {
        Some(c) => format!(
            "expected from {}, scaled by the number of cells: {} summed over its tiles ({} to {}), with as \
             many helpers as there were then, and a result of {} bytes ({} to {})",
            match (c.same_scene, c.jobs) {
                (true, n) => format!("{} on this scene with this sampling", plural(n as usize, "job")),
                (false, n) =>
                    format!("{} on other scenes or with other sampling, a guess", plural(n as usize, "job")),
            },
            human(Duration::from_millis(c.median_millis)),
            human(Duration::from_millis(c.least_millis)),
            human(Duration::from_millis(c.most_millis)),
            c.median_bytes,
            c.least_bytes,
            c.most_bytes
        ),
        None => "its cost is not known: no finished job here has the same method and sampler, or the number \
                 of cells is not known before they are sampled"
            .to_owned(),
    });
    lines.push(format!(
        "{} connected, {} before it",
        plural(e.workers as usize, "worker"),
        plural(e.jobs_before as usize, "open job")
    ));
    lines
}

fn in_json(e: &v1::EstimateResponse, upload: u64) -> serde_json::Value {
    let cost = e.cost.as_ref().map(|c| {
        serde_json::json!({
            "jobs": c.jobs, "same_scene": c.same_scene,
            "millis": [c.least_millis, c.median_millis, c.most_millis],
            "bytes": [c.least_bytes, c.median_bytes, c.most_bytes],
        })
    });
    serde_json::json!({
        "tiles": e.tiles, "cells": e.cells, "upload_bytes": upload,
        "existing": e.existing.as_ref().map(|job| job.id),
        "cost": cost, "workers": e.workers, "jobs_before": e.jobs_before,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_says_where_it_comes_from() {
        let cost = v1::Cost {
            jobs: 1,
            same_scene: true,
            least_millis: 1000,
            median_millis: 2000,
            most_millis: 61_000,
            least_bytes: 1,
            median_bytes: 2,
            most_bytes: 3,
        };
        let mut e = v1::EstimateResponse {
            tiles: 2,
            cells: 1024,
            existing: None,
            jobs_before: 1,
            workers: 3,
            cost: Some(cost),
        };
        let text = in_words(&e, 7).join("\n");
        assert!(
            text.starts_with("1024 cells in 2 tiles") && text.contains("1 job on this scene"),
            "{text}"
        );
        assert!(
            text.contains("(1 to 3)")
                && text.ends_with("3 workers connected, 1 open job before it")
        );
        (e.cost, e.cells, e.existing) = (
            None,
            0,
            Some(v1::Job {
                id: 9,
                ..v1::Job::default()
            }),
        );
        let text = in_words(&e, 0).join("\n");
        assert!(
            text.contains("not known") && text.contains("job 9 does this already"),
            "{text}"
        );
        assert_eq!(in_json(&e, 5)["cost"], serde_json::Value::Null);
        assert_eq!(in_json(&e, 5)["upload_bytes"], 5);
    }
}
