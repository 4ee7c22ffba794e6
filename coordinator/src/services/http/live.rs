//! Changes as a stream of server-sent events: `jobs`, `workers`, and for one job `job`.

use std::convert::Infallible;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::{Path, Query, State};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse as _, Response};
use serde::Deserialize;
use sightline_proto::v1;
use sightline_proto::v1::jobs_server::Jobs as _;
use sightline_records::ids::JobId;
use sightline_scheduler::TileStatus;
use tokio::sync::mpsc;
use tonic::{Request, Status};

use super::super::blocking::blocking;
use super::super::{status, wire};
use super::site::{Site, failure, json};
use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::jobs::tiles;

/// Minimum time between two messages about a job.
const EVERY: Duration = Duration::from_secs(1);
/// Maximum number of a job's events in a message. Earlier events are available on request.
const EVENTS: usize = 500;
/// Maximum number of messages that wait for a watcher.
const WAITING: usize = 8;

/// The event topics that a client subscribes to.
#[derive(Deserialize)]
pub(super) struct Topics {
    job: Option<u64>,
    #[serde(default)]
    workers: bool,
}

type EventSender = mpsc::Sender<Result<Event, Infallible>>;

/// Streams the changes of the requested topics.
pub(super) async fn live(
    State(site): State<Arc<Site>>,
    Query(topics): Query<Topics>,
    caller: Option<Extension<Caller>>,
) -> Response {
    let (out, stream) = mpsc::channel(WAITING);
    tokio::spawn(tell_jobs(Arc::clone(&site), out.clone()));
    if topics.workers {
        tokio::spawn(tell_workers(Arc::clone(&site), out.clone()));
    }
    if let Some(job) = topics.job {
        tokio::spawn(tell_job(
            site,
            caller.map(|Extension(caller)| caller),
            JobId(job),
            out,
        ));
    }
    let stream = tokio_stream::wrappers::ReceiverStream::new(stream);
    Sse::new(stream)
        .keep_alive(KeepAlive::default())
        .into_response()
}

/// Sends one message. Returns false if the watcher has disconnected.
async fn say(out: &EventSender, name: &str, data: &str) -> bool {
    out.send(Ok(Event::default().event(name).data(data)))
        .await
        .is_ok()
}

async fn tell_jobs(site: Arc<Site>, out: EventSender) {
    let mut moments = site.snapshots.jobs.subscribe();
    let mut seen = None;
    // The next snapshot may be old, so the clock is sent first.
    if !say(&out, "clock", &site.coordinator.now().unix_ms.to_string()).await {
        return;
    }
    loop {
        let moment = moments.borrow_and_update().clone();
        // A watcher that missed a snapshot receives the whole state.
        let text = match seen {
            Some(seen) if seen + 1 == moment.number => moment.change,
            _ => moment.whole,
        };
        if moment.number > 0 && !say(&out, "jobs", &text).await {
            return;
        }
        seen = (moment.number > 0).then_some(moment.number);
        tokio::select! {
            changed = moments.changed() => if changed.is_err() { return },
            () = out.closed() => return,
        }
    }
}

async fn tell_workers(site: Arc<Site>, out: EventSender) {
    let mut lists = site.snapshots.workers.subscribe();
    loop {
        let list = Arc::clone(&lists.borrow_and_update());
        if !list.is_empty() && !say(&out, "workers", &list).await {
            return;
        }
        tokio::select! {
            changed = lists.changed() => if changed.is_err() { return },
            () = out.closed() => return,
        }
    }
}

