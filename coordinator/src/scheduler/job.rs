//! A job that has not ended: its tiles, their leases and what each tile waits for.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use sightline_model::JobSpec;
use sightline_proto::v1;
use sightline_viewcells::{Lattice, Plan, TileKind};

use crate::clock::Moment;
use crate::ids::{Digest, Lease, LeaseId, TileIndex, WorkerId};
use crate::store::{JobRecord, TileRecord, TileState};

/// How long the leases of a worker outlive its stream. A worker that lost its connection reconnects after
/// 0.2, 0.6 and 1.4 s. When it returns later its tiles may have been granted to others, and its work on them
/// is lost.
const AWAY: Duration = Duration::from_secs(3);

/// A tile as the scheduler sees it.
#[derive(Clone, Debug)]
pub(crate) struct Slot {
    pub(crate) state: TileState,
    pub(crate) lease: Option<Leased>,
    /// Failures of the tile since the coordinator started, on any worker.
    pub(crate) attempts: u32,
    /// Faults of machines and networks since the coordinator started.
    pub(crate) faults: u32,
    /// After such a fault the tile waits until then; longer each time.
    pub(crate) not_before: Option<Instant>,
}

impl Slot {
    /// A tile without a lease.
    pub(crate) fn new(state: TileState) -> Self {
        Self { state, lease: None, attempts: 0, faults: 0, not_before: None }
    }
}

/// A tile leased to a worker.
#[derive(Clone, Debug)]
pub(crate) struct Leased {
    pub(crate) id: LeaseId,
    pub(crate) worker: WorkerId,
    pub(super) renewed: Instant,
    pub(super) moved: Instant,
    /// When the worker's stream ended.
    pub(super) gone: Option<Instant>,
    pub(crate) cells: u64,
    pub(crate) samples: u64,
}

impl Leased {
    /// A lease granted now.
    pub(super) fn new(id: LeaseId, worker: WorkerId, now: Instant) -> Self {
        Self { id, worker, renewed: now, moved: now, gone: None, cells: 0, samples: 0 }
    }

    /// The reason to take the lease back, if there is one.
    pub(super) fn over(&self, now: Instant, ttl: Duration, stuck: Duration) -> Option<&'static str> {
        if self.gone.is_some_and(|since| now - since > AWAY) {
            Some("its worker has gone and did not come back")
        } else if now - self.renewed > ttl {
            Some("its lease ran out")
        } else if now - self.moved > stuck {
            Some("it makes no progress")
        } else {
            None
        }
    }
}

/// A job that has not ended.
pub(crate) struct Job {
    pub(crate) record: JobRecord,
    pub(crate) spec: JobSpec,
    pub(crate) lattice: Lattice,
    pub(crate) plan: Plan,
    pub(crate) slots: Vec<Slot>,
    /// The worker that is timing its backends, and since when.
    pub(super) timing: Option<(WorkerId, Instant)>,
    /// How often timing gave no usable backend.
    pub(super) timing_faults: u32,
    /// Whether a thread is assembling the result.
    pub(crate) assembling: bool,
    /// When to assemble the result again, after the disk was full.
    pub(crate) no_space_until: Option<Instant>,
}

impl Job {
    /// The job of a store's record, whose specification is `spec`.
    ///
    /// # Errors
    /// The reason, when the specification or the plan was made by another version of the program.
    pub(crate) fn of(record: JobRecord, spec: &v1::JobSpec, tiles: Vec<TileRecord>) -> Result<Self, String> {
        let parsed = JobSpec::from_proto(spec, None)
            .map_err(|e| e.to_string())
            .and_then(|spec| spec.plan().map(|(l, p)| (spec, l, p)).map_err(|e| e.to_string()));
        let (spec, lattice, plan) = parsed.map_err(|e| format!("{e}; submit it again"))?;
        if record.key != spec.key() {
            return Err("another version of this program began it; submit it again".to_owned());
        }
        if plan.tiles.len() != tiles.len() {
            return Err(format!(
                "it was planned with {} tiles and would now have {}; submit it again",
                tiles.len(),
                plan.tiles.len()
            ));
        }
        let slots = tiles.into_iter().map(|t| Slot::new(t.state)).collect();
        Ok(Self {
            record,
            spec,
            lattice,
            plan,
            slots,
            timing: None,
            timing_faults: 0,
            assembling: false,
            no_space_until: None,
        })
    }

    /// Whether every tile is done or set aside.
    pub(crate) fn complete(&self) -> bool {
        self.slots.iter().all(|s| !matches!(s.state, TileState::Open))
    }

