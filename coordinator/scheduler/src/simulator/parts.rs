//! The parts of a simulated world: messages, streams, workers, and events.

use std::collections::BTreeMap;

use sightline_model::{GridCells, JobSpec, KnownCells, Method, Sampler, Sampling, TracerChoice};
use sightline_records::ids::{Digest, JobId, Lease, LeaseId, TileIndex, WorkerId};
use sightline_scene::Aabb;
use sightline_store::MemoryStore;
use sightline_store::failing::FailingDisk;

use crate::{Event, Introduction, Progress, StoreCommand};

/// A worker's message.
pub(super) enum WorkerMessage {
    Hello(Introduction),
    Want(u32),
    Drains,
    Progress(Progress),
    Failed(Lease, bool),
}

/// A coordinator's message.
pub(super) enum CoordinatorMessage {
    Welcome(Vec<Lease>),
    Grant(Lease),
    Revoke(Lease),
    Refused,
}

/// The answer to an output.
#[derive(Clone, Copy)]
pub(super) enum CommitAnswer {
    Kept,
    NotNeeded,
    Differs,
    Later,
}

/// A scheduled event. The life after a worker's number is the worker's; other lives are the coordinator's.
pub(super) enum SimulatedEvent {
    Tick(u64),
    Connect(usize, u64),
    Up(usize, WorkerMessage),
    Down(usize, CoordinatorMessage),
    UpBroken(usize),
    DownBroken(usize),
    Beat(usize, u64),
    Ran(usize, u64, LeaseId),
    Deliver(usize, u64, LeaseId),
    Arrives(usize, u64, Lease),
    Durable(u64, usize, u64, Vec<Event>, LeaseId, CommitAnswer),
    Answered(usize, u64, LeaseId, CommitAnswer),
    Stopped(usize, u64, LeaseId),
    Run(u64, Box<StoreCommand>),
    Assemble(u64, JobId),
    Fault,
    Revive(usize, u64),
    CoordinatorUp,
    DiskFree,
    /// A leader's stream to its crew begins or ends, or a helper returns.
    Crew(u64, Box<Event>),
}

/// A stream between a worker and one life of the coordinator.
pub(super) struct StreamEnds {
    pub(super) worker: usize,
    pub(super) life: u64,
    pub(super) number: Option<WorkerId>,
    pub(super) closed: bool,
    pub(super) up_at: u64,
    pub(super) down_at: u64,
}

/// A tile that a worker holds.
pub(super) struct SimulatedTile {
    pub(super) lease: Lease,
    pub(super) runs: bool,
    pub(super) ran: bool,
    pub(super) cancelled: bool,
    pub(super) samples: u64,
    pub(super) tries: u32,
}

/// A simulated worker.
pub(super) struct SimulatedWorker {
    pub(super) profile: String,
    pub(super) alive: bool,
    /// The number of starts. Events for an earlier life are ignored.
    pub(super) life: u64,
    /// The time until which the worker is suspended.
    pub(super) paused_until: u64,
    /// The time until which the worker's network is interrupted.
    pub(super) cut_until: u64,
    pub(super) stream: Option<usize>,
    pub(super) wait: u64,
    pub(super) held: BTreeMap<LeaseId, SimulatedTile>,
    pub(super) draining: bool,
    /// The factor by which the worker is slower than others.
    pub(super) slowness: u64,
    /// True if the worker's memory is broken, so that its outputs differ.
    pub(super) broken: bool,
}

/// The store of a world.
pub(super) enum Ground {
    /// In memory, without faults.
    Memory(MemoryStore),
    /// On a disk that fails.
    Disk(Box<FailingDisk>),
}

/// The consequence of an error of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The store continues.
    Later,
    /// The coordinator must start again.
    Ended,
}

/// Returns the specification of all jobs; their plans differ.
pub(super) fn spec() -> JobSpec {
    let view = Aabb::new(glam::Vec3::ZERO, glam::Vec3::ONE);
    let cells = GridCells::new(view, [1, 1, 1]).unwrap();
    let sampling = Sampling {
        tracer: TracerChoice::Cpu,
        ..Sampling::new(Sampler::lines(KnownCells::Grid(cells)))
    };
    JobSpec::new([7; 32], Method::aggressive(sampling))
}

/// Returns the output of a tile, by a worker whose memory is broken or not.
pub(super) fn output(job: JobId, tile: TileIndex, broken: bool) -> Vec<u8> {
    let bytes = format!("{job} {tile} {broken} ");
    bytes.repeat(1 + (tile.at() * 31) % 200).into_bytes()
}

/// Returns the digest of an output.
pub(super) fn digest(bytes: &[u8]) -> Digest {
    *blake3::hash(bytes).as_bytes()
}
