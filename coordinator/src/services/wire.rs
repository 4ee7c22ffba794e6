//! Conversions of values between the wire format and the coordinator's types.

use sightline_model::job::message::remove_large_parts;
use sightline_proto::v1;
use sightline_records::ids::{Digest, worker_name};
use sightline_records::{JobPhase, JobState, QuarantineRecord, SceneRecord};
use sightline_scheduler::{
    Ineligible, LeasedTile, ProfileTime, TileStatus, TileWorkers, WorkerCommand, WorkerStatus,
};
use sightline_store::Address;
use sightline_traces::TraceId;
use tonic::Status;

use crate::jobs::control::Summary;
use crate::jobs::estimate::Estimate;
use crate::jobs::stored_spec;
use crate::jobs::suspensions::MissingBlob;
use crate::jobs::tiles::TileView;
use crate::telemetry::events::{Entry, EventKind};
use crate::workers::lease_tags::{LeaseTags, LeaseUse};

/// Converts a digest from the wire.
///
/// # Errors
/// INVALID_ARGUMENT if the digest does not have 32 bytes.
pub(super) fn digest(bytes: &[u8]) -> Result<Digest, Status> {
    bytes.try_into().map_err(|_| {
        Status::invalid_argument(format!(
            "the digest has {} bytes; give the 32 bytes of a BLAKE3 digest",
            bytes.len()
        ))
    })
}

/// Converts an address for a worker. The address is not logged.
pub(super) fn address(address: Address) -> v1::Address {
    let header = |(name, value): (&str, String)| v1::Header {
        name: name.to_owned(),
        value,
    };
    let seconds = address.lives.as_secs() as u32;
    v1::Address {
        url: address.url,
        seconds,
        headers: address.headers.into_iter().map(header).collect(),
    }
}

/// Converts the measured times of a worker's backends.
pub(super) fn times(times: Vec<v1::ProfileTime>) -> Vec<ProfileTime> {
    let time = |t: v1::ProfileTime| ProfileTime {
        profile: t.profile,
        seconds_per_cube: t.seconds_per_cube,
    };
    times.into_iter().map(time).collect()
}

/// Converts a command to a worker, with the trace of the command's job.
pub(super) fn command(
    tags: &LeaseTags,
    command: WorkerCommand,
    trace: Option<TraceId>,
) -> v1::CoordinatorMessage {
    use v1::coordinator_message::Message;
    let trace = bytes_of(trace);
    let message = match command {
        WorkerCommand::Grant(grant) => Message::Grant(v1::Grant {
            lease: Some(tags.to_wire(&grant.lease, LeaseUse::Hold)),
            spec: Some(grant.planned.spec().to_message()),
            profile: grant.profile,
            // An absent pack has an empty digest, and the worker then reports the tile as failed.
            packs: grant
                .packs
                .iter()
                .map(|d| d.map_or_else(Vec::new, |d| d.to_vec()))
                .collect(),
            millis: grant.millis,
            trace,
        }),
        WorkerCommand::Revoke(lease) => {
            // The receiver identifies the lease by its numbers, both as its holder and as a helper.
            let lease = v1::Lease {
                tag: 0,
                ..tags.to_wire(&lease, LeaseUse::Hold)
            };
            Message::Revoke(v1::Revoke { lease: Some(lease) })
        }
        WorkerCommand::Help(help) => Message::Help(v1::Help {
            lease: Some(tags.to_wire(&help.lease, LeaseUse::Help)),
            spec: Some(help.planned.spec().to_message()),
            profile: help.profile,
            trace,
        }),
        WorkerCommand::Time { job, planned } => Message::Time(v1::Time {
            job: job.0,
            spec: Some(planned.spec().to_message()),
        }),
    };
    v1::CoordinatorMessage {
        message: Some(message),
    }
}

/// Returns the bytes of a trace's id, or no bytes without a trace.
fn bytes_of(trace: Option<TraceId>) -> Vec<u8> {
    trace.map_or_else(Vec::new, |trace| trace.bytes().to_vec())
}

/// Converts a scene's record.
pub(super) fn scene(record: &SceneRecord) -> v1::SceneInfo {
    let SceneRecord {
        digest,
        triangles,
        objects,
        ..
    } = record;
    v1::SceneInfo {
        digest: digest.to_vec(),
        triangles: *triangles,
        objects: *objects,
    }
}

