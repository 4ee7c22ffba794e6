//! Worker sessions: joining, the messages of a connected worker, failed tiles, leaving.

use std::sync::Arc;
use std::time::Duration;

use crate::assemble::{AssembleError, stand_in};
use crate::ids::{JobId, Lease, WorkerId};
use crate::results;
use crate::scheduler::{
    Departure, Introduction, Joined, MAX_ATTEMPTS, MAX_FAULTS, NameTaken, Outbox, ProfileTime, Progress,
};
use crate::state::Coordinator;
use crate::store::{StoreError, TileState};

/// Different workers that a tile must fail on before it is set aside.
const WORKERS_TO_FAIL: u32 = 3;
/// The wait after a first fault of a machine or network doubles with each further one, this many times at
/// most.
const MOST_DOUBLINGS: u32 = 6;

/// A message of a worker that cannot be acted on.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SessionError {
    /// The stand-in for a tile that is set aside cannot be written.
    #[error(transparent)]
    StandIn(#[from] AssembleError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A message of a connected worker.
pub(crate) enum Message {
    /// It wants this many more tiles.
    Want(u32),
    /// It finishes the tiles that it holds and takes no more.
    Draining,
    /// A tile makes progress.
    Progress(Progress),
    /// A tile failed.
    Failed(Failure),
    /// It timed its backends for a job.
    Timed(JobId, Vec<ProfileTime>),
}

/// A failed tile.
pub(crate) struct Failure {
    /// Its lease.
    pub(crate) lease: Lease,
    /// The worker's description.
    pub(crate) reason: String,
    /// Whether the machine or the network is at fault and not the tile.
    pub(crate) infrastructure: bool,
}

/// Adds a worker.
///
/// # Errors
/// [`NameTaken`] when another worker of its name is connected.
pub(crate) fn join(c: &Coordinator, intro: Introduction, out: Box<dyn Outbox>) -> Result<Joined, NameTaken> {
    let joining = format!("worker {} has joined, with {}", intro.name, intro.profiles.join(", "));
    let joined = c.lock().join(intro, out, c.now().at)?;
    tracing::info!("{joining}");
    c.changed();
    Ok(joined)
}

/// Removes a worker whose stream has ended.
pub(crate) fn leave(c: &Coordinator, worker: WorkerId, name: &str) {
    match c.lock().leave(worker, c.now().at) {
        Departure::Drained => tracing::info!("worker {name} has drained and left"),
        Departure::Lost => tracing::info!("worker {name} has gone"),
    }
    // The tiles that a drained worker gave back are granted at the next tick.
    c.changed();
}

/// Acts on a message of a worker.
pub(crate) fn heard(
    c: &Arc<Coordinator>,
    worker: WorkerId,
    name: &str,
    message: Message,
) -> Result<(), SessionError> {
    match message {
        Message::Want(tiles) => c.lock().want(worker, tiles),
        Message::Draining => {
            if c.lock().drain(worker) {
                tracing::info!("worker {name} is draining: it finishes its tile and takes no more");
            }
        }
        Message::Progress(progress) => {
            // A stale lease was revoked when it became stale, so the worker has been told.
            if c.lock().renew(&progress, c.now().at) {
                c.changed();
            }
            return Ok(());
        }
        Message::Failed(failure) => {
            failed(c, name, &failure)?;
            results::assemble_ready(c);
        }
        Message::Timed(job, times) => c.lock().timed(worker, job, &times, &*c.store, c.now())?,
    }
    c.grant_tiles();
    c.changed();
    Ok(())
}

/// Counts a tile's failure, and sets the tile aside when it has failed often enough.
fn failed(c: &Coordinator, worker: &str, failure: &Failure) -> Result<(), SessionError> {
    let Failure { lease, reason, infrastructure } = failure;
    let Lease { job: id, tile, .. } = *lease;
    let mut scheduler = c.lock();
    if !scheduler.release(lease) {
        return Ok(());
    }
    tracing::warn!("tile {tile} of job {id} failed on {worker}: {reason}");
    if *infrastructure {
        let Some(job) = scheduler.jobs.get_mut(&id) else { return Ok(()) };
        let slot = &mut job.slots[tile.at()];
        slot.faults += 1;
        if slot.faults < MAX_FAULTS {
            let wait = Duration::from_secs(1 << slot.faults.saturating_sub(1).min(MOST_DOUBLINGS));
            slot.not_before = Some(c.now().at + wait);
            return Ok(());
        }
    }
    let on = c.store.fail_tile(id, tile, worker, reason)?;
    let Some(job) = scheduler.jobs.get_mut(&id) else { return Ok(()) };
    let slot = &mut job.slots[tile.at()];
    slot.attempts += 1;
    if on < WORKERS_TO_FAIL && slot.attempts < MAX_ATTEMPTS {
        return Ok(());
    }
    // The tiles that need it first: if this is interrupted half-way, the tile is still open and fails again.
    for lost in job.lost_with(tile).into_iter().rev() {
        if !matches!(job.slots[lost.at()].state, TileState::Open) {
            continue;
        }
        let (digest, bytes) = stand_in(c, &job.spec, &job.lattice, &job.plan.tiles[lost.at()])?;
        let reasons = vec![format!("tile {tile} failed on {on} workers: {reason}")];
        c.store.set_aside_tile(id, lost, digest, bytes, &reasons)?;
        tracing::error!("tile {lost} of job {id} is set aside: its cells will show every triangle");
        job.slots[lost.at()].state = TileState::SetAside { digest, bytes, reasons };
        job.slots[lost.at()].lease = None;
    }
    Ok(())
}
