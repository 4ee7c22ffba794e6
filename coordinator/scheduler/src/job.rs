//! A job that has not ended: its tiles, its ready tiles, and its totals.
//!
//! The job stores totals in addition to its tiles, and changes both together. `invariants.rs` recomputes the
//! totals. This module does not depend on workers.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_model::{PlannedJob, Task};
use sightline_records::ids::{Digest, Epoch, LeaseId, TileIndex, WorkerId};
use sightline_records::{JobPhase, JobRecord, TileRecord, TileState, TileStats, owned_key};
use sightline_viewcells::{Division, TileKind};

use super::messages::Now;
use super::pools::{List, QueuePosition};
use super::progress_rate::ProgressRate;
use super::queue::QueueKey;
use super::spot_check::{Name, SpotCheck};

/// The output of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The tile has no output.
    Open,
    /// The tile has a result with this digest.
    Done(Digest),
    /// The tile was set aside and has a placeholder with this digest.
    SetAside(Digest),
}

impl Output {
    /// Returns the digest of the output's blob, or `None` for an open tile.
    pub fn digest(&self) -> Option<Digest> {
        match self {
            Self::Done(d) | Self::SetAside(d) => Some(*d),
            Self::Open => None,
        }
    }
}

/// The scheduler's data about a tile.
#[derive(Clone, Debug)]
pub struct Tile {
    pub output: Output,
    /// The leases of the tile: at most two, the second one for a tile that takes long.
    pub(super) leases: [Option<LeaseId>; 2],
    /// The number of tiles that this tile needs and that are not done.
    pub(super) missing: u32,
    /// The number of failures since the coordinator started, on any worker, without deaths.
    pub(super) attempts: u32,
    /// The instances of the workers that died with the tile since the coordinator started.
    pub(super) deaths: Vec<u64>,
    /// The number of faults of machines and networks since the coordinator started.
    pub(super) faults: u32,
    /// The end of the delay after such a fault, in milliseconds. Each fault makes the delay longer.
    pub(super) not_before: Option<u64>,
    /// True while the store executes a command about the tile's failure.
    pub(super) judged: bool,
    /// The workers that led a crew for the tile or helped with it. Their outcomes may be part of its output.
    pub(super) contributors: BTreeSet<Name>,
    /// The worker that sent the output; empty if there is no output or the worker is unknown.
    pub(super) author: Name,
}

impl Tile {
    /// Returns true if the state of the tile permits a lease.
    pub(super) fn can_be_leased(&self) -> bool {
        self.output == Output::Open
            && self.leases == [None; 2]
            && self.missing == 0
            && self.not_before.is_none()
            && !self.judged
    }
}

/// The reason why a job waits without granting leases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parked {
    /// A wait for this worker, which times its backends.
    Timing(WorkerId),
    /// A wait for more workers before the job is bound; contains the end of the wait, in milliseconds.
    Binding(u64),
}

/// A job that has not ended.
#[derive(Debug)]
pub struct OpenJob {
    /// The job's record in the store.
    pub record: JobRecord,
    /// The job with its plan.
    pub planned: Arc<PlannedJob>,
    /// The user and the priority.
    pub(super) key: QueueKey,
    /// The tiles in the order of the plan.
    pub tiles: Vec<Tile>,
    /// The tiles that depend on tile `t`: `dependents[first[t]..first[t + 1]]`.
    dependents: Vec<u32>,
    first: Vec<u32>,
    /// The open tiles without a lease whose needed tiles are done and that are not delayed.
    pub(super) ready: BTreeSet<TileIndex>,
    /// The number of done tiles.
    pub done: u32,
    /// The number of tiles that were set aside.
    pub set_aside: u32,
    /// The number of leases on tiles of the job.
    pub running: u32,
    /// The number of view cells; 0 while unknown.
    pub cells_total: u64,
    /// The number of cells of done tiles.
    pub cells: u64,
    /// The number of samples of done tiles.
    pub samples: u64,
    /// The time that workers spent on done tiles, in milliseconds.
    pub millis: u64,
    /// The number of finished cells of leased tiles, as workers reported.
    pub running_cells: u64,
    /// The number of samples of leased tiles, as workers reported.
    pub running_samples: u64,
    /// The first lease whose outputs count. Earlier leases do not count: tiles were reopened since, and
    /// outputs that were computed from those tiles may be wrong, too.
    pub(super) counts_from: LeaseId,
    /// The leases of this epoch on tiles of the job: the number of the lease, ascending, with its tile and
    /// the signature of its worker.
    pub(super) given: Vec<(u64, TileIndex, Name)>,
    /// The tiles that were done when the scheduler received the job, and that no second worker has confirmed.
    pub(super) unchecked: Vec<(TileIndex, Digest)>,
    /// The done tiles that must be checked.
    pub(super) spots: BTreeMap<TileIndex, SpotCheck>,
    pub(super) parked: Option<Parked>,
    /// The number of timings that found no usable backend.
    pub(super) timing_faults: u32,
    /// True while the store executes a command about the job.
    pub(super) pending: bool,
    /// True while workers may hold leases of an earlier epoch, so that no tile is leased.
    pub(super) grace: bool,
    /// True while the result is being assembled.
    pub(super) assembling: bool,
    /// The time of the next attempt to assemble the result after the disk was full, in milliseconds.
    pub(super) no_space_until: Option<u64>,
    pub(super) pace: ProgressRate,
    /// The list that contains the job, and the number of ready tiles that this list counts for the job.
    pub(super) listed: Option<(List, usize)>,
}

