//! Results of tiles: an output is checked, kept as a file and committed.

use std::sync::Arc;
use std::time::Instant;

use sightline_model::codec;
use sightline_model::{CellSet, Node, PlannedJob, Task, TileOutput, Visibility};
use sightline_pvs::Portals;
use sightline_traces::Begun;
use sightline_viewcells::{CellBox, Division, Tile, TileKind};

use crate::assemble::openness::{self, AnswerError};
use crate::assemble::result::{expected_nodes, most_items};
use crate::dispatch::run::run_follow_ups;
use crate::dispatch::{FollowUp, tell};
use crate::ids::{Digest, JobId, Lease, hex};
use crate::outputs::presigned;
use crate::quota::Sender;
use crate::scheduler::{Admitted, Event, NoTile};
use crate::state::Coordinator;
use crate::store::{
    Address, BlobError, CommitOutcome, MAX_HELPERS, SceneRecord, Staged, StoreError, TileResult,
    TileStats,
};
use crate::telemetry::events::{Kind, LogEvent};
use crate::telemetry::spans;
use crate::uploads::spool::{Spool, SpoolError};

/// What a cell has besides its set, at most.
const LEAST_UNPACKED: u64 = 4096;
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
    /// The output unpacks to much, so that it is checked when no other large one is.
    #[error("the output is large and was not checked yet")]
    Large,
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
    /// The bytes are not an encoded output.
    #[error("{0}")]
    Encoding(String),
    /// The tree of the cells is not the tile's.
    #[error("the output's cells are not those of the tile's grid")]
    Cells,
    /// The cells without viewpoints are not those of the job.
    #[error("the output's cells without viewpoints are not those of the job")]
    Viewpoints,
    /// The first tile of the method portals has the portals of the result, and no other has.
    #[error("the output's portals cannot be read, or it lacks them, or it has some and should not")]
    Portals,
    /// The job asks for contributions and the output has none, or the other way round.
    #[error(
        "the output has no contributions and the job asks for them, or has some and the job does not"
    )]
    Contributions,
    /// The cells were decided by another method.
    #[error("the output's cells are not decided by the job's method")]
    Method,
    /// Pairs of cells are missing, or over other cells.
    #[error("the output's pairs of cells are not over the cells of the job")]
    Pairs,
    /// Samples in place of cells, or cells in place of samples.
    #[error("the output is not of the tile's kind")]
    Kind,
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
    /// Outputs of at most [`MAX_LIGHT`] bytes; others are [`ResultError::Large`].
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

/// Returns the maximum length of a tile's output before it is unpacked. Packing adds little to bytes that it
/// cannot shorten.
fn most_packed(c: &Coordinator, work: &PlannedJob, lease: Lease) -> Result<u64, ResultError> {
    let Task::Visibility(task) = &work.spec().task else {
        return Ok(codec::MAX_UNPACKED);
    };
    let tile = tile_of(work, lease)?;
    let scene = c.store.scene(&work.spec().scene)?;
    let items = most_items_of(task, scene.as_ref(), tile.kind);
    let unpacked = most_unpacked(task, tile.cells, items, tile.kind != TileKind::Leaf);
    Ok(packed(unpacked))
}

/// Returns the tile of a lease.
fn tile_of(work: &PlannedJob, lease: Lease) -> Result<&Tile, ResultError> {
    let tile = work.plan().tiles.get(lease.tile.at());
    tile.ok_or(ResultError::NoTile)
}

/// Returns the maximum packed length of an output, by its unpacked length, in bytes.
fn packed(unpacked: u64) -> u64 {
    unpacked
        .saturating_add(unpacked / 64)
        .saturating_add(LEAST_UNPACKED)
        .min(codec::MAX_UNPACKED)
}

