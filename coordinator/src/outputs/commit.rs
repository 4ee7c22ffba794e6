//! Results of tiles: an output is checked, kept as a file and committed.

use std::sync::Arc;
use std::time::Instant;

use sightline_assemble::OutputError;
use sightline_assemble::check::{self, SceneSize};
use sightline_assemble::openness::{self, AnswerError};
use sightline_model::{PlannedJob, Task, codec};
use sightline_records::ids::{Digest, JobId, Lease, hex};
use sightline_records::{CommitOutcome, MAX_HELPERS, TileResult, TileStats};
use sightline_scheduler::{Admitted, Event, NoTile};
use sightline_store::{Address, BlobError, Staged, StoreError};
use sightline_traces::Begun;
use sightline_viewcells::Tile;

use crate::dispatch::{FollowUps, tell};
use crate::outputs::presigned;
use crate::quota::Sender;
use crate::records::OutputCommit;
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};
use crate::telemetry::spans;
use crate::uploads::receivers::{self, Fault};
use crate::uploads::spool::{Spool, SpoolError};

/// Maximum size of an output that is checked while others are, packed and unpacked, in bytes. Larger ones are
/// checked one at a time.
pub(crate) const MAX_LIGHT: u64 = 8 << 20;

/// A tile's output as a worker announces it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UploadHeader {
    /// The lease under which it was computed.
    pub(crate) lease: Lease,
    /// Its digest.
    pub(crate) digest: Digest,
    /// Its length.
    pub(crate) bytes: u64,
    /// Samples that it took.
    pub(crate) samples: u64,
    /// Milliseconds that it took.
    pub(crate) millis: u64,
}

/// Where a tile's output is.
pub(crate) enum Origin<'a> {
    /// Here: it has come as chunks.
    Sent(&'a [u8]),
    /// In the store of the blobs, where its worker has written it.
    Staged(&'a Staged),
}

/// A tile's output that is not committed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ResultError {
    /// The bytes do not have the announced digest.
    #[error("the result that arrived is not the one announced; send it again")]
    Digest,
    /// The bytes do not have the announced length.
    #[error("the result has another length than announced")]
    Length,
    /// The announced length is more than the tile's output can have.
    #[error("{announced} bytes were announced; an output of this tile has at most {most}")]
    TooLong {
        /// The announced length.
        announced: u64,
        /// The bound.
        most: u64,
    },
    /// The chunks differ from the announced ones, or there is no room for them.
    #[error(transparent)]
    Spool(SpoolError),
    /// The worker has not written the output, or another one.
    #[error("the output is not where it was to be written ({0}); send it")]
    Unstaged(String),
    /// The job has ended or does not exist.
    #[error("job {0} has ended or is not known here")]
    NoJob(JobId),
    /// The job has fewer tiles.
    #[error("the job has no such tile")]
    NoTile,
    /// The lease does not count.
    #[error(
        "the lease {} of tile {} of job {} in epoch {} does not count: it was not given, or it has ended, or \
         its worker is quarantined",
        .0.id.number, .0.tile, .0.job, .0.id.epoch.0
    )]
    NoLease(Lease),
    /// The output is not that of its tile.
    #[error(transparent)]
    Output(OutputError),
    /// The output is not the answers of its tile's receivers.
    #[error("{0}")]
    Answers(String),
    /// The tile has another result.
    #[error("another result for this tile is already there; this worker's machine needs a look")]
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

/// The outputs that a check may unpack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Weight {
    /// Outputs of at most [`MAX_LIGHT`] bytes; others are [`OutputError::Large`].
    Light,
    /// All of them. The caller holds the right to a large one.
    Any,
}

/// Begins an output that arrives as chunks. Its lease and its length are checked before its first byte is
/// kept.
///
/// # Errors
/// [`ResultError`] when the lease was not given, the tile can have no output of this length, or unfinished
/// uploads have too many bytes.
pub(crate) fn begin(c: &Coordinator, announced: &UploadHeader) -> Result<Spool, ResultError> {
    let Admitted { work, counts, .. } = c.lock().scheduler.admit(&announced.lease)?;
    if !counts {
        return Err(ResultError::NoLease(announced.lease));
    }
    let most = most_packed(c, &work, announced.lease)?;
    if announced.bytes > most {
        return Err(ResultError::TooLong {
            announced: announced.bytes,
            most,
        });
    }
    Ok(Spool::begin(c, Sender::Worker, announced.bytes)?)
}