impl OpenJob {
    /// Creates the open job from a record of the store and its plan.
    ///
    /// # Errors
    /// The reason, if this version of the program computes another key or another number of tiles for the
    /// job.
    pub fn new(
        record: JobRecord,
        planned: Arc<PlannedJob>,
        tiles: Vec<TileRecord>,
    ) -> Result<Self, String> {
        if record.key != owned_key(planned.key(), &record.owner) {
            return Err(
                "another version of this program began the job; submit the job again".to_owned(),
            );
        }
        if planned.plan().tiles.len() != tiles.len() {
            return Err(format!(
                "the job was planned with {} tiles, and this program plans {}; submit the job again",
                tiles.len(),
                planned.plan().tiles.len()
            ));
        }
        Ok(Self::with(record, planned, tiles))
    }

    /// Delays the leasing of tiles after a restart, because an earlier epoch may have leased them.
    pub fn after_restart(mut self) -> Self {
        self.grace = true;
        self
    }

    /// Creates the open job with this planned job and these recorded tile states, without comparing the plan
    /// with the record.
    pub fn with(record: JobRecord, planned: Arc<PlannedJob>, tiles: Vec<TileRecord>) -> Self {
        let needs = planned.plan().tiles.iter().map(|t| &t.needs);
        let mut first = vec![0u32; tiles.len() + 1];
        for n in needs.clone().flatten() {
            first[*n as usize + 1] += 1;
        }
        (1..first.len()).for_each(|i| first[i] += first[i - 1]);
        let mut next = first.clone();
        let mut dependents = vec![0; first.last().copied().unwrap_or(0) as usize];
        for (tile, needs) in (0u32..).zip(needs) {
            for n in needs {
                dependents[next[*n as usize] as usize] = tile;
                next[*n as usize] += 1;
            }
        }
        let cells_total = cells_total(&planned);
        let key = queue_key(&record);
        let mut job = Self {
            record,
            key,
            cells_total,
            planned,
            tiles: Vec::with_capacity(tiles.len()),
            dependents,
            first,
            ready: BTreeSet::new(),
            done: 0,
            set_aside: 0,
            running: 0,
            cells: 0,
            samples: 0,
            millis: 0,
            running_cells: 0,
            running_samples: 0,
            counts_from: LeaseId {
                epoch: Epoch(0),
                number: 0,
            },
            given: Vec::new(),
            unchecked: Vec::new(),
            spots: BTreeMap::new(),
            parked: None,
            timing_faults: 0,
            pending: false,
            grace: false,
            assembling: false,
            no_space_until: None,
            pace: ProgressRate::default(),
            listed: None,
        };
        for tile in tiles {
            let (mut contributors, mut author) = (BTreeSet::new(), Name::default());
            let output = match tile.state {
                TileState::Open => Output::Open,
                TileState::Done { digest, stats, .. } => {
                    job.done += 1;
                    job.add(&stats);
                    contributors.extend(stats.helpers.iter().map(|name| name.as_str().into()));
                    author = stats.worker.as_str().into();
                    if tile.check.is_none() {
                        job.unchecked.push((tile.tile, digest));
                    }
                    Output::Done(digest)
                }
                TileState::SetAside { digest, .. } => {
                    job.set_aside += 1;
                    Output::SetAside(digest)
                }
            };
            let (attempts, faults, judged) = (0, 0, false);
            let (leases, deaths) = ([None; 2], Vec::new());
            let (missing, not_before) = (0, None);
            let tile = Tile {
                output,
                leases,
                missing,
                attempts,
                deaths,
                faults,
                not_before,
                judged,
                contributors,
                author,
            };
            job.tiles.push(tile);
        }
        for at in 0..job.tiles.len() {
            let done = |n: &&u32| !matches!(job.tiles[**n as usize].output, Output::Done(_));
            let needs = &job.planned.plan().tiles[at].needs;
            let missing = needs.iter().filter(done).count();
            job.tiles[at].missing = missing as u32;
        }
        job.ready = job.indices().filter(|t| job.is_ready(*t)).collect();
        job
    }

