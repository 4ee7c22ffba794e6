//! The rules of the commands: the event of each command in a given state, and the changes of each event.
//!
//! Decisions only read. An event contains all data that its application needs, so replaying the journal uses
//! no rule except [`changes`]. The journal stores events, so their names and fields here are its format. New
//! variants and `#[serde(default)]` fields are compatible; changing an existing one needs a new journal
//! version.

use serde::{Deserialize, Serialize};
use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, RetentionStamp,
    SceneRecord, Submitted, TileFailure, TileRecord, TileResult, TileState,
};
use sightline_records::{
    MAX_FAILURES, MAX_HELPERS, MAX_IDENTIFIER_BYTES, MAX_NAME_BYTES, MAX_OWNER_BYTES, MAX_OWNERS,
    MAX_REASONS, MAX_SIGNATURE_BYTES, MAX_SPEC_BYTES, MAX_TILES, MAX_WORKER_BYTES,
};

use super::entries::Entry;
use super::error::StoreError;
use super::identity::StoreIdentity;
use super::limits::{check_identifier, check_length, check_name, clean_reason};
use super::table::{Bytes, ChangedTable, Changes, Table, View, encode, key};

/// A change of the state, as the journal records it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum StateChange {
    /// A scene was recorded.
    SceneRecorded(SceneRecord),
    /// A job was submitted under the next id.
    JobSubmitted(JobRecord),
    /// A submission was answered with an existing job.
    RequestJoined { request_id: String, job: JobId },
    /// A job changed: it was planned, bound to a profile, or moved to another state.
    JobChanged(JobRecord),
    /// A tile changed: it was done, failed once more or set aside, or a conflict was counted.
    TileChanged { job: JobId, tile: TileRecord },
    /// Tiles were reopened for another attempt, together with their job.
    TilesReopened {
        job: JobRecord,
        tiles: Vec<TileIndex>,
    },
    /// A coordinator started.
    EpochBegun(u64),
    /// A job was removed.
    JobDeleted { job: JobId },
    /// A worker was quarantined and gets no tiles.
    Quarantined(QuarantineRecord),
    /// The quarantine of a worker ended.
    Released { worker: String },
    /// The clocks of retention were recorded.
    RetentionStamped(RetentionStamp),
    /// A scene was removed.
    SceneDeleted {
        #[serde(with = "sightline_records::hex_digest")]
        scene: Digest,
    },
    /// The store received its identity.
    Identified(StoreIdentity),
    /// Entries of another store were imported, or entries of this store before its journal was compacted.
    /// Keys are hexadecimal digits, and values are base64.
    Imported { entries: Vec<(String, String)> },
}

/// A decision on a command: the event, if there is a change, and the answer. The answer is sent once the
/// event is durable.
pub(super) struct Decision<A> {
    pub(super) event: Option<StateChange>,
    pub(super) answer: A,
}

pub(super) type Decided<A> = Result<Decision<A>, StoreError>;

pub(super) fn unchanged<A>(answer: A) -> Decided<A> {
    Ok(Decision {
        event: None,
        answer,
    })
}

pub(super) fn happened<A>(event: StateChange, answer: A) -> Decided<A> {
    Ok(Decision {
        event: Some(event),
        answer,
    })
}