/// Sends changes of one job: its summary, the states of its tiles, and its events.
async fn tell_job(site: Arc<Site>, caller: Option<Caller>, id: JobId, out: EventSender) {
    let c = &site.coordinator;
    let mut changes = c.dispatcher.watch_job(id);
    let mut grown = c.telemetry.event_log.grown();
    let mut before: Vec<TileStatus> = Vec::new();
    let mut after = c.telemetry.event_log.before_last(id, EVENTS);
    loop {
        changes.mark_unchanged();
        grown.mark_unchanged();
        let mut request = Request::new(v1::ShowRequest { job: id.0 });
        if let Some(caller) = &caller {
            request.extensions_mut().insert(caller.clone());
        }
        let shown = site.jobs.show(request).await;
        let job = match shown.map(|job| serde_json::to_string(&job.into_inner())) {
            Ok(Ok(text)) => text,
            Ok(Err(_)) => return,
            Err(s) => {
                let text = serde_json::json!({"failure": s.message()}).to_string();
                say(&out, "job", &text).await;
                return;
            }
        };
        let statuses =
            move |c: &Arc<Coordinator>| tiles::statuses(c, id).map_err(|e| status::of_store(&e));
        let Ok(now) = blocking(c, statuses).await else {
            return;
        };
        let tiles = changed_tiles(&before, &now);
        let (events, upto) = c.telemetry.event_log.after(Some(id), after, EVENTS);
        let events: Vec<v1::Event> = events.iter().map(wire::event).collect();
        let Ok(events) = serde_json::to_string(&events) else {
            return;
        };
        if !say(
            &out,
            "job",
            &format!(r#"{{"job":{job},"tiles":{tiles},"events":{events}}}"#),
        )
        .await
        {
            return;
        }
        before = now;
        after = upto;
        tokio::time::sleep(EVERY).await;
        tokio::select! {
            changed = changes.changed() => if changed.is_err() { return },
            // Events also report that the job was deleted or retried.
            () = of_job(c, &mut grown, id, after) => {}
            () = out.closed() => return,
        }
    }
}

/// Waits until an event of a job occurs.
async fn of_job(
    c: &Coordinator,
    grown: &mut tokio::sync::watch::Receiver<u64>,
    id: JobId,
    mut after: u64,
) {
    loop {
        let (found, upto) = c.telemetry.event_log.after(Some(id), after, 1);
        if !found.is_empty() {
            return;
        }
        // Skip the events that were already inspected.
        after = upto;
        if grown.changed().await.is_err() {
            return;
        }
        // Events of other jobs are frequent, so pause before the next look.
        tokio::time::sleep(EVERY / 2).await;
    }
}

/// Formats the states of tiles: a digit for each tile, or the changes since `before` as pairs of tile and
/// digit.
fn changed_tiles(before: &[TileStatus], now: &[TileStatus]) -> String {
    if before.len() != now.len() {
        let digits: String = now.iter().map(|s| char::from(b'0' + *s as u8)).collect();
        return format!("\"{digits}\"");
    }
    let mut out = "[".to_owned();
    for (tile, (_, state)) in before
        .iter()
        .zip(now)
        .enumerate()
        .filter(|(_, (a, b))| a != b)
    {
        let comma = if out.len() > 1 { "," } else { "" };
        // Writing to a string cannot fail.
        let _ = write!(out, "{comma}{tile},{}", *state as u8);
    }
    out.push(']');
    out
}

/// The number of the last event that the client has received.
#[derive(Deserialize)]
pub(super) struct Since {
    #[serde(default)]
    after: u64,
}

/// Returns events of a job, oldest first, at most 5000. `next` is the number to request later events with.
pub(super) async fn events(
    State(site): State<Arc<Site>>,
    Path(job): Path<u64>,
    Query(since): Query<Since>,
) -> Response {
    let (events, next) =
        site.coordinator
            .telemetry
            .event_log
            .after(Some(JobId(job)), since.after, 10 * EVENTS);
    let events: Vec<v1::Event> = events.iter().map(wire::event).collect();
    match serde_json::to_string(&events) {
        Ok(events) => json(format!(r#"{{"events":{events},"next":{next}}}"#)),
        Err(e) => failure(&Status::internal(e.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_sent_whole_and_then_as_changes() {
        use TileStatus::{Done, Ready, Running};
        assert_eq!(changed_tiles(&[], &[Ready, Running, Done]), "\"245\"");
        assert_eq!(
            changed_tiles(&[Ready, Ready, Ready], &[Ready, Running, Done]),
            "[1,4,2,5]"
        );
        assert_eq!(changed_tiles(&[Ready], &[Ready]), "[]");
    }
}
