//! `sightline workers`: lists the connected and the quarantined workers.

use std::time::Duration;

use serde_json::{Value, json};
use sightline::Error;
use sightline::words::human;
use sightline_proto::v1;

use crate::args::remote::{RemoteArgs, WorkersArgs};
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Lists the connected and the quarantined workers, or releases a quarantined one.
pub fn run(args: &WorkersArgs, json: bool) -> Result<(), Error> {
    if let Some(worker) = &args.release {
        return release(&args.remote, worker, json);
    }
    let v1::ListWorkersResponse {
        workers,
        now_ms,
        quarantined,
    } = args.remote.client()?.workers(&Terminal::new())?;
    if json {
        return print(&Value::from_iter(workers.iter().map(worker_value)).to_string());
    }
    for worker in &quarantined {
        let since = millis(now_ms.saturating_sub(worker.since_ms));
        print(&format!(
            "{} IS QUARANTINED, for {since} so far: {}",
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

/// Releases a worker from quarantine.
fn release(remote: &RemoteArgs, worker: &str, json: bool) -> Result<(), Error> {
    let was_quarantined = remote.client()?.release_worker(worker, &Terminal::new())?;
    if json {
        return print(&json!({"worker": worker, "was_quarantined": was_quarantined}).to_string());
    }
    if !was_quarantined {
        let text = format!(
            "no worker named {worker} is quarantined; `sightline workers` lists the quarantined \
             workers"
        );
        return Err(Error::input(text));
    }
    print(&format!("released worker {worker} from quarantine"))
}

/// Formats a duration in milliseconds for display.
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
        does.push("accepts no more tiles".to_owned());
    }
    if !w.trouble.is_empty() {
        does.push(format!("receives no tiles: {}", w.trouble));
    }
    let speed = match (w.samples_done, w.busy_millis) {
        (_, 0) => String::new(),
        (samples, ms) => format!(", {:.0} samples/s", samples as f64 * 1000.0 / ms as f64),
    };
    format!(
        "{} ({}; {}): {}; {} tiles, {} cells{speed}; connected for {}, last message {} ago",
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
    let tile_name = format!("tile {} of job {}", held.tile, held.job);
    match held.has_begun {
        true => format!("{tile_name} for {since}, {} cells done", held.cells),
        false => format!("has leased {tile_name} for {since} and not started it"),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worker_line_lists_tiles() {
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
            line.contains("tile 7 of job 3 for 2.0 s, 5 cells done; accepts no more tiles"),
            "{line}"
        );
    }
}
