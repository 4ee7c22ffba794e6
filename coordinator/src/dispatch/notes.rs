//! The notes of the scheduler, formatted for the log and for the event log.

use sightline_records::ids::Lease;
use sightline_scheduler::{Note, Now};

use crate::telemetry::events::{EventKind, LogEvent};
use crate::telemetry::spans;
use crate::telemetry::state::Telemetry;

/// Writes a note of the scheduler to the log and to the event log.
pub(super) fn log_note(telemetry: &Telemetry, now: Now, note: &Note) {
    let event = match note {
        Note::TakenBack(lease @ Lease { job, tile, .. }, from, why) => {
            telemetry.metrics.lease_taken_back();
            telemetry.spans.lease_ended(lease, spans::TAKEN_BACK);
            let origin = from
                .as_ref()
                .map(|name| format!(" from worker {name}"))
                .unwrap_or_default();
            tracing::warn!("tile {tile} of job {job} is taken back{origin}: {why}");
            let text = format!("tile {tile} is taken back{origin}: {why}");
            LogEvent::of_lease(EventKind::TakenBack, lease, text)
                .on(from.clone().unwrap_or_default())
        }
        Note::TakenOver(lease @ Lease { job, tile, .. }, from) => {
            let text = format!("queued on the busy worker {from}, goes to an idle worker");
            tracing::info!("tile {tile} of job {job}, {text}");
            LogEvent::of_lease(EventKind::TakenBack, lease, format!("tile {tile}, {text}")).on(from)
        }
        Note::Doubled(lease @ Lease { job, tile, .. }) => {
            let text = "takes long; an idle worker computes the tile, too";
            tracing::info!("tile {tile} of job {job} {text}");
            LogEvent::of_lease(EventKind::Job, lease, format!("tile {tile} {text}"))
        }
        Note::TileFailed(lease @ Lease { job, tile, .. }, worker, reason) => {
            telemetry.spans.lease_ended(lease, spans::FAILED);
            tracing::warn!("tile {tile} of job {job} failed on {worker}: {reason}");
            let text = format!("tile {tile} failed on {worker}: {reason}");
            LogEvent::of_lease(EventKind::Failed, lease, text).on(worker)
        }
        Note::Died(lease @ Lease { job, tile, .. }, worker) => {
            telemetry.metrics.worker_died();
            telemetry.spans.lease_ended(lease, spans::FAILED);
            let text =
                format!("the connection of worker {worker} ended while it computed tile {tile}");
            tracing::warn!("job {job}: {text}");
            LogEvent::of_lease(EventKind::Failed, lease, text).on(worker)
        }
        Note::Agrees(job, tile, worker) => {
            telemetry.metrics.spot_check("same");
            let text = format!("tile {tile} was computed again, with the same bytes");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(EventKind::Check, *job, text).on(worker)
            }
        }
        Note::Differs(job, tile, workers) => {
            telemetry.metrics.spot_check("different");
            let text = format!(
                "tile {tile} was computed again, with different bytes; until a third worker \
                 determines the correct output, these workers get no tiles: {}",
                workers.join(", ")
            );
            tracing::error!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(EventKind::Conflict, *job, text)
            }
        }
        Note::NeedsThird(job, tile) => {
            let text = format!(
                "tile {tile} has two different outputs, and no worker is free to determine the \
                 correct one: start another worker"
            );
            tracing::error!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(EventKind::Conflict, *job, text)
            }
        }
        Note::Unchecked(job, tile, why) => {
            telemetry.metrics.spot_check("skipped");
            let text =
                format!("tile {tile} was selected for a check, but was not computed again: {why}");
            tracing::warn!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(EventKind::Check, *job, text)
            }
        }
        Note::Draining(name) => {
            let text = format!(
                "worker {name} is draining: it finishes its tile and accepts no other tile"
            );
            tracing::info!("{text}");
            LogEvent::new(EventKind::Worker, text).on(name)
        }
        Note::Chosen(job, chosen) => {
            // `sightline bake` shows this line of the log.
            tracing::info!(target: "sightline_coordinator::profile", "job {job}: {chosen}");
            LogEvent::of_job(EventKind::Job, *job, chosen)
        }
        Note::GraceOver(job, tiles) => {
            let text = match tiles {
                0 => "the wait for returning workers is over; no tile is free".to_owned(),
                1 => "the wait for returning workers is over; one tile is free".to_owned(),
                n => format!("the wait for returning workers is over; {n} tiles are free"),
            };
            tracing::info!("job {job} continues: {text}");
            LogEvent::of_job(EventKind::Job, *job, format!("the job continues: {text}"))
        }
    };
    telemetry.event_log.record(now.unix_ms, event);
}