    /// Returns the job's position in lists that do not depend on users.
    pub(super) fn place(&self) -> QueuePosition {
        (self.key.priority, self.record.id)
    }

    /// Returns the indices of all tiles.
    pub fn indices(&self) -> impl Iterator<Item = TileIndex> + use<> {
        (0..self.tiles.len() as u32).map(TileIndex)
    }

    fn add(&mut self, stats: &TileStats) {
        self.cells = self.cells.saturating_add(stats.cells);
        self.samples = self.samples.saturating_add(stats.samples);
        self.millis = self.millis.saturating_add(stats.millis);
    }

    /// Returns the number of tiles that are neither done nor set aside.
    pub fn open(&self) -> u32 {
        self.tiles.len() as u32 - self.done - self.set_aside
    }

    /// Returns the finished amount and the total, in cells. If the number of cells is unknown, the unit is
    /// tiles.
    fn done_of(&self) -> (u64, u64) {
        match self.cells_total {
            0 => (
                u64::from(self.done + self.set_aside),
                self.tiles.len() as u64,
            ),
            total => (
                self.cells.saturating_add(self.running_cells).min(total),
                total,
            ),
        }
    }

    /// Records the current progress of the job.
    pub(super) fn mark_pace(&mut self, now: Now) {
        let (done, _) = self.done_of();
        self.pace.mark(now.ms, done);
    }

    /// Returns the milliseconds until the job is done, at the rate of the last minutes. Returns `None` if
    /// unknown.
    pub fn left(&self, now: Now) -> Option<u64> {
        if self.record.state.phase() != JobPhase::Running {
            return None;
        }
        let (done, all) = self.done_of();
        let left = self.pace.left(now.ms, done, all - done)?;
        let spent = now.unix_ms.saturating_sub(self.record.submitted_at_ms);
        Some(match self.planned.spec().time_budget() {
            None => left,
            Some(budget) => left.min(budget.get().saturating_sub(spent)),
        })
    }

    /// Returns true if the job is queued or running.
    pub fn runs(&self) -> bool {
        matches!(
            self.record.state.phase(),
            JobPhase::Queued | JobPhase::Running
        )
    }

    /// Returns the signature of the worker that got the lease with this number in this epoch, or `None` if no
    /// such lease on the tile was given.
    pub(super) fn given_to(&self, number: u64, tile: TileIndex) -> Option<Name> {
        let at = self
            .given
            .binary_search_by_key(&number, |(number, ..)| *number)
            .ok()?;
        let (_, given, name) = &self.given[at];
        (*given == tile).then(|| Name::clone(name))
    }

    /// Returns true if the state of the tile permits a lease.
    pub(super) fn is_ready(&self, tile: TileIndex) -> bool {
        self.tiles[tile.at()].can_be_leased()
    }

    /// Adds a tile to the ready tiles if it can be leased; otherwise removes it from them.
    pub(super) fn update_ready(&mut self, tile: TileIndex) {
        if self.is_ready(tile) {
            self.ready.insert(tile);
        } else {
            self.ready.remove(&tile);
        }
    }

