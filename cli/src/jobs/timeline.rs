//! The time line of a job in the Trace Event Format of Chrome.
//!
//! The time for which a worker had a tile is a complete event (`X`), an event at one moment is an instant
//! (`i`), and each worker has a row (`tid`). Source: "Trace Event Format", the Chromium project. Times are
//! microseconds since the first event.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use sightline_proto::v1;
use sightline_proto::v1::EventKind;

/// The number (`tid`) of the row with the events of the job that name no worker.
const JOB: u64 = 0;

/// The time line of a job's events, in their order of arrival.
#[derive(Debug, Default)]
pub struct Timeline {
    out: Vec<Value>,
    first_ms: Option<u64>,
    last_ms: u64,
    /// The number (`tid`) of each worker's row, by the worker's name.
    rows: BTreeMap<String, u64>,
    /// The time at which each worker leased each open tile, in milliseconds since the first event. The key is
    /// a tile number and a worker name.
    open: BTreeMap<(u32, String), u64>,
}

impl Timeline {
    /// Adds the next event.
    pub fn add(&mut self, event: &v1::Event) {
        let first = *self.first_ms.get_or_insert(event.at_ms);
        // The clock of a machine can be set back, so the difference is saturated.
        let at = event.at_ms.saturating_sub(first);
        self.last_ms = self.last_ms.max(at);
        let tile_and_worker = event.tile.map(|tile| (tile, event.worker.clone()));
        match (event.kind(), tile_and_worker) {
            (EventKind::Leased, Some(tile_and_worker)) => {
                self.open.insert(tile_and_worker, at);
            }
            (EventKind::Done | EventKind::TakenBack | EventKind::Failed, Some(tile_and_worker)) => {
                let how = event
                    .kind()
                    .as_str_name()
                    .trim_start_matches("EVENT_KIND_")
                    .to_ascii_lowercase();
                match self.open.remove(&tile_and_worker) {
                    Some(since) => self.complete(&tile_and_worker, since, at, &how, &event.text),
                    // The lease is older than the coordinator's event log.
                    None => self.instant(&tile_and_worker.1, at, event),
                }
            }
            _ => self.instant(&event.worker, at, event),
        }
    }

    fn row(&mut self, worker: &str) -> u64 {
        if worker.is_empty() {
            return JOB;
        }
        let next = self.rows.len() as u64 + 1;
        *self.rows.entry(worker.to_owned()).or_insert(next)
    }

    fn complete(&mut self, tile_row: &(u32, String), since: u64, at: u64, how: &str, text: &str) {
        let row = self.row(&tile_row.1);
        self.out.push(json!({
            "name": format!("tile {}", tile_row.0), "cat": how, "ph": "X", "ts": since * 1000,
            "dur": at.saturating_sub(since) * 1000, "pid": 1, "tid": row, "args": {"end": how, "text": text},
        }));
    }

    fn instant(&mut self, worker: &str, at: u64, event: &v1::Event) {
        let row = self.row(worker);
        let kind = event
            .kind()
            .as_str_name()
            .trim_start_matches("EVENT_KIND_")
            .to_ascii_lowercase();
        self.out.push(json!({
            "name": event.text, "cat": kind, "ph": "i", "s": "t", "ts": at * 1000, "pid": 1, "tid": row,
            "args": {"tile": event.tile},
        }));
    }

    /// Returns the complete time line. Running tiles last until the last event.
    pub fn finish(mut self) -> Value {
        for (key, since) in std::mem::take(&mut self.open) {
            self.complete(&key, since, self.last_ms, "running", "");
        }
        let name = |row: u64, name: &str| {
            let args = json!({"name": name});
            json!({"name": "thread_name", "ph": "M", "pid": 1, "tid": row, "args": args})
        };
        let mut events = vec![name(JOB, "the job")];
        events.extend(self.rows.iter().map(|(worker, row)| name(*row, worker)));
        events.append(&mut self.out);
        json!({"displayTimeUnit": "ms", "traceEvents": events})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(at_ms: u64, kind: EventKind, tile: Option<u32>, worker: &str) -> v1::Event {
        v1::Event {
            at_ms,
            kind: kind.into(),
            tile,
            worker: worker.to_owned(),
            ..Default::default()
        }
    }

    #[test]
    fn tile_lasts_from_lease_to_end() {
        let mut line = Timeline::default();
        line.add(&event(1000, EventKind::Submitted, None, ""));
        line.add(&event(1010, EventKind::Leased, Some(3), "ada"));
        line.add(&event(1020, EventKind::Leased, Some(4), "bob"));
        line.add(&event(1500, EventKind::Done, Some(3), "ada"));
        line.add(&event(1600, EventKind::TakenBack, Some(9), "cy"));
        let whole = line.finish();
        let events = whole["traceEvents"].as_array().unwrap();
        let with_phase = |ph: &str| events.iter().filter(|e| e["ph"] == ph).collect::<Vec<_>>();
        let spans = with_phase("X");
        assert_eq!(spans.len(), 2);
        assert_eq!(
            (&spans[0]["ts"], &spans[0]["dur"]),
            (&json!(10_000), &json!(490_000))
        );
        assert_eq!(
            (&spans[1]["dur"], &spans[1]["cat"]),
            (&json!(580_000), &json!("running"))
        );
        assert_eq!((with_phase("i").len(), with_phase("M").len()), (2, 4));
    }
}
