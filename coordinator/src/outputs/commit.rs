//! Commits of tile outputs: an output is checked, stored as a blob and recorded.

use std::sync::Arc;
use std::time::Instant;

use sightline_assemble::OutputError;
use sightline_assemble::check::{self, SceneSize};
use sightline_assemble::openness::{self, AnswerError};
use sightline_model::{PlannedJob, Task, codec};
use sightline_records::ids::{Digest, JobId, Lease, hex};
use sightline_records::{CommitOutcome, MAX_HELPERS, TileResult, TileStats};
use sightline_scheduler::{Event, NoTile, Right};
use sightline_store::{Address, BlobError, Staged, StoreError};
use sightline_traces::SpanTime;
use sightline_viewcells::Tile;

use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::outputs::presigned;
use crate::quota::Sender;
use crate::records::{OutputCommit, Records};
use crate::telemetry::events::{EventKind, LogEvent};
use crate::telemetry::spans;
use crate::uploads::receivers::StoredReceiversError;
use crate::uploads::spool::{Spool, SpoolError};

/// Maximum size of an output that is checked concurrently with others, in bytes, before and after
/// decompression. Larger outputs are checked one at a time.
pub(crate) const MAX_LIGHT: u64 = 8 << 20;

/// A tile's output as a worker announces it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UploadHeader {
    /// The lease under which the worker computed the output.
    pub(crate) lease: Lease,
    /// The digest of the output.
    pub(crate) digest: Digest,
    /// The length of the output, in bytes.
    pub(crate) bytes: u64,
    /// The number of samples that the worker took.
    pub(crate) samples: u64,
    /// The computation time in milliseconds.
    pub(crate) millis: u64,
}

/// The location of a tile's output.
pub(crate) enum OutputBytes<'a> {
    /// Bytes in memory, which arrived as chunks.
    Sent(&'a [u8]),
    /// An object in the blob store, which the worker wrote directly.
    Staged(&'a Staged),
}

/// The reason why a tile's output is not committed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ResultError {
    /// The bytes do not have the announced digest.
    #[error(
        "the digest of the received output differs from the announced digest; send the output again"
    )]
    Digest,
    /// The bytes do not have the announced length.
    #[error("the length of the output differs from the announced length; send the output again")]
    Length,
    /// The announced length exceeds the maximum length of the tile's output.
    #[error("the announced output has {announced} bytes, but the maximum for this tile is {most}")]
    TooLong {
        /// The announced length in bytes.
        announced: u64,
        /// The maximum length in bytes.
        most: u64,
    },
    /// The chunks differ from the announcement, or the disk has no space for them.
    #[error(transparent)]
    Spool(SpoolError),
    /// The output in the blob store is missing, or is not the announced one.
    #[error(
        "the output is not at its address in the object store ({0}); send the output to the \
         coordinator"
    )]
    Unstaged(String),
    /// The job has ended or does not exist.
    #[error("job {0} has ended or does not exist")]
    NoJob(JobId),
    /// The job does not have the tile.
    #[error("the job does not have this tile")]
    NoTile,
    /// The lease is not valid.
    #[error(
        "the lease {} of tile {} of job {} in epoch {} is invalid: it was never granted, or it has \
         ended, or its worker is quarantined",
        .0.id.number, .0.tile, .0.job, .0.id.epoch.0
    )]
    NoLease(Lease),
    /// The output does not match its tile.
    #[error(transparent)]
    Output(OutputError),
    /// The answers do not match the receivers of the tile.
    #[error("{0}")]
    Answers(String),
    /// The tile already has a different output.
    #[error("a different result for this tile is already stored; check the machine of this worker")]
    Conflict,
    /// The blob cannot be written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<NoTile> for ResultError {
    fn from(why: NoTile) -> Self {
        match why {
            NoTile::NoJob(job) => Self::NoJob(job),
            NoTile::NoTile => Self::NoTile,
        }
    }
}