/// Returns the number of items that an output of a kind can name.
fn most_items_of(task: &Visibility, scene: Option<&SceneRecord>, kind: TileKind) -> u32 {
    scene.map_or(0, |s| match kind {
        TileKind::Leaf => most_items(task, s.triangles, s.objects),
        TileKind::Face(_) | TileKind::Separator(_) => s.triangles,
    })
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
                ResultError::Store(_) | ResultError::Large => true,
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
    run_follow_ups(c, follow_ups);
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
    let task = match &work.spec().task {
        Task::Ambient(ambient) => {
            let checked = openness::check(c, ambient, announced.lease.tile, bytes);
            return checked.map_err(|e| match e {
                AnswerError::NoTile => ResultError::NoTile,
                AnswerError::Blob(e) => ResultError::Blob(e),
                e @ (AnswerError::Receivers(_) | AnswerError::Openness(_)) => {
                    ResultError::Encoding(e.to_string())
                }
            });
        }
        Task::Visibility(task) => task,
    };
    let tile = tile_of(work, announced.lease)?;
    let kind = tile.kind;
    let scene = c.store.scene(&work.spec().scene)?;
    let expected = expected_nodes(task, tile);
    let items = most_items_of(task, scene.as_ref(), kind);
    let pairs = task.pair_cells().map(|sides| sides.iter().product::<u32>());
    let unreached = expected
        .as_ref()
        .map_or_else(Vec::new, |nodes| unreached(task, &tile.cell, nodes));
    let (exact, hits) = (task.is_decided(), task.has_contributions());
    let is_pack = kind != TileKind::Leaf;
    let most = most_unpacked(task, tile.cells, items, is_pack);
    let now = if weight == Weight::Light {
        most.min(MAX_LIGHT)
    } else {
        most
    };
    let output = codec::check(bytes, items, is_pack, now).map_err(|e| match e {
        e if e.is_too_large() && now < most => ResultError::Large,
        e => ResultError::Encoding(e.to_string()),
    })?;
    match (&output, kind) {
        (TileOutput::Cells(sets), TileKind::Leaf) => {
            if expected.is_some_and(|nodes| nodes != sets.nodes) {
                return Err(ResultError::Cells);
            }
            if sets.cells.iter().any(|c| c.decision.is_some() != exact) {
                return Err(ResultError::Method);
            }
            if sets
                .pairs
                .as_ref()
                .map(|p| (p.seen.cells(), p.hidden.is_some()))
                != pairs.map(|n| (n, exact))
            {
                return Err(ResultError::Pairs);
            }
            let as_asked = |(cell, unreached): (&CellSet, &bool)| cell.unreached == *unreached;
            if !unreached.is_empty() && !sets.cells.iter().zip(&unreached).all(as_asked)
                || unreached.is_empty() && sets.cells.iter().any(|c| c.unreached)
            {
                return Err(ResultError::Viewpoints);
            }
            let has_portals = task.has_portals() && announced.lease.tile.at() == 0;
            let is_table = |bytes: &[u8]| {
                Portals::decode(bytes, scene.as_ref().map_or(0, |s| s.triangles)).is_ok()
            };
            if has_portals && !is_table(&sets.portals) || !has_portals && !sets.portals.is_empty() {
                return Err(ResultError::Portals);
            }
            if sets.cells.iter().any(|c| c.hits.is_some() != hits) {
                return Err(ResultError::Contributions);
            }
            Ok(sets.cells.len() as u64)
        }
        (TileOutput::Pack(_), TileKind::Face(_) | TileKind::Separator(_)) => Ok(0),
        _ => Err(ResultError::Kind),
    }
}

/// Most bytes that an output of so many cells unpacks to. A set has at most all items, each with a
/// difference and a count of at most five bytes; proofs and packs have no such bound.
fn most_unpacked(task: &Visibility, cells: u64, items: u32, is_pack: bool) -> u64 {
    if is_pack || task.is_decided() || task.has_portals() || cells == 0 {
        return codec::MAX_UNPACKED;
    }
    let pairs = task.pair_cells().map_or(0, |sides| {
        sides.iter().map(|n| u64::from(*n)).product::<u64>()
    });
    // An adaptive tile has more cells than its plan says, and at most two to the depth of its tree.
    let cells = if matches!(task.division(), Division::Adaptive { .. }) {
        cells.saturating_mul(1 << 12)
    } else {
        cells
    };
    let sets = cells.saturating_mul(
        u64::from(items)
            .saturating_mul(10)
            .saturating_add(LEAST_UNPACKED),
    );
    sets.saturating_add(pairs.saturating_mul(pairs))
        .saturating_add(1 << 20)
        .min(codec::MAX_UNPACKED)
}

/// Whether no viewpoint is in each cell of a tile with these nodes; empty when viewpoints are everywhere.
fn unreached(task: &Visibility, of: &CellBox, nodes: &[Node]) -> Vec<bool> {
    if task.viewpoints().mask().is_none() {
        return Vec::new();
    }
    let (mut open, mut out) = (vec![*of], Vec::new());
    for node in nodes {
        let Some(cell) = open.pop() else { break };
        match node {
            Node::Split(split) => {
                let [below, above] = cell.children(*split);
                open.extend([above, below]);
            }
            Node::Cell => out.push(task.marks(&cell) == 0),
        }
    }
    out
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
) -> Result<(Result<(), ResultError>, Vec<FollowUp>), ResultError> {
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
    // Nobody removes outputs meanwhile: a record may only name a blob that is present.
    let _committing = c.committing();
    // Nor opens tiles again. Until now somebody may have, with those that this one was computed from.
    let Admitted {
        helpers, counts, ..
    } = c.lock().scheduler.admit(&lease)?;
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
    let outcome = c.store.commit_tile(id, tile, result).inspect_err(|e| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_output_is_little_longer_than_its_content() {
        assert_eq!(packed(0), LEAST_UNPACKED);
        assert_eq!(packed(6400), 6500 + LEAST_UNPACKED);
        assert_eq!(packed(u64::MAX), codec::MAX_UNPACKED);
    }
}
