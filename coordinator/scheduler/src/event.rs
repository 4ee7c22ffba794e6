//! The events that the scheduler receives, and the effects that it returns.
//!
//! An [`Event`] has already happened. The caller executes each [`Effect`] in the order of the list. The
//! outcome of a [`StoreCommand`] is reported by a later event.

use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_records::ids::{Digest, JobId, Lease, TileIndex, WorkerId};
use sightline_records::{JobRecord, TileStats};

use super::job::OpenJob;
use super::messages::{Introduction, Joined, NameTaken, ProfileTime, Progress, WorkerCommand};

/// The failure of a tile.
#[derive(Clone, Debug)]
pub struct Failure {
    /// The lease of the tile.
    pub lease: Lease,
    /// The worker's description of the failure.
    pub reason: String,
    /// True if the machine or the network is at fault, and not the tile.
    pub infrastructure: bool,
}

/// An event of the coordinator, its store, its workers or its clock.
#[derive(Debug)]
pub enum Event {
    /// The store has a job that has not ended.
    TakenUp(Box<OpenJob>),
    /// The scheduler must lease only tiles of this job from now on.
    Restricted(JobId),
    /// The record of a job has changed in the store.
    JobChanged(Box<JobRecord>),
    /// The tiles of a paused job must stop now.
    Stopped(JobId),
    /// A worker's stream has begun. The answer is [`Effect::Joined`].
    Joined(Introduction),
    /// A worker's stream has ended. The answer is [`Effect::Left`].
    Left(WorkerId),
    /// A worker requests this many additional tiles.
    Wanted(WorkerId, u32),
    /// A worker accepts no further tiles.
    Drains(WorkerId),
    /// A worker reports the progress of a tile.
    Progressed(Progress),
    /// A tile failed on a worker.
    Failed(WorkerId, Failure),
    /// A worker has timed its backends for a job.
    Timed(WorkerId, JobId, Vec<ProfileTime>),
    /// The store has committed an output of the tile.
    Committed {
        /// The lease under which the output arrived.
        lease: Lease,
        /// The digest of the output.
        digest: Digest,
        /// The cost of the output.
        stats: TileStats,
    },
    /// A worker has computed a done tile again under this lease.
    Checked {
        /// The lease of the check.
        lease: Lease,
        /// The digest of the received output.
        digest: Digest,
    },
    /// An output that arrived under this lease differs from the tile's output.
    Differed {
        /// The lease of the differing output.
        lease: Lease,
        /// The digest of the received output.
        digest: Digest,
    },
    /// The worker with this signature was quarantined.
    Quarantined(String),
    /// The coordinator has removed the outcomes of phases to which quarantined workers may have contributed.
    Swept,
    /// The quarantine of the worker with this signature has ended.
    Released(String),
    /// The output that arrived under this lease could not be written.
    DiskFull(Lease),
    /// A command with this lease could not be sent to its worker.
    Undelivered(WorkerId, Lease),
    /// [`StoreCommand::Fail`] or [`StoreCommand::CountDeath`] has been executed.
    FailureRecorded {
        /// The job of the tile.
        job: JobId,
        /// The failed tile.
        tile: TileIndex,
        /// The number of workers on which the tile has failed.
        on: u32,
        /// The reason of the last failure.
        reason: String,
        /// The name of the worker whose death is the failure; `None` for other failures.
        dead: Option<String>,
    },
    /// A tile of [`StoreCommand::SetAside`] has a placeholder in the store.
    SetAside {
        /// The job of the tile.
        job: JobId,
        /// The tile that was set aside.
        tile: TileIndex,
        /// The digest of the placeholder.
        digest: Digest,
    },
    /// [`StoreCommand::Bind`] has been executed. Contains the recorded profile, which may be an earlier one.
    Bound(JobId, String),
    /// The store rejected a command.
    Refused(StoreCommand),
    /// The result of a job cannot be written for now.
    AssemblyWaits(JobId),
    /// The result of a job is not needed for now, because the job was paused or has ended.
    AssemblyDropped(JobId),
    /// The holder of a lease leads a crew, which idle workers can help.
    CrewOpened(Lease),
    /// The crew of this lease has ended.
    CrewClosed(Lease),
    /// A worker no longer helps the holder of a lease.
    Helped(WorkerId, Lease),
    /// The command to help the holder of a lease could not be sent to its worker.
    HelpUndelivered(WorkerId, Lease),
    /// Time has passed. The scheduler checks deadlines only on this event.
    Tick,
}