/// Converts the description of workers that cannot work on a job.
pub(super) fn ineligible(ineligible: Ineligible) -> v1::UnableWorkers {
    let Ineligible {
        reason,
        workers,
        names,
    } = ineligible;
    v1::UnableWorkers {
        reason,
        workers,
        names,
    }
}

/// Converts the workers of a tile.
pub(super) fn team(team: TileWorkers) -> v1::Team {
    let TileWorkers {
        tile,
        leader,
        has_begun,
        helpers,
    } = team;
    v1::Team {
        tile: tile.0,
        leader,
        has_begun,
        helpers,
    }
}

/// Converts an estimate of a submission.
pub(super) fn estimate(estimate: Estimate) -> v1::EstimateResponse {
    let Estimate {
        tiles,
        cells,
        existing,
        jobs_before,
        workers,
        cost,
    } = estimate;
    let existing = existing.as_ref().map(job);
    let cost = cost.map(|cost| {
        let [least_millis, median_millis, most_millis] = cost.millis;
        let [least_bytes, median_bytes, most_bytes] = cost.bytes;
        v1::Cost {
            jobs: cost.jobs,
            same_scene: cost.same_scene,
            least_millis,
            median_millis,
            most_millis,
            least_bytes,
            median_bytes,
            most_bytes,
        }
    });
    v1::EstimateResponse {
        tiles,
        cells,
        existing,
        jobs_before,
        workers,
        cost,
    }
}

/// Converts a job's summary.
pub(super) fn job(summary: &Summary) -> v1::Job {
    let record = &summary.record;
    let mut job = v1::Job {
        id: record.id.0,
        name: record.name.clone(),
        // An unreadable specification is shown as absent, but the record keeps its bytes. Large parts such as
        // viewpoints are removed, because a list has many jobs.
        spec: stored_spec::part(&record.spec).ok().map(|(mut spec, _)| {
            remove_large_parts(&mut spec);
            spec
        }),
        profile: record.profile.clone().unwrap_or_default(),
        tiles_total: summary.tiles_total,
        tiles_done: summary.tiles_done,
        tiles_set_aside: summary.tiles_set_aside,
        tiles_running: summary.tiles_running,
        cells_done: summary.cells_done,
        cells_total: summary.cells_total,
        samples: summary.samples,
        tile_millis: summary.tile_millis,
        submitted_at_ms: record.submitted_at_ms,
        finished_at_ms: record.finished_at_ms.unwrap_or(0),
        workers: summary.workers,
        priority: record.priority,
        user: record.user.clone(),
        now_ms: summary.now_ms,
        left_millis: summary.left_millis,
        trace: bytes_of(summary.trace),
        ..v1::Job::default()
    };
    let state = match &record.state {
        JobState::Queued => v1::JobState::Queued,
        JobState::Running => v1::JobState::Running,
        JobState::Paused => {
            let reason = summary.missing.map(|blob| match blob {
                MissingBlob::Scene(_) => {
                    "the job's scene cannot be read; send the scene again with `sightline submit`"
                }
                MissingBlob::Receivers(_) => {
                    "the job's receivers cannot be read; send the receivers again with the \
                     `sightline ambient` that made the job"
                }
            });
            job.reason = reason.unwrap_or_default().to_owned();
            v1::JobState::Paused
        }
        JobState::Cancelled => v1::JobState::Cancelled,
        JobState::Failed { reason } => {
            job.reason = reason.clone();
            v1::JobState::Failed
        }
        JobState::Done { result, bytes } => {
            job.result = result.to_vec();
            job.result_bytes = *bytes;
            v1::JobState::Done
        }
    };
    job.set_state(state);
    job
}

/// Converts the status of a connected worker.
pub(super) fn member(member: WorkerStatus) -> v1::WorkerInfo {
    v1::WorkerInfo {
        name: member.name,
        version: member.version,
        profiles: member.profiles,
        connected_at_ms: member.connected_at,
        heard_at_ms: member.heard_at,
        draining: member.draining,
        trouble: member.trouble.unwrap_or_default().to_owned(),
        tiles: member.tiles.into_iter().map(held_tile).collect(),
        helps: member.helps.map(held_tile),
        tiles_done: member.done.tiles,
        cells_done: member.done.cells,
        samples_done: member.done.samples,
        busy_millis: member.done.millis,
    }
}

