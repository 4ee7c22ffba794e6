//! The connected workers and what they do: for people.

use super::messages::Now;
use super::state::{Leased, Scheduler, Worker};
use super::worker_totals::WorkerTotals;
use crate::ids::{JobId, LeaseId, TileIndex, WorkerId};

/// A connected worker.
#[derive(Clone, Debug)]
pub(crate) struct WorkerStatus {
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) profiles: Vec<String>,
    /// Milliseconds since 1970.
    pub(crate) connected_at: u64,
    pub(crate) heard_at: u64,
    pub(crate) draining: bool,
    /// Why it gets no tiles although it asks for some.
    pub(crate) trouble: Option<&'static str>,
    pub(crate) tiles: Vec<LeasedTile>,
    pub(crate) helps: Option<LeasedTile>,
    pub(crate) done: WorkerTotals,
}

/// A tile in a worker's hands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeasedTile {
    pub(crate) job: JobId,
    pub(crate) tile: TileIndex,
    pub(crate) has_begun: bool,
    /// Milliseconds since 1970.
    pub(crate) since: u64,
    pub(crate) cells: u64,
    pub(crate) samples: u64,
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
            .deaf_until
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
    pub(crate) fn roster(&self, now: Now) -> Vec<WorkerStatus> {
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
    pub(crate) fn name_of(&self, id: WorkerId) -> Option<&str> {
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
