//! Results: committing the outputs of tiles, assembling a job's result when its tiles are complete, and
//! removing tile outputs that no job needs any more.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use sightline_model::codec;
use sightline_model::{CellSet, JobSpec, Method, Node, TileOutput};
use sightline_viewcells::{CellBox, TileKind, UNITS_PER_CELL};

use crate::assemble::{AssembleError, Parts, assemble, expected_nodes, most_items};
use crate::ids::{Digest, JobId, Lease, hex};
use crate::scheduler::{Scheduler, Slot};
use crate::state::Coordinator;
use crate::store::{
    BlobError, CommitOutcome, JobPhase, JobRecord, JobState, StoreError, TileResult, TileState, TileStats,
};

/// Time between two attempts to write a result that the disk has no space for.
const SPACE_EVERY: Duration = Duration::from_secs(10);

/// A tile's output as a worker announces it.
pub(crate) struct Announced {
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

/// A tile's output that is not committed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ResultError {
    /// The bytes do not have the announced digest.
    #[error("the result that arrived is not the one announced; send it again")]
    Digest,
    /// The bytes do not have the announced length.
    #[error("the result has another length than announced")]
    Length,
    /// The job has ended or does not exist.
    #[error("job {0} has ended or is not known here")]
    NoJob(JobId),
    /// The job has fewer tiles.
    #[error("the job has no such tile")]
    NoTile,
    /// The bytes are not an encoded output.
    #[error("{0}")]
    Encoding(String),
    /// The tree of the cells is not the tile's.
    #[error("the output's cells are not those of the tile's grid")]
    Cells,
    /// The cells without viewpoints are not those of the job.
    #[error("the output's cells without viewpoints are not those of the job")]
    Viewpoints,
    /// The job asks for contributions and the output has none, or the other way round.
    #[error("the output has no contributions and the job asks for them, or has some and the job does not")]
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

/// Checks and commits a tile's output, then assembles what is complete and grants further tiles.
pub(crate) fn put(c: &Arc<Coordinator>, announced: &Announced, bytes: &[u8]) -> Result<(), ResultError> {
    commit(c, announced, bytes)?;
    assemble_ready(c);
    c.grant_tiles();
    c.changed();
    Ok(())
}

/// The number of cells of a tile's output, which must be what the job's plan expects of the tile.
fn check(c: &Coordinator, announced: &Announced, bytes: &[u8]) -> Result<u64, ResultError> {
    if *blake3::hash(bytes).as_bytes() != announced.digest {
        return Err(ResultError::Digest);
    }
    if announced.bytes != bytes.len() as u64 {
        return Err(ResultError::Length);
    }
    let Lease { job: id, tile, .. } = announced.lease;
    let (items, kind, expected, exact, pairs, (unreached, hits)) = {
        let scheduler = c.lock();
        let job = scheduler.jobs.get(&id).ok_or(ResultError::NoJob(id))?;
        let tile = job.plan.tiles.get(tile.at()).ok_or(ResultError::NoTile)?;
        let scene = c.store.scene(&job.spec.scene)?;
        let nodes = expected_nodes(&job.spec.division, &job.lattice, &tile.cell, tile.depth);
        let items = scene.map_or(0, |s| match tile.kind {
            TileKind::Leaf => most_items(&job.spec, s.triangles, s.objects),
            TileKind::Face(_) | TileKind::Separator(_) => s.triangles,
        });
        let pairs = job.spec.pair_cells().map(|sides| sides.iter().product::<u32>());
        let unreached = nodes.as_ref().map_or_else(Vec::new, |nodes| unreached(&job.spec, &tile.cell, nodes));
        let exact = job.spec.method != Method::Aggressive;
        (items, tile.kind, nodes, exact, pairs, (unreached, job.spec.sampling.contributions))
    };
    let output = codec::check(bytes, items).map_err(|e| ResultError::Encoding(e.to_string()))?;
    match (&output, kind) {
        (TileOutput::Cells(sets), TileKind::Leaf) => {
            if expected.is_some_and(|nodes| nodes != sets.nodes) {
                return Err(ResultError::Cells);
            }
            if sets.cells.iter().any(|c| c.decision.is_some() != exact) {
                return Err(ResultError::Method);
            }
            if sets.pairs.as_ref().map(|p| (p.seen.cells(), p.hidden.is_some())) != pairs.map(|n| (n, exact))
            {
                return Err(ResultError::Pairs);
            }
            let as_asked = |(cell, unreached): (&CellSet, &bool)| cell.unreached == *unreached;
            if !unreached.is_empty() && !sets.cells.iter().zip(&unreached).all(as_asked)
                || unreached.is_empty() && sets.cells.iter().any(|c| c.unreached)
            {
                return Err(ResultError::Viewpoints);
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

/// Whether no viewpoint is in each cell of a tile with these nodes; empty when viewpoints are everywhere.
fn unreached(spec: &JobSpec, of: &CellBox, nodes: &[Node]) -> Vec<bool> {
    let Some(marks) = &spec.viewpoints else { return Vec::new() };
    let [nx, ny, _] = marks.cells().map(|n| n as usize);
    let (mut open, mut out) = (vec![*of], Vec::new());
    for node in nodes {
        let Some(cell) = open.pop() else { break };
        match node {
            Node::Split(split) => {
                let [below, above] = cell.children(*split);
                open.extend([above, below]);
            }
            Node::Cell => {
                let [x, y, z] = cell.lo.map(|u| (u / UNITS_PER_CELL) as usize);
                out.push(marks.of((z * ny + y) * nx + x) == 0);
            }
        }
    }
    out
}

/// Checks a tile's output and commits it, unless the tile is done.
fn commit(c: &Coordinator, announced: &Announced, bytes: &[u8]) -> Result<(), ResultError> {
    let cells = check(c, announced, bytes)?;
    let &Announced { lease, digest, samples, millis, .. } = announced;
    let Lease { job: id, tile, .. } = lease;
    // The blob first: a record may only name a blob that is present.
    c.blobs.put(bytes).inspect_err(|e| {
        if matches!(e, BlobError::NoSpace { .. }) {
            c.lock().pause_leasing(c.now().at);
        }
    })?;
    let mut scheduler = c.lock();
    // A job with the same output that ended a moment ago may have removed the blob again.
    if !c.blobs.has(&digest)? {
        c.blobs.put(bytes)?;
    }
    let worker = scheduler.jobs.get(&id).and_then(|j| {
        let held = j.slots[tile.at()].lease.as_ref()?;
        scheduler.workers.get(&held.worker).map(|w| w.name.clone())
    });
    let stats = TileStats { samples, cells, millis, worker: worker.unwrap_or_default() };
    let result = TileResult { digest, bytes: announced.bytes, stats: stats.clone() };
    match c.store.commit_tile(id, tile, result)? {
        CommitOutcome::Committed => {
            if let Some(job) = scheduler.jobs.get_mut(&id) {
                let slot = &mut job.slots[tile.at()];
                slot.state = TileState::Done { digest, bytes: announced.bytes, stats };
                slot.lease = None;
            }
            Ok(())
        }
        CommitOutcome::AlreadySame => {
            scheduler.release(&lease);
            Ok(())
        }
        CommitOutcome::Conflict { kept, offered } => {
            scheduler.release(&lease);
            tracing::error!(
                "TWO RESULTS for tile {tile} of job {id}: {} stays, {} is refused. A worker's memory, \
                 driver or program differs from its profile; find out which before trusting this job",
                hex(&kept),
                hex(&offered)
            );
            Err(ResultError::Conflict)
        }
    }
}

/// Starts assembling the result of every job whose tiles are complete, each on a thread of its own.
pub(crate) fn assemble_ready(c: &Arc<Coordinator>) {
    let mut ready = Vec::new();
    let now = c.now().at;
    for (id, job) in &mut c.lock().jobs {
        let runs = matches!(job.record.state, JobState::Queued | JobState::Running);
        let waits = job.no_space_until.is_some_and(|until| now < until);
        if runs && !job.assembling && !waits && job.complete() {
            job.assembling = true;
            let parts = Parts {
                spec: job.spec.clone(),
                lattice: job.lattice,
                plan: job.plan.clone(),
                profile: job.record.profile.clone().unwrap_or_default(),
                slots: job.slots.clone(),
            };
            ready.push((*id, parts));
        }
    }
    for (id, parts) in ready {
        let c = Arc::clone(c);
        std::thread::spawn(move || finish(&c, id, &parts));
    }
}

/// Assembles a job's result and ends the job.
fn finish(c: &Coordinator, id: JobId, parts: &Parts) {
    let leaf = |n: u32| &parts.slots[n as usize].state;
    let assembled = if parts.plan.leaves().all(|n| matches!(leaf(n), TileState::SetAside { .. })) {
        Err("every tile failed; `sightline show` and the workers' logs say why".to_owned())
    } else {
        // A panic must not leave the job half ended.
        match catch_unwind(AssertUnwindSafe(|| assemble(c, parts))) {
            Ok(Err(AssembleError::Blob(e @ BlobError::NoSpace { .. }))) => {
                let every = SPACE_EVERY.as_secs();
                tracing::error!(
                    "the result of job {id} waits for space and is tried again every {every} s: {e}"
                );
                let now = c.now().at;
                let mut scheduler = c.lock();
                if let Some(job) = scheduler.jobs.get_mut(&id) {
                    job.assembling = false;
                    job.no_space_until = Some(now + SPACE_EVERY);
                }
                // There is no space for the outputs of further tiles either.
                scheduler.pause_leasing(now);
                return;
            }
            Ok(r) => r.map_err(|e| e.to_string()),
            Err(_) => Err("assembling the result panicked; the coordinator's log says where".to_owned()),
        }
    };
    let now = c.now().unix_ms;
    let mut scheduler = c.lock();
    // Absent when it was cancelled: the result stays as a blob and is found again by its content.
    let Some(job) = scheduler.jobs.get_mut(&id) else { return };
    job.assembling = false;
    if !matches!(job.record.state, JobState::Queued | JobState::Running) {
        return;
    }
    let ended = match assembled {
        Ok((digest, bytes)) => c.store.finish_job(id, digest, bytes, now),
        Err(e) => {
            tracing::error!("job {id} has no result: {e}");
            let failed = JobState::Failed { reason: e };
            c.store.set_job_state(id, &[JobPhase::Queued, JobPhase::Running], failed, now)
        }
    };
    match ended {
        Ok(record) => {
            if let JobState::Done { bytes, .. } = record.state {
                tracing::info!("job {id} is done, {bytes} bytes");
            }
            scheduler.jobs.remove(&id);
            let whole = matches!(record.state, JobState::Done { .. })
                && parts.slots.iter().all(|s| matches!(s.state, TileState::Done { .. }));
            if whole {
                tidy(c, &scheduler, id, &parts.slots);
            }
        }
        Err(e) => tracing::error!("job {id} cannot be ended: {e}"),
    }
    drop(scheduler);
    c.changed();
}

/// Removes the tile outputs of a finished job, whose result contains them, unless another job needs them: one
/// that has not ended or that can be retried.
fn tidy(c: &Coordinator, scheduler: &Scheduler, finished: JobId, slots: &[Slot]) {
    let digest = |s: &TileState| match s {
        TileState::Done { digest, .. } | TileState::SetAside { digest, .. } => Some(*digest),
        TileState::Open => None,
    };
    let mut kept: BTreeSet<Digest> =
        scheduler.jobs.values().flat_map(|j| &j.slots).filter_map(|s| digest(&s.state)).collect();
    let ended = c.store.jobs().and_then(|jobs| {
        let retriable = |j: &JobRecord| {
            j.id != finished && matches!(j.state.phase(), JobPhase::Cancelled | JobPhase::Failed)
        };
        for job in jobs.iter().filter(|j| retriable(j)) {
            kept.extend(c.store.tiles(job.id)?.iter().filter_map(|t| digest(&t.state)));
        }
        Ok(())
    });
    if let Err(e) = ended {
        tracing::warn!("the tile outputs of job {finished} are kept: {e}");
        return;
    }
    for d in slots.iter().filter_map(|s| digest(&s.state)).filter(|d| !kept.contains(d)) {
        if let Err(e) = c.blobs.remove(&d) {
            tracing::warn!("{e}");
        }
    }
}