/// Converts the record of a quarantined worker.
pub(super) fn quarantined(record: QuarantineRecord) -> v1::QuarantinedWorker {
    let QuarantineRecord {
        worker,
        at_ms,
        reason,
    } = record;
    v1::QuarantinedWorker {
        worker,
        since_ms: at_ms,
        reason,
    }
}

fn held_tile(leased: LeasedTile) -> v1::HeldTile {
    let LeasedTile {
        job,
        tile,
        has_begun,
        since,
        cells,
        samples,
    } = leased;
    v1::HeldTile {
        job: job.0,
        tile: tile.0,
        has_begun,
        since_ms: since,
        cells,
        samples,
    }
}

/// Converts the state of a job from the wire.
///
/// # Errors
/// INVALID_ARGUMENT if the number is not a state.
pub(super) fn phase(state: v1::JobState) -> Result<JobPhase, Status> {
    Ok(match state {
        v1::JobState::Queued => JobPhase::Queued,
        v1::JobState::Running => JobPhase::Running,
        v1::JobState::Paused => JobPhase::Paused,
        v1::JobState::Cancelled => JobPhase::Cancelled,
        v1::JobState::Failed => JobPhase::Failed,
        v1::JobState::Done => JobPhase::Done,
        v1::JobState::Unspecified => {
            return Err(Status::invalid_argument(
                "the request contains an unknown state of a job",
            ));
        }
    })
}

/// Converts the state of a tile from the wire.
///
/// # Errors
/// INVALID_ARGUMENT if the number is not a state.
pub(super) fn tile_status(state: v1::TileState) -> Result<TileStatus, Status> {
    Ok(match state {
        v1::TileState::Waiting => TileStatus::Waiting,
        v1::TileState::Ready => TileStatus::Ready,
        v1::TileState::Leased => TileStatus::Leased,
        v1::TileState::Running => TileStatus::Running,
        v1::TileState::Done => TileStatus::Done,
        v1::TileState::SetAside => TileStatus::SetAside,
        v1::TileState::Unspecified => {
            return Err(Status::invalid_argument(
                "the request contains an unknown state of a tile",
            ));
        }
    })
}

/// Converts a tile of a job.
pub(super) fn tile(view: TileView) -> v1::TileInfo {
    let failure = |f: sightline_records::TileFailure| v1::TileFailure {
        worker: f.worker,
        reason: f.reason,
    };
    v1::TileInfo {
        tile: view.tile.0,
        state: view.status as i32,
        r#box: view
            .bounds
            .map_or_else(Vec::new, |b| b.iter().flat_map(|p| p.to_array()).collect()),
        cells: view.cells,
        cells_done: view.cells_done,
        samples: view.samples,
        millis: view.millis,
        workers: view
            .workers
            .iter()
            .map(|worker| worker_name(worker).to_owned())
            .collect(),
        failures: view.failures.into_iter().map(failure).collect(),
        conflicts: view.conflicts,
        is_pack: view.is_pack,
    }
}

/// Converts an event.
pub(super) fn event(entry: &Entry) -> v1::Event {
    let kind = match entry.what.kind {
        EventKind::Submitted => v1::EventKind::Submitted,
        EventKind::Job => v1::EventKind::Job,
        EventKind::Leased => v1::EventKind::Leased,
        EventKind::Round => v1::EventKind::Round,
        EventKind::Done => v1::EventKind::Done,
        EventKind::TakenBack => v1::EventKind::TakenBack,
        EventKind::Failed => v1::EventKind::Failed,
        EventKind::SetAside => v1::EventKind::SetAside,
        EventKind::Conflict => v1::EventKind::Conflict,
        EventKind::Worker => v1::EventKind::Worker,
        EventKind::Coordinator => v1::EventKind::Coordinator,
        EventKind::Check => v1::EventKind::Check,
    };
    v1::Event {
        number: entry.number,
        at_ms: entry.at_ms,
        kind: kind.into(),
        job: entry.what.job.map_or(0, |job| job.0),
        tile: entry.what.tile.map(|tile| tile.0),
        worker: worker_name(&entry.what.worker).to_owned(),
        text: entry.what.text.clone(),
    }
}