/// Returns the changes that an event makes to a table.
pub(super) fn changes(event: &StateChange, table: &dyn Table) -> Result<Changes, StoreError> {
    let view = View(table);
    let mut changes = Changes::new();
    let mut put = |key: Bytes, value: Bytes| changes.insert(key, Some(value));
    match event {
        StateChange::SceneRecorded(scene) => {
            let key = key::scene(&scene.digest);
            let value = encode(&key, scene)?;
            put(key, value);
        }
        StateChange::JobSubmitted(job) => {
            let key = key::job(job.id);
            let value = encode(&key, job)?;
            put(key, value);
            let key = key::job_of_key(&job.key, job.id);
            let value = encode(&key, &job.id)?;
            put(key, value);
            put(
                key::NEXT_JOB.to_vec(),
                encode(key::NEXT_JOB, &JobId(job.id.0.saturating_add(1)))?,
            );
            if !job.request_id.is_empty() {
                let key = key::request(&job.request_id);
                let value = encode(&key, &job.id)?;
                put(key, value);
            }
        }
        StateChange::RequestJoined { request_id, job } => {
            let key = key::request(request_id);
            let value = encode(&key, job)?;
            put(key, value);
        }
        StateChange::JobChanged(job) => {
            let key = key::job(job.id);
            let value = encode(&key, job)?;
            put(key, value);
        }
        StateChange::TileChanged { job, tile } => {
            let key = key::tile(*job, tile.tile);
            let value = encode(&key, tile)?;
            put(key, value);
        }
        StateChange::TilesReopened { job, tiles } => {
            for &tile in tiles {
                changes.insert(key::tile(job.id, tile), None);
            }
            let key = key::job(job.id);
            let value = encode(&key, job)?;
            changes.insert(key, Some(value));
        }
        StateChange::Quarantined(record) => {
            let key = key::quarantined(&record.worker);
            let value = encode(&key, record)?;
            put(key, value);
        }
        StateChange::RetentionStamped(stamp) => {
            put(
                key::RETENTION_STAMP.to_vec(),
                encode(key::RETENTION_STAMP, stamp)?,
            );
        }
        StateChange::SceneDeleted { scene } => {
            changes.insert(key::scene(scene), None);
        }
        StateChange::Imported { entries } => {
            for (key, text) in entries {
                let (key, value) = Entry::read(key, text)?;
                changes.insert(key, Some(value));
            }
        }
        StateChange::Released { worker } => {
            changes.insert(key::quarantined(worker), None);
        }
        StateChange::Identified(identity) => {
            put(key::IDENTITY.to_vec(), encode(key::IDENTITY, identity)?);
        }
        StateChange::EpochBegun(epoch) => {
            put(key::EPOCH.to_vec(), encode(key::EPOCH, epoch)?);
        }
        StateChange::JobDeleted { job } => {
            let record = view.known_job(*job)?;
            changes.insert(key::job(*job), None);
            changes.insert(key::job_of_key(&record.key, *job), None);
            for request in view.requests_of(*job)? {
                changes.insert(request, None);
            }
            for (key, _) in table.scan(&key::tiles(*job))? {
                changes.insert(key, None);
            }
        }
    }
    Ok(changes)
}

/// Decodes the events of a frame of the journal that ends at `before`.
pub(super) fn events(payload: &[u8], before: u64) -> Result<Vec<StateChange>, StoreError> {
    serde_json::from_slice(payload).map_err(|e| StoreError::Unreadable {
        before,
        what: e.to_string(),
    })
}

/// Adds the changes of an event to `staged`. The event happens after the changes in `staged`.
pub(super) fn stage(
    event: &StateChange,
    table: &dyn Table,
    staged: &mut Changes,
) -> Result<(), StoreError> {
    let new = changes(
        event,
        &ChangedTable {
            under: table,
            changes: staged,
        },
    )?;
    staged.extend(new);
    Ok(())
}

pub(super) fn record_scene(view: View<'_>, scene: SceneRecord) -> Decided<()> {
    match view.scene(&scene.digest)? {
        None => happened(StateChange::SceneRecorded(scene), ()),
        // Another user has uploaded the same scene.
        Some(mut known)
            if (SceneRecord {
                owners: scene.owners.clone(),
                ..known.clone()
            }) == scene =>
        {
            let before = known.owners.len();
            known.owners.extend(scene.owners);
            check_length(
                "the list of a scene's owners",
                known.owners.len(),
                "users",
                MAX_OWNERS,
            )?;
            if known.owners.len() == before {
                unchanged(())
            } else {
                happened(StateChange::SceneRecorded(known), ())
            }
        }
        Some(_) => Err(StoreError::SceneDiffers {
            scene: scene.digest,
        }),
    }
}

