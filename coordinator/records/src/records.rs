//! The records of scenes, jobs and tiles. `limits.rs` defines the maximum lengths of their texts.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::ids::{Digest, JobId, TileIndex, worker_name};

/// The record of a scene whose blob the coordinator stores.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// The digest of the scene, which is also the name of its blob.
    #[serde(with = "hex_digest")]
    pub digest: Digest,
    /// The size of the blob, in bytes.
    pub bytes: u64,
    /// The number of triangles in the scene.
    pub triangles: u32,
    /// The number of objects in the scene.
    pub objects: u32,
    /// The users who uploaded the scene. A scene with an empty set has no owner.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub owners: BTreeSet<String>,
}

/// A job as a client submits it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewJob {
    /// The digest of the scene, the parameters and, if the job has an owner, the owner ([`owned_key`]). Jobs
    /// with the same key have the same result.
    pub key: Digest,
    /// The request id that the client chose, of at most [`MAX_IDENTIFIER_BYTES`](super::MAX_IDENTIFIER_BYTES)
    /// bytes, without control characters, quotes and backslashes. With an empty id, the store cannot
    /// recognise a repeated submission.
    pub request_id: String,
    /// The display name, of at most [`MAX_NAME_BYTES`](super::MAX_NAME_BYTES) bytes, without control
    /// characters.
    pub name: String,
    /// The owner, of at most [`MAX_OWNER_BYTES`](super::MAX_OWNER_BYTES) bytes. Empty if the coordinator does
    /// not authenticate clients. Jobs of different owners are never merged into one job.
    pub owner: String,
    /// The user who submits the job, of at most [`MAX_NAME_BYTES`](super::MAX_NAME_BYTES) bytes, without
    /// control characters. The scheduler shares the workers evenly among users.
    pub user: String,
    /// The priority. The scheduler prefers jobs with a higher priority.
    pub priority: i32,
    /// The digest of the scene. The store must contain the scene's record.
    pub scene: Digest,
    /// The opaque parameters, of at most [`MAX_SPEC_BYTES`](super::MAX_SPEC_BYTES) bytes.
    pub spec: Vec<u8>,
    /// The number of tiles of the plan, at most [`MAX_TILES`](super::MAX_TILES); 0 if `plan_job` sets it
    /// later.
    pub tiles: u32,
    /// The submission time, in milliseconds since 1970.
    pub submitted_at_ms: u64,
}

/// Returns the key of an owner's job, computed from the job's digest and the owner's name. The digest covers
/// scene and parameters.
///
/// Owners do not share jobs, so that no user learns which jobs other users have submitted.
pub fn owned_key(digest: Digest, owner: &str) -> Digest {
    owned("sightline 2026-11 key of an owned job", &digest, owner)
        .map_or(digest, |hash| *hash.as_bytes())
}

/// Returns the stored request id of an owner's submission. Request ids of different owners always differ.
pub fn owned_request(id: &str, owner: &str) -> String {
    let hash = owned(
        "sightline 2026-11 request of an owner",
        id.as_bytes(),
        owner,
    );
    hash.filter(|_| !id.is_empty())
        .map_or_else(|| id.to_owned(), |hash| hash.to_hex().to_string())
}

fn owned(context: &str, what: &[u8], owner: &str) -> Option<blake3::Hash> {
    (!owner.is_empty()).then(|| {
        let mut hasher = blake3::Hasher::new_derive_key(context);
        hasher
            .update(&(what.len() as u64).to_le_bytes())
            .update(what)
            .update(owner.as_bytes());
        hasher.finalize()
    })
}

/// The answer to a submission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Submitted {
    /// The new job, or the existing job with the same key or the same request id.
    pub id: JobId,
    /// True if the job existed before the submission.
    pub existing: bool,
}

/// The record of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobRecord {
    /// The number of the job, counted from 1 and never reused.
    pub id: JobId,
    /// The digest of the scene, the parameters and, if the job has an owner, the owner ([`owned_key`]).
    #[serde(with = "hex_digest")]
    pub key: Digest,
    /// The request id of the submission.
    pub request_id: String,
    /// The display name.
    pub name: String,
    /// The owner, or an empty text if the job has none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub owner: String,
    /// The user who submitted the job.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub user: String,
    /// The priority. The scheduler prefers jobs with a higher priority.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub priority: i32,
    /// The digest of the scene.
    #[serde(with = "hex_digest")]
    pub scene: Digest,
    /// The opaque parameters.
    #[serde(with = "base64_bytes")]
    pub spec: Vec<u8>,
    /// The number of tiles; 0 while the plan is unknown.
    pub tiles: u32,
    /// The state of the job.
    pub state: JobState,
    /// The numerics profile that the job is bound to, or `None` before the binding.
    pub profile: Option<String>,
    /// The submission time, in milliseconds since 1970.
    pub submitted_at_ms: u64,
    /// The time at which the job ended, in milliseconds since 1970; `None` while the job has not ended.
    pub finished_at_ms: Option<u64>,
    /// The epoch in which tiles of the job were last reopened because they were no longer trusted.
    ///
    /// Results that workers computed under leases of this epoch or of earlier epochs may depend on results
    /// that are no longer trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reopened_epoch: Option<u64>,
}

