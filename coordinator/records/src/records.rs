//! The records of scenes, jobs and tiles. `limits.rs` has the limits of their texts.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::ids::{Digest, JobId, TileIndex, worker_name};

/// A scene the coordinator holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Digest of the scene, the name of its blob.
    #[serde(with = "hex_digest")]
    pub digest: Digest,
    /// Size of the blob.
    pub bytes: u64,
    /// Triangles in it.
    pub triangles: u32,
    /// Objects in it.
    pub objects: u32,
    /// The users who have sent it; without any it belongs to nobody.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub owners: BTreeSet<String>,
}

/// A job as it is submitted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewJob {
    /// Digest of scene and parameters: jobs of one key have one result.
    pub key: Digest,
    /// Chosen by the client, ≤ [`MAX_IDENTIFIER_BYTES`](super::MAX_IDENTIFIER_BYTES), no control characters,
    /// quotes or backslashes; empty: the submission cannot be recognised when repeated.
    pub request_id: String,
    /// For people; ≤ [`MAX_NAME_BYTES`](super::MAX_NAME_BYTES), no control characters.
    pub name: String,
    /// Whose it is, ≤ [`MAX_OWNER_BYTES`](super::MAX_OWNER_BYTES); empty where nobody is asked. Jobs of
    /// different owners are never one job.
    pub owner: String,
    /// Who submits it; ≤ [`MAX_NAME_BYTES`](super::MAX_NAME_BYTES), no control characters. Users share the
    /// workers evenly.
    pub user: String,
    /// Jobs of higher priority come first.
    pub priority: i32,
    /// Digest of a recorded scene.
    pub scene: Digest,
    /// The parameters, opaque here; ≤ [`MAX_SPEC_BYTES`](super::MAX_SPEC_BYTES).
    pub spec: Vec<u8>,
    /// Tiles of the plan, ≤ [`MAX_TILES`](super::MAX_TILES); 0 if it is set later by `plan_job`.
    pub tiles: u32,
    /// Milliseconds since 1970.
    pub submitted_at_ms: u64,
}

/// The key of a job of an owner, from the digest of scene and parameters: users do not share jobs, so that
/// nobody learns what others have submitted.
pub fn owned_key(digest: Digest, owner: &str) -> Digest {
    owned("sightline 2026-11 key of an owned job", &digest, owner)
        .map_or(digest, |hash| *hash.as_bytes())
}

/// The request id of an owner's submission: ids of different users are never the same.
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
    /// The job that answers it.
    pub id: JobId,
    /// Whether that job existed before.
    pub existing: bool,
}

/// A job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobRecord {
    /// Counted from 1, never given out twice.
    pub id: JobId,
    /// Digest of scene and parameters.
    #[serde(with = "hex_digest")]
    pub key: Digest,
    /// The request id it was submitted with.
    pub request_id: String,
    /// For people.
    pub name: String,
    /// Whose it is.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub owner: String,
    /// Who submitted it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub user: String,
    /// Jobs of higher priority come first.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub priority: i32,
    /// Digest of its scene.
    #[serde(with = "hex_digest")]
    pub scene: Digest,
    /// The parameters, opaque here.
    #[serde(with = "base64_bytes")]
    pub spec: Vec<u8>,
    /// Number of tiles; 0 until its plan is known.
    pub tiles: u32,
    /// Its state.
    pub state: JobState,
    /// The numerics profile it is bound to, once it is.
    pub profile: Option<String>,
    /// Milliseconds since 1970.
    pub submitted_at_ms: u64,
    /// Milliseconds since 1970, once it has ended.
    pub finished_at_ms: Option<u64>,
    /// The epoch in which tiles of it were opened again last, if some were. What is computed under leases of
    /// this epoch and of earlier ones may come from what is not believed any more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reopened_epoch: Option<u64>,
}

/// The state of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobState {
    /// Waiting for its first lease.
    Queued,
    /// Tiles were leased.
    Running,
    /// No tiles are leased until it is resumed.
    Paused,
    /// Ended by a client.
    Cancelled,
    /// Ended by a fault.
    Failed {
        /// The reason, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES).
        reason: String,
    },
    /// Ended with a result.
    Done {
        /// Digest of the result's blob.
        #[serde(with = "hex_digest")]
        result: Digest,
        /// Size of that blob.
        bytes: u64,
    },
}

/// [`JobState`] without its data.
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
    /// The state without its data.
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
    /// Whether the job has ended (cancelled, failed or done).
    pub fn ended(self) -> bool {
        matches!(self, Self::Cancelled | Self::Failed | Self::Done)
    }
}

/// A tile of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileRecord {
    /// Its number in the plan.
    pub tile: TileIndex,
    /// Its state.
    pub state: TileState,
    /// On which workers it failed: the last reason of each, at most [`MAX_FAILURES`](super::MAX_FAILURES)
    /// workers.
    pub failures: Vec<TileFailure>,
    /// How many differing results were kept out after it was done. Any number but 0 is a fault to
    /// investigate.
    pub conflicts: u32,
    /// Who has computed the same again, once somebody has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub check: Option<TileCheck>,
}

/// Another worker has computed the same bytes for a done tile.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileCheck {
    /// The worker.
    pub worker: String,
    /// Milliseconds since 1970.
    pub at_ms: u64,
}

