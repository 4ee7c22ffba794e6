//! What a farm does: its workers, the tiles of a job, and what happened.

use std::fmt::Write as _;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use futures::StreamExt as _;
use serde_json::{Value, json};
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::farm_client::FarmClient;

use crate::client;
use crate::error::CliError;
use crate::progress::human;
use crate::remote_args::{InvalidateArgs, LogsArgs, RemoteArgs, WorkersArgs};
use crate::serve::{print, runtime, stop_signal};
use crate::timeline::Timeline;

/// Tiles that are asked for at once.
const TILES_AT_ONCE: u32 = 10_000;

/// Connects and runs `f`, until Ctrl-C.
fn with<T, F: Future<Output = Result<T, CliError>>>(
    remote: &RemoteArgs,
    f: impl FnOnce(FarmClient<Connection>) -> F,
) -> Result<Option<T>, CliError> {
    runtime()?.block_on(async {
        // A page of tiles has a few megabytes, which is the limit that the coordinator keeps to.
        let work = async { f(FarmClient::new(client::channel(remote).await?)).await };
        tokio::select! {
            r = work => r.map(Some),
            () = stop_signal() => Ok(None),
        }
    })
}

/// Lets a quarantined worker work again.
fn release(remote: &RemoteArgs, worker: &str, json: bool) -> Result<(), CliError> {
    let request = v1::ReleaseWorkerRequest {
        worker: worker.to_owned(),
    };
    let answer = with(remote, |mut farm| async move {
        let answer = farm.release_worker(request).await;
        answer
            .map(tonic::Response::into_inner)
            .map_err(|s| CliError::status(&s))
    })?;
    let Some(v1::ReleaseWorkerResponse { was_quarantined }) = answer else {
        return Ok(());
    };
    if json {
        return print(&json!({"worker": worker, "was_quarantined": was_quarantined}).to_string());
    }
    if !was_quarantined {
        let text = format!(
            "no worker named {worker} is quarantined; `sightline workers` lists those that are"
        );
        return Err(CliError::Input(text));
    }
    print(&format!("worker {worker} may work again"))
}

/// Has tiles computed again whose results are not believed any more.
pub fn invalidate(args: &InvalidateArgs, json: bool) -> Result<(), CliError> {
    if let (Some(since), Some(until)) = (args.since, args.until)
        && since <= until
    {
        let text = "--since is a longer time than --until: both count back from now";
        return Err(CliError::Usage(text.to_owned()));
    }
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_err(CliError::internal)?;
    let ago = |time: Duration| now.saturating_sub(time).as_millis() as u64;
    let request = v1::InvalidateRequest {
        job: args.id,
        tiles: args.tiles.clone(),
        worker: args.worker.clone().unwrap_or_default(),
        from_ms: args.since.map(ago),
        to_ms: args.until.map(ago),
    };
    let answer = with(&args.remote, |mut farm| async move {
        let answer = farm.invalidate(request).await;
        answer
            .map(tonic::Response::into_inner)
            .map_err(|s| CliError::status(&s))
    })?;
    let Some(v1::InvalidateResponse { jobs }) = answer else {
        return Ok(());
    };
    if json {
        let job = |job: &v1::InvalidatedJob| json!({"job": job.job, "tiles": job.tiles});
        return print(&Value::from_iter(jobs.iter().map(job)).to_string());
    }
    if jobs.is_empty() {
        return print("no done tile is meant; `sightline show JOB --tiles` lists who did which");
    }
    jobs.iter().try_for_each(|job| {
        print(&format!(
            "job {}: {} tiles are computed again",
            job.job, job.tiles
        ))
    })
}

/// Lists the connected workers and those that are quarantined, or releases one.
pub fn workers(args: &WorkersArgs, json: bool) -> Result<(), CliError> {
    if let Some(worker) = &args.release {
        return release(&args.remote, worker, json);
    }
    let listed = with(&args.remote, |mut farm| async move {
        let answer = farm.list_workers(v1::ListWorkersRequest {}).await;
        answer
            .map(tonic::Response::into_inner)
            .map_err(|s| CliError::status(&s))
    })?;
    let Some(v1::ListWorkersResponse {
        workers,
        now_ms,
        quarantined,
    }) = listed
    else {
        return Ok(());
    };
    if json {
        return print(&Value::from_iter(workers.iter().map(worker_value)).to_string());
    }
    for worker in &quarantined {
        let since = millis(now_ms.saturating_sub(worker.since_ms));
        print(&format!(
            "{} IS QUARANTINED since {since} ago: {}",
            worker.worker, worker.reason
        ))?;
    }
    if workers.is_empty() {
        return print("no workers are connected; start some with `sightline worker`");
    }
    workers
        .iter()
        .try_for_each(|w| print(&worker_line(w, now_ms)))
}