/// The state of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobState {
    /// The job waits for its first lease.
    Queued,
    /// At least one tile was leased.
    Running,
    /// The scheduler leases no tiles until a client resumes the job.
    Paused,
    /// A client cancelled the job.
    Cancelled,
    /// A fault ended the job.
    Failed {
        /// The reason, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES).
        reason: String,
    },
    /// The job ended with a result.
    Done {
        /// The digest of the result's blob.
        #[serde(with = "hex_digest")]
        result: Digest,
        /// The size of the result's blob, in bytes.
        bytes: u64,
    },
}

/// The state of a job without the data of [`JobState`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum JobPhase {
    /// See [`JobState::Queued`].
    Queued,
    /// See [`JobState::Running`].
    Running,
    /// See [`JobState::Paused`].
    Paused,
    /// See [`JobState::Cancelled`].
    Cancelled,
    /// See [`JobState::Failed`].
    Failed,
    /// See [`JobState::Done`].
    Done,
}

impl JobState {
    /// Returns the state without its data.
    pub fn phase(&self) -> JobPhase {
        match self {
            Self::Queued => JobPhase::Queued,
            Self::Running => JobPhase::Running,
            Self::Paused => JobPhase::Paused,
            Self::Cancelled => JobPhase::Cancelled,
            Self::Failed { .. } => JobPhase::Failed,
            Self::Done { .. } => JobPhase::Done,
        }
    }
}

impl std::fmt::Display for JobPhase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Cancelled => "cancelled",
            Self::Failed => "failed",
            Self::Done => "done",
        })
    }
}

impl JobPhase {
    /// Returns true if the job has ended (cancelled, failed or done).
    pub fn ended(self) -> bool {
        matches!(self, Self::Cancelled | Self::Failed | Self::Done)
    }
}

/// The record of a tile of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileRecord {
    /// The index of the tile in the plan.
    pub tile: TileIndex,
    /// The state of the tile.
    pub state: TileState,
    /// The workers on which the tile failed, with the last reason of each; at most
    /// [`MAX_FAILURES`](super::MAX_FAILURES) workers.
    pub failures: Vec<TileFailure>,
    /// The number of differing results that the store rejected after the tile was done. Any number except 0
    /// indicates a fault to investigate.
    pub conflicts: u32,
    /// The confirmation by another worker that computed the same result; `None` without a confirmation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub check: Option<TileCheck>,
}

/// A confirmation of a done tile: another worker computed the same bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileCheck {
    /// The signature of the confirming worker.
    pub worker: String,
    /// The time of the confirmation, in milliseconds since 1970.
    pub at_ms: u64,
}

/// The record of a quarantined worker, which gets no tiles because its results differed from other workers'.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineRecord {
    /// The name of the worker.
    pub worker: String,
    /// The start of the quarantine, in milliseconds since 1970.
    pub at_ms: u64,
    /// The reason, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES) bytes.
    pub reason: String,
}

/// The clocks by which retention measures ages. The coordinator records them from time to time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RetentionStamp {
    /// The wall clock, in milliseconds since 1970.
    pub wall_ms: u64,
    /// The total time that coordinators have run on this store, in milliseconds of their monotonic clocks.
    pub ran_ms: u64,
    /// The trusted span for the ages of ended jobs and of scenes.
    pub jobs: TrustedSpan,
    /// The trusted span for the ages of blobs.
    pub blobs: TrustedSpan,
}

/// A span of run time, up to the present, in which the wall clock and the monotonic clock agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrustedSpan {
    /// The start of the span, on the scale of [`RetentionStamp::ran_ms`], in milliseconds.
    pub begun_ms: u64,
    /// The sum of the clocks' disagreements in the span, in milliseconds. Disagreements are downtimes, whose
    /// length only the wall clock shows, and small clock steps.
    pub doubt_ms: u64,
    /// The next span, which starts when this span's doubt is too large. The next span replaces this span once
    /// the next span is as long as the age at which retention deletes data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextSpan>,
}

/// A trusted span that is still shorter than the age at which retention deletes data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NextSpan {
    /// The start of the span, on the scale of [`RetentionStamp::ran_ms`], in milliseconds.
    pub begun_ms: u64,
    /// The sum of the disagreements since the start of the span; see [`TrustedSpan::doubt_ms`].
    pub doubt_ms: u64,
}

