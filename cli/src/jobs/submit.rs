//! `sightline submit`: sends a scene and a job, or prints the expected cost of the job.

use std::time::Duration;

use sightline::process::default_name;
use sightline::words::{human, plural, scene_in_words};
use sightline::{Error, SceneSource, Submission, read_scene};
use sightline_proto::v1;

use crate::args::remote::SubmitArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Uploads a scene and submits a job, or prints the expected cost of the job.
pub fn run(args: &SubmitArgs, json: bool) -> Result<(), Error> {
    let terminal = Terminal::new();
    let source = SceneSource::File(args.scene.clone());
    let scene = read_scene(&source, &args.kinds.options, &terminal)?;
    scene_in_words(&scene).iter().for_each(|line| say(line));
    let job = args.job.resolve(&scene, &terminal);
    let job = job.map_err(|e| e.naming_scene(&args.scene))?;
    let file_name = || args.scene.file_name().unwrap_or_default().to_string_lossy();
    let submission = Submission {
        name: match &args.name {
            Some(name) => name.clone(),
            None => file_name().into_owned(),
        },
        user: args.user.clone(),
        priority: args.priority,
        request_id: args.request_id.clone(),
    };
    let client = args.remote.client()?;
    if args.dry_run {
        let estimate = client.estimate(&scene, &job, &submission, &terminal)?;
        let (message, upload) = (&estimate.message, estimate.upload_bytes);
        if json {
            return print(&in_json(message, upload).to_string());
        }
        return in_words(message, upload)
            .iter()
            .try_for_each(|line| print(line));
    }
    let traces = args
        .traces
        .options()
        .start("sightline-submit", &default_name()?)?;
    let _flush_guard = traces.flush_guard();
    let handle = client.submit_traced(&scene, &job, &submission, &traces, &terminal)?;
    let job = handle.job().message();
    if handle.is_existing() {
        say(&format!(
            "job {} does this already: it has the same scene and parameters",
            job.id
        ));
        if job.priority != args.priority && job.finished_at_ms == 0 {
            say(&format!(
                "the existing job has priority {}; `sightline priority {} {}` changes the priority",
                job.priority, job.id, args.priority
            ));
        }
    }
    if json {
        print(&handle.job().to_json().to_string())
    } else {
        print(&job.id.to_string())
    }
}

fn in_words(e: &v1::EstimateResponse, upload: u64) -> Vec<String> {
    let cells = match e.cells {
        0 => "cells of an adaptive tree, whose number is not known yet,".to_owned(),
        n => plural(n as usize, "cell"),
    };
    let upload = match upload {
        0 => "the coordinator already has the scene".to_owned(),
        n => format!("the upload of the scene has {n} bytes"),
    };
    let mut lines = vec![format!(
        "{} in {}; {upload}",
        cells,
        plural(e.tiles as usize, "tile")
    )];
    if let Some(job) = &e.existing {
        lines.push(format!(
            "job {} does this already; a submission would compute nothing again",
            job.id
        ));
    }
    lines.push(match &e.cost {
        Some(c) => format!(
            "expected from {}, scaled by the number of cells: {} of work summed over the tiles ({} to \
             {}), with as many helpers as those jobs had, and a result of {} bytes ({} to {})",
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
        None => "the cost of the job is not known: no finished job of this coordinator has the same \
         method and sampler, or the job has an adaptive tree"
            .to_owned(),
    });
    lines.push(format!(
        "{} connected, {} before this job",
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
    fn estimate_names_its_source() {
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
                && text.ends_with("3 workers connected, 1 open job before this job")
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
