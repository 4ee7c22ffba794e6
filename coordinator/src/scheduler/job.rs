//! A job that has not ended: its tiles, who has them, and what each of them waits for.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use prost::Message as _;
use sightline_model::JobSpec;
use sightline_proto::v1;
use sightline_viewcells::{Lattice, Plan, TileKind};

use crate::store::{JobRecord, TileRecord, TileState};

/// How long a worker whose stream has ended may take to come back for its tiles. One that is still there tries after 0.2, 0.6
/// and 1.4 s. If it comes later they may be others', and what it has done of them in vain.
const AWAY: Duration = Duration::from_secs(3);

/// A lease's identity: epoch and number.
pub(crate) type LeaseId = (u64, u64);

/// A tile as the scheduler sees it.
#[derive(Clone, Debug)]
pub(crate) struct Slot {
    pub(crate) state: TileState,
    pub(crate) lease: Option<Leased>,
    /// Failures since the coordinator started, by whatever worker.
    pub(crate) attempts: u32,
    /// Faults of machines and networks since then.
    pub(crate) faults: u32,
    /// After such a fault the tile waits a little, longer each time.
    pub(crate) not_before: Option<Instant>,
}

impl Slot {
    /// A tile nobody works on.
    pub(crate) fn new(state: TileState) -> Self {
        Self { state, lease: None, attempts: 0, faults: 0, not_before: None }
    }
}

/// A tile in a worker's hands.
#[derive(Clone, Debug)]
pub(crate) struct Leased {
    pub(crate) id: LeaseId,
    pub(crate) worker: u64,
    pub(super) renewed: Instant,
    pub(super) moved: Instant,
    /// When the worker's stream ended.
    pub(super) gone: Option<Instant>,
    pub(crate) cells: u64,
    pub(crate) samples: u64,
}

impl Leased {
    /// Given to a worker now.
    pub(super) fn new(id: LeaseId, worker: u64, now: Instant) -> Self {
        Self { id, worker, renewed: now, moved: now, gone: None, cells: 0, samples: 0 }
    }

    /// Why it is to be taken back, if it is.
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
    pub(super) timing: Option<(u64, Instant)>,
    /// Times that timing gave nothing.
    pub(super) timing_faults: u32,
    pub(crate) assembling: bool,
    /// When to try that again, after there was no space for it.
    pub(crate) no_space_until: Option<Instant>,
}

impl Job {
    /// A job as the store has it.
    ///
    /// # Errors
    /// Why it cannot be worked on: the specification or the plan is of another version of the program.
    pub(crate) fn of(record: JobRecord, tiles: Vec<TileRecord>) -> Result<Self, String> {
        let parsed = v1::JobSpec::decode(record.spec.as_slice())
            .map_err(|e| e.to_string())
            .and_then(|m| JobSpec::from_proto(&m, None).map_err(|e| e.to_string()))
            .and_then(|spec| spec.plan().map(|(l, p)| (spec, l, p)).map_err(|e| e.to_string()));
        let (spec, lattice, plan) = parsed.map_err(|e| format!("{e}; submit it again"))?;
        if record.key != spec.key() {
            return Err("it was begun by another version of this program; submit it again".to_owned());
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

    /// Whether `tile` is open, unleased, and all it needs is there.
    pub(super) fn ready(&self, tile: usize, now: Instant) -> bool {
        let slot = &self.slots[tile];
        matches!(slot.state, TileState::Open)
            && slot.lease.is_none()
            && slot.not_before.is_none_or(|t| t <= now)
            && self.plan.tiles[tile]
                .needs
                .iter()
                .all(|n| matches!(self.slots[*n as usize].state, TileState::Done { .. }))
    }

    /// Time for a tile granted now, when the job has a time budget: what is left of it, divided among the tiles still open
    /// by as many as are worked on at once. However late it is, every tile gets a little.
    pub(super) fn millis_for_a_tile(&self, workers: u64) -> Option<u64> {
        let budget = self.spec.time_budget_ms;
        let open = self.slots.iter().filter(|s| matches!(s.state, TileState::Open)).count().max(1) as u64;
        let spent = crate::core::now_ms().saturating_sub(self.record.submitted_at_ms);
        // A tenth is kept for putting the result together.
        let share = (budget.saturating_sub(spent) / 10 * 9).saturating_mul(workers.clamp(1, open)) / open;
        (budget > 0).then(|| share.max(budget / (8 * self.slots.len().max(1) as u64)))
    }

    /// A tile that waits in the hands of a worker for another one of the job, as far as is known.
    pub(super) fn waiting(&self) -> Option<(usize, &Leased)> {
        let leased = || self.slots.iter().enumerate().filter_map(|(t, s)| Some((t, s.lease.as_ref()?)));
        let begun = |l: &Leased| (l.cells, l.samples) != (0, 0);
        let before = |l: &Leased| {
            leased().any(|(_, o)| o.worker == l.worker && o.id != l.id && (begun(o) || o.id < l.id))
        };
        leased().find(|(_, l)| l.gone.is_none() && !begun(l) && before(l))
    }

    /// Digests of the packs `tile` needs, in the plan's order.
    pub(super) fn packs(&self, tile: usize) -> Vec<Vec<u8>> {
        let digest = |n: &u32| match &self.slots[*n as usize].state {
            TileState::Done { digest, .. } | TileState::SetAside { digest, .. } => digest.to_vec(),
            TileState::Open => Vec::new(),
        };
        self.plan.tiles[tile].needs.iter().map(digest).collect()
    }

    /// `tile` and all leaf tiles that cannot be made without it.
    pub(crate) fn lost_with(&self, tile: u32) -> BTreeSet<u32> {
        let mut lost = BTreeSet::from([tile]);
        for (i, t) in self.plan.tiles.iter().enumerate().skip(tile as usize + 1) {
            if t.needs.iter().any(|n| lost.contains(n)) {
                lost.insert(i as u32);
            }
        }
        lost
    }
}

/// Leaf cells the plan knows of; 0 when an adaptive division decides as it goes.
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

    #[test]
    fn a_lease_is_taken_back_once_its_worker_is_gone_for_long_and_not_when_it_has_come_back() {
        let start = Instant::now();
        let [ttl, stuck] = [10, 600].map(Duration::from_secs);
        let after =
            |lease: &Leased, seconds: u64| lease.over(start + Duration::from_secs(seconds), ttl, stuck);
        let mut lease = Leased::new((1, 1), 7, start);
        assert_eq!(after(&lease, 9), None);
        assert_eq!(after(&lease, 11), Some("its lease ran out"));
        lease.gone = Some(start);
        assert_eq!(after(&lease, 2), None);
        assert!(after(&lease, 4).is_some_and(|why| why.contains("did not come back")));
        // Back in time: the lease is another worker number's, from then on.
        let mut back = Leased::new(lease.id, 8, start + Duration::from_secs(2));
        assert_eq!(after(&back, 9), None);
        (back.renewed, back.moved) = (start + Duration::from_secs(601), start);
        assert_eq!(after(&back, 601), Some("it makes no progress"));
    }
}
