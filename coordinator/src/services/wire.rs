//! Translation of values between the wire format and the coordinator's types.

use sightline_proto::v1;
use tonic::Status;

use crate::estimate::Estimate;
use crate::ids::{Digest, Epoch, JobId, Lease, LeaseId, TileIndex};
use crate::jobs::Summary;
use crate::scheduler::{Order, ProfileTime, Team, Unable};
use crate::specs;
use crate::store::{JobState, SceneRecord};

/// A digest from the wire.
///
/// # Errors
/// INVALID_ARGUMENT when it does not have 32 bytes.
pub(super) fn digest(bytes: &[u8]) -> Result<Digest, Status> {
    bytes.try_into().map_err(|_| {
        Status::invalid_argument(format!(
            "a digest of {} bytes was given; give the 32 of BLAKE3",
            bytes.len()
        ))
    })
}

/// A lease from the wire.
pub(super) fn lease(l: &v1::Lease) -> Lease {
    let id = LeaseId { epoch: Epoch(l.epoch), number: l.lease };
    Lease { job: JobId(l.job), tile: TileIndex(l.tile), id }
}

/// A lease for the wire.
pub(super) fn to_lease(l: &Lease) -> v1::Lease {
    v1::Lease { job: l.job.0, tile: l.tile.0, epoch: l.id.epoch.0, lease: l.id.number }
}

/// The measured times of a worker's backends.
pub(super) fn times(times: Vec<v1::ProfileTime>) -> Vec<ProfileTime> {
    let time = |t: v1::ProfileTime| ProfileTime { profile: t.profile, seconds_per_cube: t.seconds_per_cube };
    times.into_iter().map(time).collect()
}

/// An order to a worker.
pub(super) fn order(order: Order) -> v1::CoordinatorMessage {
    use v1::coordinator_message::Message;
    let message = match order {
        Order::Grant(grant) => Message::Grant(v1::Grant {
            lease: Some(to_lease(&grant.lease)),
            spec: Some(grant.spec.to_proto()),
            profile: grant.profile,
            // A pack that is absent has an empty digest; the worker then reports the tile as failed.
            packs: grant.packs.iter().map(|d| d.map_or_else(Vec::new, |d| d.to_vec())).collect(),
            millis: grant.millis,
        }),
        Order::Revoke(lease) => Message::Revoke(v1::Revoke { lease: Some(to_lease(&lease)) }),
        Order::Help(help) => Message::Help(v1::Help {
            lease: Some(to_lease(&help.lease)),
            spec: Some(help.spec.to_proto()),
            profile: help.profile,
        }),
        Order::Time { job, spec } => Message::Time(v1::Time { job: job.0, spec: Some(spec.to_proto()) }),
    };
    v1::CoordinatorMessage { message: Some(message) }
}

/// A scene's record.
pub(super) fn scene(record: &SceneRecord) -> v1::SceneInfo {
    let SceneRecord { digest, triangles, objects, .. } = record;
    v1::SceneInfo { digest: digest.to_vec(), triangles: *triangles, objects: *objects }
}

/// Workers that cannot work on a job.
pub(super) fn unable(unable: Unable) -> v1::UnableWorkers {
    let Unable { reason, workers, names } = unable;
    v1::UnableWorkers { reason, workers, names }
}

/// Who works on a tile.
pub(super) fn team(team: Team) -> v1::Team {
    let Team { tile, leader, has_begun, helpers } = team;
    v1::Team { tile: tile.0, leader, has_begun, helpers }
}

/// What a submission would cost.
pub(super) fn estimate(estimate: Estimate) -> v1::EstimateResponse {
    let Estimate { tiles, cells, existing, jobs_before, workers, cost } = estimate;
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
    v1::EstimateResponse { tiles, cells, existing, jobs_before, workers, cost }
}

/// A job's summary.
pub(super) fn job(summary: &Summary) -> v1::Job {
    let record = &summary.record;
    let mut job = v1::Job {
        id: record.id.0,
        name: record.name.clone(),
        // An unreadable specification is shown as absent; the record keeps its bytes. The viewpoints may be
        // large, and a list has many jobs.
        spec: specs::part(&record.spec).ok().map(|(spec, _)| without_large_parts(spec)),
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
        ..v1::Job::default()
    };
    let state = match &record.state {
        JobState::Queued => v1::JobState::Queued,
        JobState::Running => v1::JobState::Running,
        JobState::Paused => v1::JobState::Paused,
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

/// A specification without its viewpoints and its tree of boxes.
fn without_large_parts(spec: v1::JobSpec) -> v1::JobSpec {
    let is_tree = |division: &v1::job_spec::Division| matches!(division, v1::job_spec::Division::Tree(_));
    let division = spec.division.filter(|division| !is_tree(division));
    v1::JobSpec { viewpoints: Vec::new(), division, ..spec }
}