/// Returns where the holder of a lease writes its output; `None` where that goes through the coordinator. It
/// names the fault of an output that it rejects.
///
/// # Errors
/// When the store has no keys to sign with.
pub(crate) fn address(c: &Coordinator, staged: &Staged) -> Result<Option<Address>, BlobError> {
    let admitted = c.lock().scheduler.admit(&staged.lease);
    let most = admitted
        .ok()
        .and_then(|admitted| most_packed(c, &admitted.work, staged.lease).ok());
    most.map_or(Ok(None), |most| presigned::writing(c, staged, most))
}

/// Returns the maximum length of a tile's output before it is unpacked.
fn most_packed(c: &Coordinator, work: &PlannedJob, lease: Lease) -> Result<u64, ResultError> {
    match &work.spec().task {
        Task::Ambient(_) => Ok(codec::MAX_UNPACKED),
        Task::Visibility(task) => {
            let tile = tile_of(work, lease)?;
            Ok(check::most_packed(task, tile, scene_size(c, work)?))
        }
    }
}

/// Returns the tile of a lease.
fn tile_of(work: &PlannedJob, lease: Lease) -> Result<&Tile, ResultError> {
    let tile = work.plan().tiles.get(lease.tile.at());
    tile.ok_or(ResultError::NoTile)
}

/// Returns the numbers of triangles and of objects in a job's scene.
fn scene_size(c: &Coordinator, work: &PlannedJob) -> Result<SceneSize, ResultError> {
    let record = c.store.scene(&work.spec().scene)?;
    Ok(record.map_or_else(SceneSize::default, |record| SceneSize {
        triangles: record.triangles,
        objects: record.objects,
    }))
}

/// Checks and commits a tile's output, then does what follows from it.
pub(crate) fn put(
    c: &Arc<Coordinator>,
    announced: &UploadHeader,
    origin: &Origin<'_>,
    weight: Weight,
) -> Result<(), ResultError> {
    let begun = Instant::now();
    let (result, follow_ups) = match origin {
        Origin::Sent(bytes) => commit(c, announced, bytes, None, weight)?,
        Origin::Staged(staged) => {
            let committed = fetch(c, staged)
                .and_then(|bytes| commit(c, announced, &bytes, Some(staged), weight));
            let waits = |e: &ResultError| match e {
                ResultError::Blob(e) => e.passes(),
                ResultError::Store(_) | ResultError::Output(OutputError::Large) => true,
                _ => false,
            };
            // The worker names it again after what passes.
            if !committed.as_ref().is_err_and(waits) {
                presigned::discard(c, staged);
            }
            committed?
        }
    };
    c.metrics.commit_took(begun.elapsed());
    follow_ups.run(c);
    result
}

/// Reads an output that its worker has written into the store of the blobs.
fn fetch(c: &Coordinator, staged: &Staged) -> Result<Vec<u8>, ResultError> {
    // The coordinator reads no output that does not count, or is longer than its tile's can be.
    let Admitted { work, counts, .. } = c.lock().scheduler.admit(&staged.lease)?;
    if !counts {
        return Err(ResultError::NoLease(staged.lease));
    }
    let most = most_packed(c, &work, staged.lease)?;
    if staged.bytes > most {
        return Err(ResultError::TooLong {
            announced: staged.bytes,
            most,
        });
    }
    let none = || ResultError::Unstaged("this coordinator has given no address".to_owned());
    let direct = c.blobs.direct().ok_or_else(none)?;
    direct.read_staged(staged).map_err(|e| match e {
        e if e.passes() => ResultError::Blob(e),
        e => ResultError::Unstaged(e.to_string()),
    })
}

/// The number of cells or receivers of a tile's output, which must be what the job's plan expects of the
/// tile.
fn check(
    c: &Coordinator,
    work: &PlannedJob,
    announced: &UploadHeader,
    bytes: &[u8],
    weight: Weight,
) -> Result<u64, ResultError> {
    if *blake3::hash(bytes).as_bytes() != announced.digest {
        return Err(ResultError::Digest);
    }
    if announced.bytes != bytes.len() as u64 {
        return Err(ResultError::Length);
    }
    let (tile, number) = (tile_of(work, announced.lease)?, announced.lease.tile.0);
    match &work.spec().task {
        Task::Ambient(ambient) => {
            let stored = receivers::stored(c, ambient.receivers).map_err(|e| match e {
                Fault::Blob(e) if e.passes() => ResultError::Blob(e),
                e => ResultError::Answers(format!("the job's receivers: {e}")),
            })?;
            let checked = openness::check(ambient, &stored.facts, number, bytes);
            checked.map_err(|e: AnswerError<BlobError>| match e {
                AnswerError::NoTile => ResultError::NoTile,
                e => ResultError::Answers(e.to_string()),
            })
        }
        Task::Visibility(task) => {
            let most = match weight {
                Weight::Light => MAX_LIGHT,
                Weight::Any => u64::MAX,
            };
            check::check(task, (number, tile), scene_size(c, work)?, bytes, most)
                .map_err(ResultError::Output)
        }
    }
}