/// A duration of milliseconds, in words.
fn millis(ms: u64) -> String {
    human(Duration::from_millis(ms))
}

fn worker_line(w: &v1::WorkerInfo, now_ms: u64) -> String {
    let mut does: Vec<String> = w.tiles.iter().map(|held| held_text(held, now_ms)).collect();
    if let Some(helped) = &w.helps {
        does.push(format!(
            "helps with tile {} of job {}",
            helped.tile, helped.job
        ));
    }
    if does.is_empty() {
        does.push("idle".to_owned());
    }
    if w.draining {
        does.push("takes no more tiles".to_owned());
    }
    if !w.trouble.is_empty() {
        does.push(format!("gets no tiles: {}", w.trouble));
    }
    let speed = match (w.samples_done, w.busy_millis) {
        (_, 0) => String::new(),
        (samples, ms) => format!(", {:.0} samples/s", samples as f64 * 1000.0 / ms as f64),
    };
    format!(
        "{} ({}; {}): {}; {} tiles, {} cells{speed}; here for {}, last heard {} ago",
        w.name,
        w.version,
        w.profiles.join(", "),
        does.join("; "),
        w.tiles_done,
        w.cells_done,
        millis(now_ms.saturating_sub(w.connected_at_ms)),
        millis(now_ms.saturating_sub(w.heard_at_ms))
    )
}

fn held_text(held: &v1::HeldTile, now_ms: u64) -> String {
    let since = millis(now_ms.saturating_sub(held.since_ms));
    let of = format!("tile {} of job {}", held.tile, held.job);
    match held.has_begun {
        true => format!("{of} for {since}, {} cells done", held.cells),
        false => format!("waits with {of} for {since}"),
    }
}

fn held_value(held: &v1::HeldTile) -> Value {
    json!({
        "job": held.job, "tile": held.tile, "has_begun": held.has_begun, "since_ms": held.since_ms,
        "cells": held.cells, "samples": held.samples,
    })
}

fn worker_value(w: &v1::WorkerInfo) -> Value {
    json!({
        "name": w.name, "version": w.version, "profiles": w.profiles,
        "connected_at_ms": w.connected_at_ms, "heard_at_ms": w.heard_at_ms, "draining": w.draining,
        "trouble": w.trouble, "tiles": w.tiles.iter().map(held_value).collect::<Vec<_>>(),
        "helps": w.helps.as_ref().map(held_value), "tiles_done": w.tiles_done,
        "cells_done": w.cells_done, "samples_done": w.samples_done, "busy_millis": w.busy_millis,
    })
}

/// Prints the tiles of a job, a line each.
pub fn tiles(remote: &RemoteArgs, job: u64, json: bool) -> Result<(), CliError> {
    with(remote, |mut farm| async move {
        let mut first = 0;
        loop {
            let request = v1::ListTilesRequest {
                job,
                first,
                limit: TILES_AT_ONCE,
                states: Vec::new(),
            };
            let page = farm
                .list_tiles(request)
                .await
                .map_err(|s| CliError::status(&s))?
                .into_inner();
            let line = |t| {
                if json {
                    tile_value(t).to_string()
                } else {
                    tile_line(t)
                }
            };
            let lines: Vec<String> = page.tiles.iter().map(line).collect();
            if !lines.is_empty() {
                print(&lines.join("\n"))?;
            }
            first = page.next;
            if first == 0 {
                return Ok(());
            }
        }
    })
    .map(|_| ())
}

fn state(tile: &v1::TileInfo) -> &'static str {
    match tile.state() {
        v1::TileState::Unspecified => "unknown",
        v1::TileState::Waiting => "waiting",
        v1::TileState::Ready => "ready",
        v1::TileState::Leased => "leased",
        v1::TileState::Running => "running",
        v1::TileState::Done => "done",
        v1::TileState::SetAside => "set aside",
    }
}

