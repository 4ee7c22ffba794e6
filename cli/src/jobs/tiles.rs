//! `sightline show --tiles`: prints the tiles of a job.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Value, json};
use sightline::Error;
use sightline::words::human;
use sightline_proto::v1;

use crate::args::remote::RemoteArgs;
use crate::terminal::exit::unless_cancelled;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Prints the tiles of a job, one line per tile.
pub fn show(remote: &RemoteArgs, job: u64, json: bool) -> Result<(), Error> {
    let mut show = |tiles: Vec<v1::TileInfo>| {
        let line = |t: &v1::TileInfo| match json {
            true => tile_value(t).to_string(),
            false => tile_line(t),
        };
        let lines: Vec<String> = tiles.iter().map(line).collect();
        match lines.is_empty() {
            true => Ok(()),
            false => print(&lines.join("\n")),
        }
    };
    unless_cancelled(remote.client()?.tiles(job, &mut show, &Terminal::new()))
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
        let _ = write!(line, ", {}", human(Duration::from_millis(t.millis)));
    }
    if t.conflicts > 0 {
        let _ = write!(line, ", {} DIFFERENT OUTPUTS WERE REJECTED", t.conflicts);
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
