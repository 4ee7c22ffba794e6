//! The connected workers and their work, for display.

use sightline_records::ids::{JobId, LeaseId, TileIndex, WorkerId};

use super::messages::Now;
use super::state::{Leased, Scheduler, Worker};
use super::worker_totals::WorkerTotals;

/// A connected worker.
#[derive(Clone, Debug)]
pub struct WorkerStatus {
    /// The name.
    pub name: String,
    /// The version of the program.
    pub version: String,
    /// The numerics profiles of its tracers.
    pub profiles: Vec<String>,
    /// The time of the connection, in milliseconds since 1970.
    pub connected_at: u64,
    /// The time of the last message, in milliseconds since 1970.
    pub heard_at: u64,
    /// True if the worker accepts no further tiles.
    pub draining: bool,
    /// The reason why the worker gets no tiles although it requests some.
    pub trouble: Option<&'static str>,
    /// The leased tiles.
    pub tiles: Vec<LeasedTile>,
    /// The tile with which the worker helps another one.
    pub helps: Option<LeasedTile>,
    /// The totals of its finished work.
    pub done: WorkerTotals,
}

/// A tile that a worker computes or waits with.
#[derive(Clone, Copy, Debug)]
pub struct LeasedTile {
    /// The job.
    pub job: JobId,
    /// The tile.
    pub tile: TileIndex,
    /// True if the worker has begun the tile.
    pub has_begun: bool,
    /// The time of the grant, in milliseconds since 1970.
    pub since: u64,
    /// The number of finished cells.
    pub cells: u64,
    /// The number of samples.
    pub samples: u64,
}

impl Scheduler {
    /// Why a worker gets no tiles although it asks for some.
    pub(super) fn trouble(&self, worker: &Worker) -> Option<&'static str> {
        if self.quarantined.contains(&worker.signature) {
            return Some("it is quarantined: its bytes were not those of others");
        }
        if self.suspects.contains_key(&worker.signature) {
            return Some(
                "another worker has computed other bytes; a third one has to say who is right",
            );
        }
        if worker.silent {
            return Some("its last lease ran out, and it has said nothing since");
        }
        worker
            .backpressured_until
            .map(|_| "it does not read the orders that it is sent")
    }

    /// Notes that a worker has said something.
    pub(super) fn hear(&mut self, id: WorkerId, now: Now) {
        if let Some(worker) = self.workers.get_mut(&id) {
            worker.heard = now.unix_ms;
            worker.unheard = None;
        }
    }

    /// The connected workers, by name.
    pub fn roster(&self, now: Now) -> Vec<WorkerStatus> {
        let held = |id: &LeaseId| self.leases.get(id).map(|lease| held(lease, now));
        let member = |worker: &Worker| WorkerStatus {
            name: worker.name.clone(),
            version: worker.version.clone(),
            profiles: worker.profiles.iter().map(|p| p.to_string()).collect(),
            connected_at: worker.joined,
            heard_at: worker.heard,
            draining: worker.draining,
            trouble: self.trouble(worker),
            tiles: worker.leases.iter().filter_map(held).collect(),
            helps: worker.helps.and_then(|lease| held(&lease.id)),
            done: worker.done,
        };
        let mut all: Vec<WorkerStatus> = self.workers.values().map(member).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all
    }

    /// The name of a connected worker.
    pub fn name_of(&self, id: WorkerId) -> Option<&str> {
        self.workers.get(&id).map(|worker| worker.name.as_str())
    }
}

fn held(lease: &Leased, now: Now) -> LeasedTile {
    LeasedTile {
        job: lease.job,
        tile: lease.tile,
        has_begun: lease.begun.is_some(),
        since: now
            .unix_ms
            .saturating_sub(now.ms.saturating_sub(lease.given)),
        cells: lease.cells,
        samples: lease.samples,
    }
}