impl From<SpoolError> for ResultError {
    fn from(e: SpoolError) -> Self {
        match e {
            SpoolError::Length { .. } => Self::Length,
            SpoolError::Blob(e) => Self::Blob(e),
            e => Self::Spool(e),
        }
    }
}

/// The sizes of outputs that a check may unpack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SizeLimit {
    /// Outputs of at most [`MAX_LIGHT`] bytes. A larger output causes [`OutputError::Large`].
    Light,
    /// Outputs of any size. The caller holds the right to check a large output.
    Any,
}

/// Starts an output that arrives as chunks. Checks the lease and the announced length before the first byte
/// is stored.
///
/// # Errors
/// [`ResultError`] if the lease is not valid, the tile cannot have an output of this length, or the
/// unfinished uploads have too many bytes.
pub(crate) fn begin(c: &Coordinator, announced: &UploadHeader) -> Result<Spool, ResultError> {
    let admission = c
        .dispatcher
        .read(|scheduler| scheduler.admit(&announced.lease))?;
    if !admission.counts() {
        return Err(ResultError::NoLease(announced.lease));
    }
    let most = most_packed(&c.records, &admission.job, announced.lease)?;
    if announced.bytes > most {
        return Err(ResultError::TooLong {
            announced: announced.bytes,
            most,
        });
    }
    Ok(Spool::begin(
        &c.uploads,
        &c.telemetry.metrics,
        Sender::Worker,
        announced.bytes,
    )?)
}

/// Returns the address to which the holder of a lease writes its output, or `None` if the output goes through
/// the coordinator. For a rejected output, the result is `None` as well; the later upload names the fault.
///
/// # Errors
/// [`BlobError`] if the blob store has no keys for signatures.
pub(crate) fn address(c: &Coordinator, staged: &Staged) -> Result<Option<Address>, BlobError> {
    let admitted = c
        .dispatcher
        .read(|scheduler| scheduler.admit(&staged.lease));
    let most = admitted
        .ok()
        .and_then(|admitted| most_packed(&c.records, &admitted.job, staged.lease).ok());
    most.map_or(Ok(None), |most| presigned::writing(c, staged, most))
}

/// Returns the maximum compressed length of a tile's output, in bytes.
fn most_packed(records: &Records, planned: &PlannedJob, lease: Lease) -> Result<u64, ResultError> {
    match &planned.spec().task {
        Task::Ambient(_) => Ok(codec::MAX_UNPACKED),
        Task::Visibility(task) => {
            let tile = tile_of(planned, lease)?;
            let size = scene_size(records, planned)?;
            Ok(check::most_packed(task, tile, size))
        }
    }
}

/// Returns the tile of a lease.
fn tile_of(planned: &PlannedJob, lease: Lease) -> Result<&Tile, ResultError> {
    let tile = planned.plan().tiles.get(lease.tile.at());
    tile.ok_or(ResultError::NoTile)
}

/// Returns the numbers of triangles and of objects in a job's scene.
fn scene_size(records: &Records, planned: &PlannedJob) -> Result<SceneSize, ResultError> {
    let record = records.scene(&planned.spec().scene)?;
    Ok(record.map_or_else(SceneSize::default, |record| SceneSize {
        triangles: record.triangles,
        objects: record.objects,
    }))
}

/// Checks and commits a tile's output, and starts the follow-ups.
pub(crate) fn put(
    c: &Arc<Coordinator>,
    announced: &UploadHeader,
    origin: &OutputBytes<'_>,
    limit: SizeLimit,
) -> Result<(), ResultError> {
    let begun = Instant::now();
    let (result, follow_ups) = match origin {
        OutputBytes::Sent(bytes) => commit(c, announced, bytes, None, limit)?,
        OutputBytes::Staged(staged) => {
            let committed = fetch(c, staged)
                .and_then(|bytes| commit(c, announced, &bytes, Some(staged), limit));
            let waits = |e: &ResultError| match e {
                ResultError::Blob(e) => e.passes(),
                ResultError::Store(_) | ResultError::Output(OutputError::Large) => true,
                _ => false,
            };
            // After a temporary failure, the worker announces the same output again.
            if !committed.as_ref().is_err_and(waits) {
                presigned::discard(&*c.blobs, staged);
            }
            committed?
        }
    };
    c.telemetry.metrics.commit_took(begun.elapsed());
    follow_ups.run(c);
    result
}