impl TileRecord {
    /// Creates the record of an open tile without failures.
    pub fn open(tile: TileIndex) -> Self {
        Self {
            tile,
            state: TileState::Open,
            failures: Vec::new(),
            conflicts: 0,
            check: None,
        }
    }
}

/// The state of a tile.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TileState {
    /// The tile has no result.
    Open,
    /// The tile's result is committed.
    Done {
        /// The digest of the result's blob.
        #[serde(with = "hex_digest")]
        digest: Digest,
        /// The size of the result's blob, in bytes.
        bytes: u64,
        /// The cost of computing the result.
        stats: TileStats,
    },
    /// The tile failed too often. The job's result marks the tile's cells as set aside, and their sets
    /// contain all triangles, as undecided.
    SetAside {
        /// The digest of the placeholder's blob.
        #[serde(with = "hex_digest")]
        digest: Digest,
        /// The size of the placeholder's blob, in bytes.
        bytes: u64,
        /// The reasons of the failures, at most [`MAX_REASONS`](super::MAX_REASONS).
        reasons: Vec<String>,
    },
}

/// The cost of computing a tile's result.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileStats {
    /// The number of rendered samples.
    pub samples: u64,
    /// The number of view cells in the tile.
    pub cells: u64,
    /// The computing time of the worker, in milliseconds.
    pub millis: u64,
    /// The signature of the worker, of at most [`MAX_SIGNATURE_BYTES`](super::MAX_SIGNATURE_BYTES) bytes.
    pub worker: String,
    /// The other workers that contributed: helpers, and workers whose outcomes the tile was continued from;
    /// at most [`MAX_HELPERS`](super::MAX_HELPERS).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub helpers: Vec<String>,
    /// The number of further helpers, which `helpers` does not name.
    #[serde(default, skip_serializing_if = "is_zero_count")]
    pub unnamed: u32,
    /// The commit time, in milliseconds since 1970; 0 in records of earlier versions.
    #[serde(default, skip_serializing_if = "is_zero_time")]
    pub at_ms: u64,
}

impl TileStats {
    /// Returns true if a worker with this name or signature may have contributed to the result.
    pub fn may_be_of(&self, name: &str) -> bool {
        let is_meant = |signature: &str| signature == name || worker_name(signature) == name;
        is_meant(&self.worker)
            || self.unnamed > 0
            || self.helpers.iter().any(|helper| is_meant(helper))
    }
}

/// The failure of a tile on one worker.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileFailure {
    /// The name of the worker.
    pub worker: String,
    /// The description of the failure, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES) bytes.
    pub reason: String,
}

/// A tile's result as the coordinator commits it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileResult {
    /// The digest of the result's blob, which must already be stored.
    pub digest: Digest,
    /// The size of the result's blob, in bytes.
    pub bytes: u64,
    /// The cost of computing the result.
    pub stats: TileStats,
}

/// The outcome of committing a tile's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitOutcome {
    /// The tile is now done.
    Committed,
    /// The tile was already done with the same digest.
    AlreadySame,
    /// The tile was already done with another digest. The store rejects the offered result.
    Conflict {
        /// The digest that the tile keeps.
        kept: Digest,
        /// The rejected digest.
        offered: Digest,
    },
}

/// Returns true if a priority is 0, so that jobs without a priority keep their earlier record format.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde calls it with a reference"
)]
fn is_zero(n: &i32) -> bool {
    *n == 0
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde calls it with a reference"
)]
fn is_zero_count(n: &u32) -> bool {
    *n == 0
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde calls it with a reference"
)]
fn is_zero_time(at: &u64) -> bool {
    *at == 0
}

/// Serialization of digests as 64 hexadecimal digits.
///
/// The text has half the size of JSON's list of numbers, and is also the form in logs and file names.
pub mod hex_digest {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use crate::ids::Digest;

    /// Serializes a digest.
    ///
    /// # Errors
    /// The error of the serializer.
    pub fn serialize<S: Serializer>(digest: &Digest, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(blake3::Hash::from_bytes(*digest).to_hex().as_str())
    }

    /// Deserializes a digest.
    ///
    /// # Errors
    /// An error if the text does not consist of 64 hexadecimal digits.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Digest, D::Error> {
        let text = String::deserialize(from)?;
        blake3::Hash::from_hex(&text)
            .map(Into::into)
            .map_err(D::Error::custom)
    }
}

/// Serialization of opaque bytes as base64, which has 4/3 of their size.
///
/// With base64, a job with a specification of the maximum size stays below 4 KiB.
mod base64_bytes {
    use base64::{Engine, engine::general_purpose::STANDARD_NO_PAD};
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(bytes: &[u8], to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&STANDARD_NO_PAD.encode(bytes))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u8>, D::Error> {
        let text = String::deserialize(from)?;
        STANDARD_NO_PAD.decode(text).map_err(D::Error::custom)
    }
}
