//! The connected workers and their work, for display.

use sightline_records::ids::{JobId, LeaseId, TileIndex, WorkerId};

use super::messages::Now;
use super::state::{Leased, Scheduler, Worker};
use super::worker_totals::WorkerTotals;

/// A connected worker.
#[derive(Clone, Debug)]
pub struct WorkerStatus {
    /// The name of the worker.
    pub name: String,
    /// The version of the worker's program.
    pub version: String,
    /// The numerics profiles of the worker's tracers.
    pub profiles: Vec<String>,
    /// The time of the connection, in milliseconds since 1970.
    pub connected_at: u64,
    /// The time of the last message, in milliseconds since 1970.
    pub heard_at: u64,
    /// True if the worker accepts no further tiles.
    pub draining: bool,
    /// The reason why the worker gets no tiles although it requests some.
    pub trouble: Option<&'static str>,
    /// The tiles leased to the worker.
    pub tiles: Vec<LeasedTile>,
    /// The tile of another worker that this worker helps with.
    pub helps: Option<LeasedTile>,
    /// The totals of the worker's finished tiles.
    pub done: WorkerTotals,
}

/// A tile that a worker computes, or that waits at the worker.
#[derive(Clone, Copy, Debug)]
pub struct LeasedTile {
    /// The job of the tile.
    pub job: JobId,
    /// The index of the tile in the job.
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
    /// Returns the reason why a worker gets no tiles although it requests some.
    pub(super) fn trouble(&self, worker: &Worker) -> Option<&'static str> {
        if self.trust.quarantined.contains(&worker.signature) {
            return Some(
                "the worker is quarantined, because its bytes differed from the bytes of other \
                 workers",
            );
        }
        if self.trust.suspects.contains_key(&worker.signature) {
            return Some(
                "another worker computed different bytes for a tile; a third worker must compute the tile",
            );
        }
        if worker.unresponsive {
            return Some(
                "the worker's last lease expired, and the worker has requested no tile since",
            );
        }
        worker
            .backpressured_until
            .map(|_| "the worker does not read the commands that the coordinator sends")
    }

    /// Records that a worker has sent a message.
    pub(super) fn hear(&mut self, id: WorkerId, now: Now) {
        if let Some(worker) = self.roster.workers.get_mut(&id) {
            worker.heard = now.unix_ms;
            worker.unheard = None;
        }
    }

    /// Returns the connected workers, by name.
    pub fn roster(&self, now: Now) -> Vec<WorkerStatus> {
        let held = |id: &LeaseId| self.leases.table.get(id).map(|lease| held(lease, now));
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
        let mut all: Vec<WorkerStatus> = self.roster.workers.values().map(member).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all
    }

    /// Returns the name of a connected worker.
    pub fn name_of(&self, id: WorkerId) -> Option<&str> {
        self.roster
            .workers
            .get(&id)
            .map(|worker| worker.name.as_str())
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