/// Checks a tile's output and commits it, unless the tile is done; gives whether the tile has it now,
/// and what follows.
///
/// Everything that takes time is done without a lock: the hash, the decoding, the file and the record.
fn commit(
    c: &Coordinator,
    announced: &UploadHeader,
    bytes: &[u8],
    staged: Option<&Staged>,
    weight: Weight,
) -> Result<(Result<(), ResultError>, FollowUps), ResultError> {
    let begun = Begun::now();
    let &UploadHeader {
        lease,
        digest,
        samples,
        millis,
        ..
    } = announced;
    let Lease { job: id, tile, .. } = lease;
    let Admitted {
        work,
        worker,
        profile,
        checks,
        counts,
        ..
    } = c.lock().scheduler.admit(&lease)?;
    let cells = check(c, &work, announced, bytes, weight)?;
    if !counts {
        return Err(ResultError::NoLease(lease));
    }
    if checks {
        // It is compared with what is kept, and not kept itself.
        let stats = TileStats {
            samples,
            cells,
            millis,
            worker,
            ..TileStats::default()
        };
        c.spans
            .committed(&lease, begun, spans::CHECKED, &stats, announced.bytes);
        return Ok((Ok(()), tell(c, Event::Checked { lease, digest })));
    }
    let full = |e: &BlobError| {
        if e.passes() {
            // Leasing goes on with a later tick, so nothing follows from this now.
            drop(tell(c, Event::DiskFull(lease)));
        }
    };
    // While this is held, no output is removed: a record may only name a blob that is present. No tile is
    // reopened either; until now it may have been, with the tiles from which this one was computed.
    let (committing, admitted) = OutputCommit::begin(c, lease)?;
    let Admitted {
        helpers, counts, ..
    } = admitted;
    if !counts {
        return Err(ResultError::NoLease(lease));
    }
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
            drop(tell(c, Event::DiskFull(lease)));
        }
    })?;
    match outcome {
        CommitOutcome::Committed | CommitOutcome::AlreadySame => {
            c.crews.outcomes.remove((id, tile));
            if outcome == CommitOutcome::Committed {
                let TileStats {
                    cells,
                    samples,
                    millis,
                    worker,
                    ..
                } = &stats;
                c.metrics.committed(&profile, *samples, *millis);
                if staged.is_some() {
                    c.metrics.went_directly("write", announced.bytes);
                }
                let text =
                    format!("tile {tile} is done: {cells} cells, {samples} samples, {millis} ms");
                c.happened(LogEvent::of_lease(Kind::Done, &lease, text).on(worker));
            }
            c.spans
                .committed(&lease, begun, spans::DONE, &stats, announced.bytes);
            Ok((
                Ok(()),
                tell(
                    c,
                    Event::Committed {
                        lease,
                        digest,
                        stats,
                    },
                ),
            ))
        }
        CommitOutcome::Conflict { kept, offered } => {
            let error = format!(
                "TWO RESULTS for tile {tile} of job {id}: {} stays, {} is refused. A worker's memory, \
                 driver or program differs from its profile; find out which before trusting this job",
                hex(&kept),
                hex(&offered)
            );
            tracing::error!("{error}");
            c.metrics.conflict();
            c.happened(LogEvent::of_lease(Kind::Conflict, &lease, error).on(&stats.worker));
            c.spans
                .committed(&lease, begun, spans::CONFLICT, &stats, announced.bytes);
            // The lease has ended, whoever made the result that stays.
            let mut follow_ups = tell(
                c,
                Event::Differed {
                    lease,
                    digest: offered,
                },
            );
            let event = Event::Committed {
                lease,
                digest: kept,
                stats: TileStats::default(),
            };
            follow_ups.extend(tell(c, event));
            Ok((Err(ResultError::Conflict), follow_ups))
        }
    }
}