pub(super) fn submit_job(view: View<'_>, new: NewJob) -> Decided<Submitted> {
    check_identifier("the request id", &new.request_id, MAX_IDENTIFIER_BYTES)?;
    check_name("the job's name", &new.name, MAX_NAME_BYTES)?;
    let most = if new.owner.is_empty() {
        MAX_NAME_BYTES
    } else {
        MAX_OWNER_BYTES
    };
    check_name("the user's name", &new.user, most)?;
    check_identifier("the owner's name", &new.owner, MAX_OWNER_BYTES)?;
    check_length(
        "the job's specification",
        new.spec.len(),
        "bytes",
        MAX_SPEC_BYTES,
    )?;
    check_length("the plan", new.tiles as usize, "tiles", MAX_TILES as usize)?;
    if let Some(known) = view.job_by_request(&new.request_id)? {
        if known.key != new.key {
            return Err(StoreError::RequestIdReused {
                request_id: new.request_id,
                job: known.id,
            });
        }
        return unchanged(Submitted {
            id: known.id,
            existing: true,
        });
    }
    if let Some(same) = view.job_by_key(&new.key)?
        && !matches!(same.state.phase(), JobPhase::Failed | JobPhase::Cancelled)
    {
        let answer = Submitted {
            id: same.id,
            existing: true,
        };
        if new.request_id.is_empty() {
            return unchanged(answer);
        }
        return happened(
            StateChange::RequestJoined {
                request_id: new.request_id,
                job: same.id,
            },
            answer,
        );
    }
    if view.scene(&new.scene)?.is_none() {
        return Err(StoreError::UnknownScene { scene: new.scene });
    }
    let job = JobRecord {
        id: view.next_job()?,
        key: new.key,
        request_id: new.request_id,
        name: new.name,
        owner: new.owner,
        user: new.user,
        priority: new.priority,
        scene: new.scene,
        spec: new.spec,
        tiles: new.tiles,
        state: JobState::Queued,
        profile: None,
        submitted_at_ms: new.submitted_at_ms,
        finished_at_ms: None,
        reopened_epoch: None,
    };
    let answer = Submitted {
        id: job.id,
        existing: false,
    };
    happened(StateChange::JobSubmitted(job), answer)
}

pub(super) fn prioritize_job(view: View<'_>, job: JobId, priority: i32) -> Decided<JobRecord> {
    let mut record = view.known_job(job)?;
    if record.state.phase().ended() {
        return Err(illegal(job, record.state.phase(), "given a priority"));
    }
    if record.priority == priority {
        return unchanged(record);
    }
    record.priority = priority;
    happened(StateChange::JobChanged(record.clone()), record)
}

pub(super) fn plan_job(view: View<'_>, job: JobId, tiles: u32) -> Decided<JobRecord> {
    check_length("the plan", tiles as usize, "tiles", MAX_TILES as usize)?;
    let mut record = view.known_job(job)?;
    if record.tiles == tiles {
        return unchanged(record);
    }
    if record.tiles != 0 {
        return Err(StoreError::PlanDiffers {
            job,
            kept: record.tiles,
            offered: tiles,
        });
    }
    if record.state.phase().ended() {
        return Err(illegal(job, record.state.phase(), "planned"));
    }
    record.tiles = tiles;
    happened(StateChange::JobChanged(record.clone()), record)
}

pub(super) fn bind_profile(view: View<'_>, job: JobId, profile: String) -> Decided<String> {
    check_identifier("the numerics profile", &profile, MAX_IDENTIFIER_BYTES)?;
    let mut record = view.known_job(job)?;
    if let Some(bound) = record.profile {
        return unchanged(bound);
    }
    record.profile = Some(profile.clone());
    happened(StateChange::JobChanged(record), profile)
}

pub(super) fn commit_tile(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    result: TileResult,
) -> Decided<CommitOutcome> {
    check_identifier(
        "the worker's name",
        &result.stats.worker,
        MAX_SIGNATURE_BYTES,
    )?;
    check_length(
        "the list of helpers",
        result.stats.helpers.len(),
        "workers",
        MAX_HELPERS,
    )?;
    for helper in &result.stats.helpers {
        check_identifier("a helper's name", helper, MAX_SIGNATURE_BYTES)?;
    }
    let (record, mut found) = view.job_and_tile(job, tile)?;
    if let TileState::Done { digest: kept, .. } = found.state {
        if kept == result.digest {
            return unchanged(CommitOutcome::AlreadySame);
        }
        found.conflicts = found.conflicts.saturating_add(1);
        let answer = CommitOutcome::Conflict {
            kept,
            offered: result.digest,
        };
        return happened(StateChange::TileChanged { job, tile: found }, answer);
    }
    if record.state.phase().ended() {
        return Err(illegal(job, record.state.phase(), "given results"));
    }
    let TileResult {
        digest,
        bytes,
        stats,
    } = result;
    found.state = TileState::Done {
        digest,
        bytes,
        stats,
    };
    found.check = None;
    happened(
        StateChange::TileChanged { job, tile: found },
        CommitOutcome::Committed,
    )
}