fn tile_line(t: &v1::TileInfo) -> String {
    let mut line = format!("tile {}: {}", t.tile, state(t));
    let workers = t
        .workers
        .iter()
        .filter(|w| !w.is_empty())
        .cloned()
        .collect::<Vec<_>>()
        .join(", ");
    // Writing to a string cannot fail.
    if !workers.is_empty() {
        let _ = write!(line, " on {workers}");
    }
    match t.is_pack {
        true => line.push_str(", samples for other tiles"),
        false => {
            let _ = write!(line, ", {}/{} cells", t.cells_done, t.cells);
        }
    }
    let _ = write!(line, ", {} samples", t.samples);
    if t.millis > 0 {
        let _ = write!(line, ", {}", millis(t.millis));
    }
    if t.conflicts > 0 {
        let _ = write!(line, ", {} DIFFERENT RESULTS WERE REFUSED", t.conflicts);
    }
    for failure in &t.failures {
        let _ = write!(line, "\n  failed on {}: {}", failure.worker, failure.reason);
    }
    line
}

fn tile_value(t: &v1::TileInfo) -> Value {
    let failure = |f: &v1::TileFailure| json!({"worker": f.worker, "reason": f.reason});
    json!({
        "tile": t.tile, "state": state(t), "box": t.r#box, "cells": t.cells, "cells_done": t.cells_done,
        "samples": t.samples, "millis": t.millis, "workers": t.workers,
        "failures": t.failures.iter().map(failure).collect::<Vec<_>>(), "conflicts": t.conflicts,
        "is_pack": t.is_pack,
    })
}

/// Prints what happened to a job or on the farm.
pub fn logs(args: &LogsArgs, json: bool) -> Result<(), CliError> {
    let request = v1::EventsRequest {
        job: args.id,
        after: args.after,
        follow: args.follow,
    };
    with(&args.remote, |mut farm| async move {
        let mut events = farm
            .events(request)
            .await
            .map_err(|s| CliError::status(&s))?
            .into_inner();
        let mut traced = args.trace.then(Timeline::default);
        while let Some(event) = events.next().await {
            let event = event.map_err(|s| CliError::status(&s))?;
            if let Some(traced) = &mut traced {
                traced.add(&event);
                continue;
            }
            print(&if json {
                event_value(&event).to_string()
            } else {
                event_line(&event)
            })?;
        }
        if let Some(traced) = traced {
            print(&traced.finish().to_string())?;
        }
        Ok(())
    })
    .map(|_| ())
}

/// The kind of an event as one word.
fn kind(event: &v1::Event) -> String {
    event
        .kind()
        .as_str_name()
        .trim_start_matches("EVENT_KIND_")
        .to_ascii_lowercase()
}

fn event_line(e: &v1::Event) -> String {
    let job = if e.job > 0 {
        format!("job {}: ", e.job)
    } else {
        String::new()
    };
    format!("{} {job}{}", time(e.at_ms), e.text)
}

fn event_value(e: &v1::Event) -> Value {
    json!({
        "number": e.number, "at_ms": e.at_ms, "kind": kind(e), "job": (e.job > 0).then_some(e.job),
        "tile": e.tile, "worker": (!e.worker.is_empty()).then_some(&e.worker), "text": e.text,
    })
}

/// A time as UTC in the form of RFC 3339, from milliseconds since 1970. The date as in Hinnant 2021.
fn time(unix_ms: u64) -> String {
    let (days, ms) = (unix_ms / 86_400_000, unix_ms % 86_400_000);
    let z = days + 719_468;
    let (era, of_era) = (z / 146_097, z % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, shift) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    format!(
        "{:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}.{:03}Z",
        year + era * 400 + shift,
        ms / 3_600_000,
        ms / 60_000 % 60,
        ms / 1000 % 60,
        ms % 1000
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        assert_eq!(time(0), "1970-01-01T00:00:00.000Z");
        // date -u -d @951827696 and others
        assert_eq!(time(951_827_696_000), "2000-02-29T12:34:56.000Z");
        assert_eq!(time(1_735_689_599_999), "2024-12-31T23:59:59.999Z");
        assert_eq!(time(1_772_323_200_000), "2026-03-01T00:00:00.000Z");
    }

    #[test]
    fn a_worker_line_says_what_it_does() {
        let mut worker = v1::WorkerInfo {
            name: "a".to_owned(),
            ..Default::default()
        };
        assert!(worker_line(&worker, 10).contains(": idle;"));
        let held = v1::HeldTile {
            job: 3,
            tile: 7,
            has_begun: true,
            cells: 5,
            ..Default::default()
        };
        worker.tiles.push(held);
        worker.draining = true;
        let line = worker_line(&worker, 2000);
        assert!(
            line.contains("tile 7 of job 3 for 2.0 s, 5 cells done; takes no more tiles"),
            "{line}"
        );
    }
}