/// Reads an output that its worker wrote directly to the blob store.
fn fetch(c: &Coordinator, staged: &Staged) -> Result<Vec<u8>, ResultError> {
    // The coordinator must not read an output with an invalid lease, or one that is too long for its tile.
    let admission = c
        .dispatcher
        .read(|scheduler| scheduler.admit(&staged.lease))?;
    if !admission.counts() {
        return Err(ResultError::NoLease(staged.lease));
    }
    let most = most_packed(&c.records, &admission.job, staged.lease)?;
    if staged.bytes > most {
        return Err(ResultError::TooLong {
            announced: staged.bytes,
            most,
        });
    }
    let none = || {
        ResultError::Unstaged(
            "this coordinator did not offer an address in an object store".to_owned(),
        )
    };
    let direct = c.blobs.direct().ok_or_else(none)?;
    direct.read_staged(staged).map_err(|e| match e {
        e if e.passes() => ResultError::Blob(e),
        e => ResultError::Unstaged(e.to_string()),
    })
}

/// Checks an output against the job's plan, and returns the number of its cells or receivers.
fn check(
    c: &Coordinator,
    planned: &PlannedJob,
    announced: &UploadHeader,
    bytes: &[u8],
    limit: SizeLimit,
) -> Result<u64, ResultError> {
    if *blake3::hash(bytes).as_bytes() != announced.digest {
        return Err(ResultError::Digest);
    }
    if announced.bytes != bytes.len() as u64 {
        return Err(ResultError::Length);
    }
    let (tile, number) = (tile_of(planned, announced.lease)?, announced.lease.tile);
    match &planned.spec().task {
        Task::Ambient(ambient) => {
            let stored =
                c.uploads
                    .receivers(&*c.blobs, ambient.receivers)
                    .map_err(|e| match e {
                        StoredReceiversError::Blob(e) if e.passes() => ResultError::Blob(e),
                        e => ResultError::Answers(format!("the job's receivers: {e}")),
                    })?;
            let checked = openness::check(ambient, &stored.facts, number, bytes);
            checked.map_err(|e: AnswerError<BlobError>| match e {
                AnswerError::NoTile => ResultError::NoTile,
                e => ResultError::Answers(e.to_string()),
            })
        }
        Task::Visibility(task) => {
            let most = match limit {
                SizeLimit::Light => MAX_LIGHT,
                SizeLimit::Any => u64::MAX,
            };
            check::check(
                task,
                number,
                tile,
                scene_size(&c.records, planned)?,
                bytes,
                most,
            )
            .map_err(ResultError::Output)
        }
    }
}