pub(super) fn fail_tile(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    worker: String,
    reason: &str,
) -> Decided<u32> {
    check_identifier("the worker's name", &worker, MAX_WORKER_BYTES)?;
    let (record, mut found) = view.job_and_tile(job, tile)?;
    // The length is at most MAX_FAILURES, so the cast cannot truncate.
    let count = |tile: &TileRecord| tile.failures.len() as u32;
    if found.state != TileState::Open || record.state.phase().ended() {
        return unchanged(count(&found));
    }
    let failure = TileFailure {
        worker,
        reason: clean_reason(reason),
    };
    match found
        .failures
        .iter()
        .position(|known| known.worker == failure.worker)
    {
        Some(at) if found.failures[at] == failure => return unchanged(count(&found)),
        Some(at) => found.failures[at] = failure,
        None if found.failures.len() < MAX_FAILURES => found.failures.push(failure),
        None => return unchanged(count(&found)),
    }
    let answer = count(&found);
    happened(StateChange::TileChanged { job, tile: found }, answer)
}

/// Records the death of a worker as a failure of a tile, unless a failure is already recorded.
pub(super) fn count_death(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    worker: String,
    reason: &str,
) -> Decided<u32> {
    let (_, found) = view.job_and_tile(job, tile)?;
    if found.failures.iter().any(|known| known.worker == worker) {
        // The length is at most MAX_FAILURES, so the cast cannot truncate.
        return unchanged(found.failures.len() as u32);
    }
    fail_tile(view, job, tile, worker, reason)
}

pub(super) fn forget_failure(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    worker: &str,
    reason: &str,
) -> Decided<()> {
    let (record, mut found) = view.job_and_tile(job, tile)?;
    let reason = clean_reason(reason);
    let is_meant = |failure: &TileFailure| failure.worker == worker && failure.reason == reason;
    let known = found.failures.len();
    found.failures.retain(|failure| !is_meant(failure));
    if found.state != TileState::Open
        || record.state.phase().ended()
        || found.failures.len() == known
    {
        return unchanged(());
    }
    happened(StateChange::TileChanged { job, tile: found }, ())
}

pub(super) fn set_aside_tile(
    view: View<'_>,
    job: JobId,
    tile: TileIndex,
    digest: Digest,
    bytes: u64,
    reasons: &[String],
) -> Decided<()> {
    let (record, mut found) = view.job_and_tile(job, tile)?;
    match found.state {
        TileState::SetAside { digest: known, .. } if known == digest => return unchanged(()),
        TileState::Open => {}
        _ => return Err(StoreError::TileNotOpen { job, tile }),
    }
    if record.state.phase().ended() {
        return Err(illegal(job, record.state.phase(), "given results"));
    }
    let reasons = reasons
        .iter()
        .take(MAX_REASONS)
        .map(|reason| clean_reason(reason))
        .collect();
    found.state = TileState::SetAside {
        digest,
        bytes,
        reasons,
    };
    happened(StateChange::TileChanged { job, tile: found }, ())
}

/// Creates the error of a rejected transition.
fn illegal(job: JobId, is: JobPhase, wanted: &'static str) -> StoreError {
    StoreError::IllegalTransition { job, is, wanted }
}

/// Returns true if `set_job_state` may move a job from `from` to `to`.
fn may_move(from: JobPhase, to: JobPhase) -> bool {
    use JobPhase::{Cancelled, Done, Failed, Paused, Queued, Running};
    match (from, to) {
        (Queued | Running | Paused, Queued | Running | Paused | Cancelled | Failed) => true,
        // A cancellation can be undone. A failed job is retried through reopen_tiles, which removes the
        // failures.
        (Cancelled, Queued) => true,
        (Cancelled | Failed | Done, _) | (_, Done) => false,
    }
}