    /// Whether `tile` is open, unleased, and every tile that it needs is done.
    pub(super) fn ready(&self, tile: TileIndex, now: Instant) -> bool {
        let slot = &self.slots[tile.at()];
        matches!(slot.state, TileState::Open)
            && slot.lease.is_none()
            && slot.not_before.is_none_or(|t| t <= now)
            && self.plan.tiles[tile.at()]
                .needs
                .iter()
                .all(|n| matches!(self.slots[*n as usize].state, TileState::Done { .. }))
    }

    /// Milliseconds for a tile granted now, when the job has a time budget: the remaining time, divided by
    /// the open tiles and multiplied by the workers that share them. Never zero, however late it is.
    pub(super) fn millis_for_a_tile(&self, workers: u64, now: Moment) -> Option<u64> {
        let budget = self.spec.time_budget_ms;
        let open = self.slots.iter().filter(|s| matches!(s.state, TileState::Open)).count().max(1) as u64;
        let spent = now.unix_ms.saturating_sub(self.record.submitted_at_ms);
        // A tenth is kept for assembling the result.
        let share = (budget.saturating_sub(spent) / 10 * 9).saturating_mul(workers.clamp(1, open)) / open;
        (budget > 0).then(|| share.max(budget / (8 * self.slots.len().max(1) as u64)))
    }

    /// A leased tile of the job that, as far as is known, its worker has not begun because it works on
    /// another one.
    pub(super) fn waiting(&self) -> Option<(TileIndex, &Leased)> {
        let leased =
            || (0..).map(TileIndex).zip(&self.slots).filter_map(|(t, s)| Some((t, s.lease.as_ref()?)));
        let begun = |l: &Leased| (l.cells, l.samples) != (0, 0);
        let before = |l: &Leased| {
            leased().any(|(_, o)| o.worker == l.worker && o.id != l.id && (begun(o) || o.id < l.id))
        };
        leased().find(|(_, l)| l.gone.is_none() && !begun(l) && before(l))
    }

    /// The lease on a tile, if it is `lease`.
    pub(super) fn leased(&mut self, lease: &Lease) -> Option<&mut Leased> {
        let slot = self.slots.get_mut(lease.tile.at())?;
        slot.lease.as_mut().filter(|l| l.id == lease.id)
    }

    /// Digests of the packs that `tile` needs, in the plan's order.
    pub(super) fn packs(&self, tile: TileIndex) -> Vec<Option<Digest>> {
        let digest = |n: &u32| match &self.slots[*n as usize].state {
            TileState::Done { digest, .. } | TileState::SetAside { digest, .. } => Some(*digest),
            TileState::Open => None,
        };
        self.plan.tiles[tile.at()].needs.iter().map(digest).collect()
    }

    /// `tile` and all tiles that cannot be computed without it.
    pub(crate) fn lost_with(&self, tile: TileIndex) -> BTreeSet<TileIndex> {
        let mut lost = BTreeSet::from([tile]);
        for (i, t) in (0..).map(TileIndex).zip(&self.plan.tiles).skip(tile.at() + 1) {
            if t.needs.iter().any(|n| lost.contains(&TileIndex(*n))) {
                lost.insert(i);
            }
        }
        lost
    }
}

/// View cells of a plan; 0 for an adaptive division, whose cells are not known before it is sampled.
pub(crate) fn cells_total(job: &JobSpec, plan: &Plan) -> u64 {
    match job.division {
        sightline_viewcells::Division::Grid(_) => {
            plan.tiles.iter().filter(|t| t.kind == TileKind::Leaf).map(|t| t.cells).sum()
        }
        sightline_viewcells::Division::Adaptive { .. } => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::Epoch;

    #[test]
    fn a_lease_ends_three_seconds_after_its_workers_stream_unless_the_worker_returns() {
        let start = Instant::now();
        let [ttl, stuck] = [10, 600].map(Duration::from_secs);
        let after =
            |lease: &Leased, seconds: u64| lease.over(start + Duration::from_secs(seconds), ttl, stuck);
        let mut lease = Leased::new(LeaseId { epoch: Epoch(1), number: 1 }, WorkerId(7), start);
        assert_eq!(after(&lease, 9), None);
        assert_eq!(after(&lease, 11), Some("its lease ran out"));
        lease.gone = Some(start);
        assert_eq!(after(&lease, 2), None);
        assert!(after(&lease, 4).is_some_and(|why| why.contains("did not come back")));
        // The worker returned in time: the lease belongs to its new number.
        let mut back = Leased::new(lease.id, WorkerId(8), start + Duration::from_secs(2));
        assert_eq!(after(&back, 9), None);
        (back.renewed, back.moved) = (start + Duration::from_secs(601), start);
        assert_eq!(after(&back, 601), Some("it makes no progress"));
    }
}