    /// Records the result of a tile. Returns true if the tile was not done before.
    pub(super) fn complete(&mut self, tile: TileIndex, digest: Digest, stats: &TileStats) -> bool {
        match self.tiles[tile.at()].output {
            Output::Done(_) => return false,
            Output::SetAside(_) => self.set_aside -= 1,
            Output::Open => {}
        }
        self.done += 1;
        self.add(stats);
        self.tiles[tile.at()].output = Output::Done(digest);
        self.tiles[tile.at()].not_before = None;
        self.update_ready(tile);
        for at in self.first[tile.at()]..self.first[tile.at() + 1] {
            let dependent = TileIndex(self.dependents[at as usize]);
            self.tiles[dependent.at()].missing -= 1;
            self.update_ready(dependent);
        }
        true
    }

    /// Records the placeholder of an open tile.
    pub(super) fn give_up(&mut self, tile: TileIndex, digest: Digest) {
        let t = &mut self.tiles[tile.at()];
        t.judged = false;
        if t.output == Output::Open {
            t.output = Output::SetAside(digest);
            self.set_aside += 1;
        }
        self.update_ready(tile);
    }

    /// Returns the time limit in milliseconds for a tile granted now, or `None` without a time budget.
    ///
    /// The limit is nine tenths of the remaining time, divided by the number of open tiles and multiplied by
    /// the number of workers that share them. The limit is at least the budget divided by eight times the
    /// number of tiles, even after the budget has passed.
    pub(super) fn millis_for_a_tile(&self, workers: u64, now: Now) -> Option<u64> {
        let budget = self.planned.spec().time_budget()?.get();
        let open = u64::from(self.open().max(1));
        let spent = now.unix_ms.saturating_sub(self.record.submitted_at_ms);
        // A tenth of the time is reserved for assembling the result.
        let share =
            (budget.saturating_sub(spent) / 10 * 9).saturating_mul(workers.clamp(1, open)) / open;
        Some(share.max(budget / (8 * self.tiles.len().max(1) as u64)))
    }

    /// Returns the digests of the packs that `tile` needs, in the plan's order.
    pub(super) fn packs(&self, tile: TileIndex) -> Vec<Option<Digest>> {
        let needs = &self.planned.plan().tiles[tile.at()].needs;
        needs
            .iter()
            .map(|n| self.tiles[*n as usize].output.digest())
            .collect()
    }

    /// Returns these tiles and all tiles that were computed from them.
    pub fn with_dependents(&self, tiles: BTreeSet<TileIndex>) -> BTreeSet<TileIndex> {
        let mut all = tiles;
        let mut next: Vec<TileIndex> = all.iter().copied().collect();
        while let Some(t) = next.pop() {
            for at in self.first[t.at()]..self.first[t.at() + 1] {
                let dependent = TileIndex(self.dependents[at as usize]);
                if all.insert(dependent) {
                    next.push(dependent);
                }
            }
        }
        all
    }

    /// Returns `tile` and all open tiles that depend on it, dependent tiles first.
    pub(super) fn lost_with(&self, tile: TileIndex) -> Vec<TileIndex> {
        let mut lost = BTreeSet::from([tile]);
        let mut next = vec![tile];
        while let Some(t) = next.pop() {
            for at in self.first[t.at()]..self.first[t.at() + 1] {
                let dependent = TileIndex(self.dependents[at as usize]);
                if lost.insert(dependent) {
                    next.push(dependent);
                }
            }
        }
        lost.into_iter()
            .rev()
            .filter(|t| self.tiles[t.at()].output == Output::Open)
            .collect()
    }
}

/// Returns the user and the priority of a record.
pub(super) fn queue_key(record: &JobRecord) -> QueueKey {
    QueueKey {
        user: record.user.as_str().into(),
        priority: Reverse(record.priority),
    }
}

/// Counts the view cells or receivers of a job. Returns 0 for an adaptive division, whose cells are unknown
/// before they are sampled.
pub fn cells_total(job: &PlannedJob) -> u64 {
    if let Task::Visibility(task) = &job.spec().task
        && let Division::Adaptive { .. } = task.division()
    {
        return 0;
    }
    let leaves = job.plan().tiles.iter().filter(|t| t.kind == TileKind::Leaf);
    leaves.map(|t| t.cells).sum()
}