/// Checks a tile's output, and commits it unless the tile is done. Returns success if the tile has this
/// output now, and the follow-ups.
///
/// Slow steps run without a lock: the hash, the decoding, the file and the record.
fn commit(
    c: &Coordinator,
    announced: &UploadHeader,
    bytes: &[u8],
    staged: Option<&Staged>,
    limit: SizeLimit,
) -> Result<(Result<(), ResultError>, FollowUps), ResultError> {
    let begun = SpanTime::now();
    let &UploadHeader {
        lease,
        digest,
        samples,
        millis,
        ..
    } = announced;
    let Lease { job: id, tile, .. } = lease;
    let admission = c.dispatcher.read(|scheduler| scheduler.admit(&lease))?;
    let cells = check(c, &admission.job, announced, bytes, limit)?;
    match admission.right {
        Right::Stale => return Err(ResultError::NoLease(lease)),
        Right::Compare { worker } => {
            let stats = TileStats {
                samples,
                cells,
                millis,
                worker,
                ..TileStats::default()
            };
            c.telemetry
                .spans
                .committed(&lease, begun, spans::CHECKED, &stats, announced.bytes);
            return Ok((Ok(()), c.tell(Event::Checked { lease, digest })));
        }
        Right::Keep { .. } => {}
    }
    let full = |e: &BlobError| {
        if e.passes() {
            // A later tick resumes leasing, so this event has no follow-ups.
            drop(c.tell(Event::DiskFull(lease)));
        }
    };
    // While this lock is held, no output is removed, so the record references an existing blob. No tile is
    // reopened, either. Before this point, the tile and its prerequisites may have been reopened.
    let (committing, admission) = OutputCommit::begin(c, lease)?;
    let Right::Keep { worker, helpers } = admission.right else {
        return Err(ResultError::NoLease(lease));
    };
    match (staged, c.blobs.direct()) {
        (Some(staged), Some(direct)) => direct.adopt(staged, &digest, bytes).inspect_err(full)?,
        _ => drop(c.blobs.put(bytes).inspect_err(full)?),
    }
    let unnamed = helpers.len().saturating_sub(MAX_HELPERS) as u32;
    let helpers = helpers.into_iter().take(MAX_HELPERS).collect();
    let at_ms = c.now().unix_ms;
    let stats = TileStats {
        samples,
        cells,
        millis,
        worker,
        helpers,
        unnamed,
        at_ms,
    };
    let result = TileResult {
        digest,
        bytes: announced.bytes,
        stats: stats.clone(),
    };
    let outcome = committing.record(result).inspect_err(|e| {
        if matches!(e, StoreError::Journal(_)) {
            drop(c.tell(Event::DiskFull(lease)));
        }
    })?;
    match outcome {
        CommitOutcome::Committed | CommitOutcome::AlreadySame => {
            c.workers.crews.outcomes.remove((id, tile));
            if outcome == CommitOutcome::Committed {
                let TileStats {
                    cells,
                    samples,
                    millis,
                    worker,
                    ..
                } = &stats;
                c.telemetry
                    .metrics
                    .committed(&admission.profile, *samples, *millis);
                if staged.is_some() {
                    c.telemetry.metrics.went_directly("write", announced.bytes);
                }
                let text =
                    format!("tile {tile} is done: {cells} cells, {samples} samples, {millis} ms");
                c.record_event(LogEvent::of_lease(EventKind::Done, &lease, text).on(worker));
            }
            c.telemetry
                .spans
                .committed(&lease, begun, spans::DONE, &stats, announced.bytes);
            Ok((
                Ok(()),
                c.tell(Event::Committed {
                    lease,
                    digest,
                    stats,
                }),
            ))
        }
        CommitOutcome::Conflict { kept, offered } => {
            let error = format!(
                "TWO RESULTS for tile {tile} of job {id}: {} stays, {} is rejected. The memory, \
                 driver or program of a worker differs from its profile; find the faulty worker \
                 before you trust this job",
                hex(&kept),
                hex(&offered)
            );
            tracing::error!("{error}");
            c.telemetry.metrics.conflict();
            c.record_event(
                LogEvent::of_lease(EventKind::Conflict, &lease, error).on(&stats.worker),
            );
            c.telemetry
                .spans
                .committed(&lease, begun, spans::CONFLICT, &stats, announced.bytes);
            // The lease has ended, regardless of which worker computed the output that stays.
            let mut follow_ups = c.tell(Event::Differed {
                lease,
                digest: offered,
            });
            let event = Event::Committed {
                lease,
                digest: kept,
                stats: TileStats::default(),
            };
            follow_ups.extend(c.tell(event));
            Ok((Err(ResultError::Conflict), follow_ups))
        }
    }
}