pub(super) fn set_job_state(
    view: View<'_>,
    job: JobId,
    from: &[JobPhase],
    to: JobState,
    at_ms: u64,
) -> Decided<JobRecord> {
    let to = match to {
        JobState::Failed { reason } => JobState::Failed {
            reason: clean_reason(&reason),
        },
        other => other,
    };
    let mut record = view.known_job(job)?;
    if record.state == to {
        return unchanged(record);
    }
    let (is, phase) = (record.state.phase(), to.phase());
    if !from.contains(&is) || !may_move(is, phase) {
        let wanted = match phase {
            // A resumed job becomes queued.
            JobPhase::Queued => "resumed",
            JobPhase::Running => "run",
            JobPhase::Paused => "paused",
            JobPhase::Cancelled => "cancelled",
            JobPhase::Failed => "failed",
            JobPhase::Done => "done without finish_job",
        };
        return Err(illegal(job, is, wanted));
    }
    record.state = to;
    record.finished_at_ms = phase.ended().then_some(at_ms);
    happened(StateChange::JobChanged(record.clone()), record)
}

pub(super) fn finish_job(
    view: View<'_>,
    job: JobId,
    result: Digest,
    bytes: u64,
    at_ms: u64,
) -> Decided<JobRecord> {
    let mut record = view.known_job(job)?;
    match record.state {
        JobState::Done { result: kept, .. } if kept == result => return unchanged(record),
        JobState::Done { result: kept, .. } => {
            return Err(StoreError::ResultDiffers {
                job,
                kept,
                offered: result,
            });
        }
        JobState::Queued | JobState::Running => {}
        JobState::Paused | JobState::Cancelled | JobState::Failed { .. } => {
            return Err(illegal(job, record.state.phase(), "finished"));
        }
    }
    let ended = view
        .recorded_tiles(job)?
        .iter()
        .filter(|tile| tile.state != TileState::Open)
        .count();
    // At most as many tiles are recorded as the job has (`job_and_tile`), and that number is a u32.
    let open = record.tiles.saturating_sub(ended as u32);
    if open > 0 {
        return Err(StoreError::TilesOpen {
            job,
            open,
            tiles: record.tiles,
        });
    }
    record.state = JobState::Done { result, bytes };
    record.finished_at_ms = Some(at_ms);
    happened(StateChange::JobChanged(record.clone()), record)
}

pub(super) fn reopen_tiles(view: View<'_>, job: JobId) -> Decided<u32> {
    let mut record = view.known_job(job)?;
    let recorded = view.recorded_tiles(job)?;
    let set_aside = recorded
        .iter()
        .filter(|tile| matches!(tile.state, TileState::SetAside { .. }))
        .count() as u32;
    let tiles: Vec<TileIndex> = recorded
        .iter()
        .filter(|tile| !matches!(tile.state, TileState::Done { .. }))
        .map(|tile| tile.tile)
        .collect();
    let requeue = match record.state.phase() {
        JobPhase::Failed | JobPhase::Cancelled => true,
        JobPhase::Done => set_aside > 0,
        JobPhase::Queued | JobPhase::Running | JobPhase::Paused => false,
    };
    if tiles.is_empty() && !requeue {
        return unchanged(0);
    }
    if requeue {
        record.state = JobState::Queued;
        record.finished_at_ms = None;
    }
    happened(StateChange::TilesReopened { job: record, tiles }, set_aside)
}

pub(super) fn stamp_retention(view: View<'_>, stamp: RetentionStamp) -> Decided<()> {
    if view.retention_stamp()? == Some(stamp) {
        return unchanged(());
    }
    happened(StateChange::RetentionStamped(stamp), ())
}

pub(super) fn begin_epoch(view: View<'_>) -> Decided<u64> {
    let epoch = view.epoch()?.saturating_add(1);
    happened(StateChange::EpochBegun(epoch), epoch)
}

pub(super) fn delete_job(view: View<'_>, job: JobId) -> Decided<JobRecord> {
    let record = view.known_job(job)?;
    if !record.state.phase().ended() {
        return Err(illegal(job, record.state.phase(), "deleted"));
    }
    happened(StateChange::JobDeleted { job }, record)
}
