//! The events that the scheduler receives, and the effects that it returns.
//!
//! An [`Event`] has happened already. An [`Effect`] is to be carried out by the caller, in the order of the
//! list; the outcome of a [`StoreCommand`] comes back as a later event.

use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_records::ids::{Digest, JobId, Lease, TileIndex, WorkerId};
use sightline_records::{JobRecord, TileStats};

use super::job::Job;
use super::messages::{Introduction, Joined, NameTaken, ProfileTime, Progress, WorkerCommand};

/// A failed tile.
#[derive(Clone, Debug)]
pub struct Failure {
    /// Its lease.
    pub lease: Lease,
    /// The worker's description.
    pub reason: String,
    /// Whether the machine or the network is at fault and not the tile.
    pub infrastructure: bool,
}

/// Something that has happened.
#[derive(Debug)]
pub enum Event {
    /// A job that has not ended, from the store.
    TakenUp(Box<Job>),
    /// From now on only tiles of this job are leased.
    Restricted(JobId),
    /// The record of a job has changed in the store.
    JobChanged(Box<JobRecord>),
    /// The tiles of a paused job are to stop now.
    Stopped(JobId),
    /// A worker's stream has begun. Answered by [`Effect::Joined`].
    Joined(Introduction),
    /// A worker's stream has ended. Answered by [`Effect::Left`].
    Left(WorkerId),
    /// A worker wants this many more tiles.
    Wanted(WorkerId, u32),
    /// A worker takes no more tiles.
    Drains(WorkerId),
    /// A tile makes progress.
    Progressed(Progress),
    /// A tile failed on a worker.
    Failed(WorkerId, Failure),
    /// A worker timed its backends for a job.
    Timed(WorkerId, JobId, Vec<ProfileTime>),
    /// The store has an output of the tile.
    Committed {
        /// The lease under which it arrived.
        lease: Lease,
        /// Digest of the output.
        digest: Digest,
        /// What it cost.
        stats: TileStats,
    },
    /// A done tile was computed again under this lease.
    Checked {
        /// The lease.
        lease: Lease,
        /// Digest of what arrived.
        digest: Digest,
    },
    /// An output that arrived under this lease differs from the one that the tile has.
    Differed {
        /// The lease.
        lease: Lease,
        /// Digest of what arrived.
        digest: Digest,
    },
    /// The worker of this name gets no tiles any more.
    Quarantined(String),
    /// The outcomes of phases in which quarantined workers may have had a hand are removed.
    Swept,
    /// The worker of this name gets tiles again.
    Released(String),
    /// The output that arrived under this lease could not be written.
    DiskFull(Lease),
    /// An order with a lease could not be sent to its worker.
    Undelivered(WorkerId, Lease),
    /// [`StoreCommand::Fail`] or [`StoreCommand::CountDeath`] is done: the tile has failed on this many
    /// different workers.
    FailureRecorded {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// Different workers.
        on: u32,
        /// The last reason.
        reason: String,
        /// The worker whose death the failure is; `None` for other failures.
        dead: Option<String>,
    },
    /// A tile of [`StoreCommand::SetAside`] has a stand-in in the store.
    SetAside {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// Digest of the stand-in.
        digest: Digest,
    },
    /// [`StoreCommand::Bind`] is done; the store may have known another profile.
    Bound(JobId, String),
    /// The store refused a command.
    Refused(StoreCommand),
    /// The result of a job cannot be written for now.
    AssemblyWaits(JobId),
    /// The result of a job is not needed for now: it was paused, or has ended.
    AssemblyDropped(JobId),
    /// The holder of a lease leads a crew, which idle workers can help.
    CrewOpened(Lease),
    /// The crew has ended.
    CrewClosed(Lease),
    /// A worker helps the holder of a lease no more.
    Helped(WorkerId, Lease),
    /// The order to help the holder of a lease could not be sent to its worker.
    HelpUndelivered(WorkerId, Lease),
    /// Time has passed. Expiries are looked at with this event alone.
    Tick,
}

/// How a worker's stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// The worker had said that it takes no more tiles.
    Drained,
    /// The worker had said nothing; it may return for its leases.
    Lost,
}

/// A change of the store. Each runs outside of any lock and ends with an event.
#[derive(Clone, Debug)]
pub enum StoreCommand {
    /// Bind a job to a profile: [`Event::Bound`].
    Bind(JobId, String),
    /// Move a queued job to running: [`Event::JobChanged`].
    Start(JobId),
    /// Record a failure: [`Event::FailureRecorded`].
    Fail {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// The worker's name.
        worker: String,
        /// Its reason.
        reason: String,
    },
    /// Record the death of a worker as a failure: [`Event::FailureRecorded`].
    CountDeath {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// The worker's name.
        worker: String,
        /// The reason that is kept.
        reason: String,
    },
    /// Forget the death of a worker that has returned.
    CancelDeath {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// The worker's name.
        worker: String,
        /// The reason that is kept.
        reason: String,
    },
    /// Set tiles aside, in this order: [`Event::SetAside`] for each.
    SetAside {
        /// The job.
        job: JobId,
        /// Its specification and plan, from which the stand-ins are made.
        work: Arc<PlannedJob>,
        /// The tiles.
        tiles: Vec<TileIndex>,
        /// Why.
        reason: String,
    },
    /// Record that this worker has computed the same for a tile.
    Confirm {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
        /// Digest of what both have computed.
        digest: Digest,
        /// The worker's name.
        worker: String,
    },
    /// Record that these workers are quarantined, and have what they did since they were last right computed
    /// again: [`Event::TakenUp`] for each job of which that is a part.
    Quarantine {
        /// Their names.
        workers: Vec<String>,
        /// The tile by which they were found, if its output was theirs: it is computed again in any case.
        condemned: Option<(JobId, TileIndex)>,
        /// Why.
        reason: String,
    },
    /// End a job without a result: [`Event::JobChanged`].
    FailJob(JobId, String),
}

/// Something for people to read.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    /// A lease has ended before its tile.
    TakenBack(Lease, Option<String>, &'static str),
    /// An idle worker takes the waiting tile of this worker.
    TakenOver(Lease, String),
    /// An idle worker gets a tile that another worker has been busy with for long.
    Doubled(Lease),
    /// A tile failed on this worker.
    TileFailed(Lease, String, String),
    /// This worker died with a tile.
    Died(Lease, String),
    /// A tile was computed again with the same bytes, by this worker.
    Agrees(JobId, TileIndex, String),
    /// A tile was computed again with other bytes; all who had a hand in any of them.
    Differs(JobId, TileIndex, Vec<String>),
    /// Only a third worker can say which bytes of a tile are right.
    NeedsThird(JobId, TileIndex),
    /// A tile was drawn and is not checked, and why.
    Unchecked(JobId, TileIndex, &'static str),
    /// A worker drains.
    Draining(String),
    /// The outcome of timing.
    Chosen(JobId, String),
    /// Leases of an earlier epoch were waited for, and this many tiles are free again.
    GraceOver(JobId, usize),
}

/// Something to be done.
#[derive(Debug)]
pub enum Effect {
    /// Send an order to a worker.
    Tell(WorkerId, WorkerCommand),
    /// Change the store.
    Run(StoreCommand),
    /// Assemble the result of a job whose tiles are complete.
    Assemble(JobId),
    /// Tell the watchers of a job.
    Changed(JobId),
    /// The answer to [`Event::Joined`].
    Joined(Result<Joined, NameTaken>),
    /// The answer to [`Event::Left`].
    Left(Departure),
    /// Write a line to the log.
    Note(Note),
}