/// A worker that gets no tiles because its bytes were not those of others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineRecord {
    /// Its name.
    pub worker: String,
    /// Since when, in milliseconds since 1970.
    pub at_ms: u64,
    /// Why, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES).
    pub reason: String,
}

/// The state of the clocks by which retention measures ages, as the coordinator records it now and then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RetentionStamp {
    /// The wall clock, in milliseconds since 1970.
    pub wall_ms: u64,
    /// The time that coordinators have run on this store, in milliseconds of their monotonic clocks.
    pub ran_ms: u64,
    /// The trusted span for the age of ended jobs and of scenes.
    pub jobs: TrustedSpan,
    /// The trusted span for the age of blobs.
    pub blobs: TrustedSpan,
}

/// A span of run time up to now in which the wall clock and the monotonic clock agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrustedSpan {
    /// The start of the span, as run time in milliseconds.
    pub begun_ms: u64,
    /// The sum of the disagreements in the span, in milliseconds: downtimes, whose length only the wall clock
    /// shows, and small steps.
    pub doubt_ms: u64,
    /// The span that replaces this one when it is as long as the age; begun when the doubt was too large.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextSpan>,
}

/// A trusted span that is not as long as the age yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NextSpan {
    /// The start of the span, as run time in milliseconds.
    pub begun_ms: u64,
    /// The doubt since then; see [`TrustedSpan::doubt_ms`].
    pub doubt_ms: u64,
}

impl TileRecord {
    /// A tile without a record.
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
    /// Without a result.
    Open,
    /// Its result is committed.
    Done {
        /// Digest of the result's blob.
        #[serde(with = "hex_digest")]
        digest: Digest,
        /// Size of that blob.
        bytes: u64,
        /// The cost of computing it.
        stats: TileStats,
    },
    /// Given up: its cells are shipped as "all visible" and marked.
    SetAside {
        /// Digest of the stand-in's blob.
        #[serde(with = "hex_digest")]
        digest: Digest,
        /// Size of that blob.
        bytes: u64,
        /// Why, at most [`MAX_REASONS`](super::MAX_REASONS).
        reasons: Vec<String>,
    },
}

/// The cost of a tile's result.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileStats {
    /// Samples rendered.
    pub samples: u64,
    /// View cells in it.
    pub cells: u64,
    /// Time the worker spent, in milliseconds.
    pub millis: u64,
    /// The signature of the worker; at most [`MAX_SIGNATURE_BYTES`](super::MAX_SIGNATURE_BYTES) long.
    pub worker: String,
    /// Others who had a hand in it: helpers, and those whose outcomes it went on from; at most
    /// [`MAX_HELPERS`](super::MAX_HELPERS).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub helpers: Vec<String>,
    /// Helpers that are not named.
    #[serde(default, skip_serializing_if = "is_none")]
    pub unnamed: u32,
    /// When it was committed, in milliseconds since 1970; 0 in records of earlier versions.
    #[serde(default, skip_serializing_if = "is_never")]
    pub at_ms: u64,
}

impl TileStats {
    /// Returns true if a worker with this name or signature may have contributed.
    pub fn may_be_of(&self, name: &str) -> bool {
        let is_meant = |signature: &str| signature == name || worker_name(signature) == name;
        is_meant(&self.worker)
            || self.unnamed > 0
            || self.helpers.iter().any(|helper| is_meant(helper))
    }
}

/// A tile's failure on one worker.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileFailure {
    /// The worker.
    pub worker: String,
    /// Its description, cut to [`MAX_REASON_BYTES`](super::MAX_REASON_BYTES).
    pub reason: String,
}

/// A tile's result as it is committed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileResult {
    /// Digest of the result's blob, which must be in place.
    pub digest: Digest,
    /// Size of that blob.
    pub bytes: u64,
    /// The cost of computing it.
    pub stats: TileStats,
}

/// The outcome of committing a tile's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitOutcome {
    /// The tile is done now.
    Committed,
    /// It was done already, with this digest.
    AlreadySame,
    /// It was done already, with another digest. The offered one is kept out.
    Conflict {
        /// The digest that stays.
        kept: Digest,
        /// The digest kept out.
        offered: Digest,
    },
}

/// Records of jobs without a priority stay as they were before there were priorities.
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
fn is_none(n: &u32) -> bool {
    *n == 0
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde calls it with a reference"
)]
fn is_never(at: &u64) -> bool {
    *at == 0
}

/// Digests as 64 hexadecimal digits: half the size of JSON's list of numbers, and the form in logs and file
/// names.
pub mod hex_digest {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use crate::ids::Digest;

    /// Writes a digest.
    ///
    /// # Errors
    /// The error of the serializer.
    pub fn serialize<S: Serializer>(digest: &Digest, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(blake3::Hash::from_bytes(*digest).to_hex().as_str())
    }

    /// Reads a digest.
    ///
    /// # Errors
    /// Text that is not 64 hexadecimal digits.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Digest, D::Error> {
        let text = String::deserialize(from)?;
        blake3::Hash::from_hex(&text)
            .map(Into::into)
            .map_err(D::Error::custom)
    }
}

/// Opaque bytes as base64: 4/3 of their size, so that a job of the largest allowed specification stays under
/// 4 KiB.
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