/// The way in which a worker's stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// The worker had announced that it accepts no further tiles.
    Drained,
    /// The worker had announced nothing. It may return for its leases.
    Lost,
}

/// A change of the store. The caller executes each command outside of any lock and reports it by an event.
#[derive(Clone, Debug)]
pub enum StoreCommand {
    /// Bind a job to a profile. Reported by [`Event::Bound`].
    Bind(JobId, String),
    /// Move a queued job to running. Reported by [`Event::JobChanged`].
    Start(JobId),
    /// Record a failure. Reported by [`Event::FailureRecorded`].
    Fail {
        /// The job of the tile.
        job: JobId,
        /// The failed tile.
        tile: TileIndex,
        /// The name of the worker.
        worker: String,
        /// The worker's reason.
        reason: String,
    },
    /// Record the death of a worker as a failure. Reported by [`Event::FailureRecorded`].
    CountDeath {
        /// The job of the tile.
        job: JobId,
        /// The tile that the worker held first.
        tile: TileIndex,
        /// The name of the worker.
        worker: String,
        /// The recorded reason.
        reason: String,
    },
    /// Remove the death of a worker that has returned.
    CancelDeath {
        /// The job of the tile.
        job: JobId,
        /// The tile that the worker held first.
        tile: TileIndex,
        /// The name of the worker.
        worker: String,
        /// The recorded reason.
        reason: String,
    },
    /// Set tiles aside in this order. Reported by [`Event::SetAside`] for each tile.
    SetAside {
        /// The job of the tiles.
        job: JobId,
        /// The specification and plan of the job, from which the placeholders are made.
        planned: Arc<PlannedJob>,
        /// The tiles to set aside.
        tiles: Vec<TileIndex>,
        /// The reason for setting the tiles aside.
        reason: String,
    },
    /// Record that this worker has computed the same output for a tile.
    Confirm {
        /// The job of the tile.
        job: JobId,
        /// The confirmed tile.
        tile: TileIndex,
        /// The digest of the output that both workers have computed.
        digest: Digest,
        /// The name of the worker.
        worker: String,
    },
    /// Record that workers are quarantined, and reopen the tiles that they contributed to. Tiles that a
    /// worker committed no later than its last confirmed result stay done. Reported by [`Event::TakenUp`] for
    /// each affected job.
    Quarantine {
        /// The signatures of the workers.
        workers: Vec<String>,
        /// The tile whose wrong output led to the quarantine, if its stored output was wrong. It is always
        /// reopened.
        condemned: Option<(JobId, TileIndex)>,
        /// The reason for the quarantine.
        reason: String,
    },
    /// End a job without a result. Reported by [`Event::JobChanged`].
    FailJob(JobId, String),
}

/// A message for the log.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    /// A lease has ended before its tile was done. Contains the worker's name and the reason.
    TakenBack(Lease, Option<String>, &'static str),
    /// An idle worker takes over the waiting tile of this worker.
    TakenOver(Lease, String),
    /// An idle worker gets a second lease on a tile that runs for an unusually long time.
    Doubled(Lease),
    /// A tile failed on this worker for this reason.
    TileFailed(Lease, String, String),
    /// This worker died while it held the tile.
    Died(Lease, String),
    /// This worker computed a tile again with the same bytes.
    Agrees(JobId, TileIndex, String),
    /// A worker computed a tile again with other bytes. Contains all workers that contributed to either
    /// output.
    Differs(JobId, TileIndex, Vec<String>),
    /// The bytes of a tile differ, and only a third worker can decide which are right.
    NeedsThird(JobId, TileIndex),
    /// A tile was drawn for a check but is not checked, for this reason.
    Unchecked(JobId, TileIndex, &'static str),
    /// This worker drains.
    Draining(String),
    /// The profile that the timing of backends has chosen for a job.
    Chosen(JobId, String),
    /// The wait of this job for leases of an earlier epoch has ended. This number of its tiles can be leased,
    /// and is granted from now on.
    GraceOver(JobId, usize),
}

/// An action that the caller must execute.
#[derive(Debug)]
pub enum Effect {
    /// Send a command to a worker.
    Tell(WorkerId, WorkerCommand),
    /// Change the store.
    Run(StoreCommand),
    /// Assemble the result of a job whose tiles are complete.
    Assemble(JobId),
    /// Notify the watchers of a job.
    Changed(JobId),
    /// The answer to [`Event::Joined`].
    Joined(Result<Joined, NameTaken>),
    /// The answer to [`Event::Left`].
    Left(Departure),
    /// Write a message to the log.
    Note(Note),
}
