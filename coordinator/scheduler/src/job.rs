//! A job that has not ended: its tiles, which of them are ready, and its totals.
//!
//! The job has totals in addition to its tiles, and changes both together; `invariants.rs` counts them again.
//! Nothing here knows of workers.

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

/// What is there of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Nothing.
    Open,
    /// Its result.
    Done(Digest),
    /// The stand-in for a tile that was given up.
    SetAside(Digest),
}

impl Output {
    /// The name of its blob.
    pub fn digest(&self) -> Option<Digest> {
        match self {
            Self::Done(d) | Self::SetAside(d) => Some(*d),
            Self::Open => None,
        }
    }
}

/// A tile as the scheduler sees it.
#[derive(Clone, Debug)]
pub struct Tile {
    pub output: Output,
    /// Its leases: at most two, the second one for a tile that takes long.
    pub(super) leases: [Option<LeaseId>; 2],
    /// Needed tiles that are not done.
    pub(super) missing: u32,
    /// Failures of the tile since the coordinator started, on any worker, without deaths.
    pub(super) attempts: u32,
    /// The instances of the workers that died with the tile since the coordinator started.
    pub(super) deaths: Vec<u64>,
    /// Faults of machines and networks since the coordinator started.
    pub(super) faults: u32,
    /// After such a fault the tile waits until then; longer each time.
    pub(super) not_before: Option<u64>,
    /// Whether a command about its failure is with the store.
    pub(super) judged: bool,
    /// Who has helped with it or led a crew for it: what they have computed may be in its output.
    pub(super) contributors: BTreeSet<Name>,
    /// Who has sent its output; empty when nobody has, or it is not known.
    pub(super) author: Name,
}

impl Tile {
    /// Whether it can be leased, by its own state.
    pub(super) fn can_be_leased(&self) -> bool {
        self.output == Output::Open
            && self.leases == [None; 2]
            && self.missing == 0
            && self.not_before.is_none()
            && !self.judged
    }
}

/// Where a job without leases to give waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parked {
    /// A worker times its backends.
    Timing(WorkerId),
    /// More workers may join before it is bound, until this time.
    Binding(u64),
}

/// A job that has not ended.
#[derive(Debug)]
pub struct Job {
    /// The record of the store.
    pub record: JobRecord,
    /// The job with its plan.
    pub work: Arc<PlannedJob>,
    /// The owner and the priority.
    pub(super) whom: QueueKey,
    /// The tiles in the order of the plan.
    pub tiles: Vec<Tile>,
    /// The tiles that need a tile: `dependents[first[t]..first[t + 1]]`.
    dependents: Vec<u32>,
    first: Vec<u32>,
    /// Open tiles without a lease whose needed tiles are done and that wait for nothing.
    pub(super) ready: BTreeSet<TileIndex>,
    /// The number of done tiles.
    pub done: u32,
    /// The number of tiles that are set aside.
    pub set_aside: u32,
    /// The number of leases.
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
    /// Leases that were given before this one do not count: tiles were opened again since, and what was
    /// computed from them is as wrong as they were.
    pub(super) counts_from: LeaseId,
    /// Numbers of this epoch's leases, ascending, their tiles and workers.
    pub(super) given: Vec<(u64, TileIndex, Name)>,
    /// Tiles that were done when the job was taken up and that nobody has computed again.
    pub(super) unchecked: Vec<(TileIndex, Digest)>,
    /// Done tiles that are to be checked.
    pub(super) spots: BTreeMap<TileIndex, SpotCheck>,
    pub(super) parked: Option<Parked>,
    /// How often timing gave no usable backend.
    pub(super) timing_faults: u32,
    /// Whether a command about the job is with the store.
    pub(super) pending: bool,
    /// While leases of an earlier epoch may be out, no tile is leased.
    pub(super) grace: bool,
    /// Whether somebody assembles the result.
    pub(super) assembling: bool,
    /// When to assemble the result again, after the disk was full.
    pub(super) no_space_until: Option<u64>,
    pub(super) pace: ProgressRate,
    /// The list that the job is in, and its ready tiles there.
    pub(super) listed: Option<(List, usize)>,
}

impl Job {
    /// Makes the job of a store's record from its plan.
    ///
    /// # Errors
    /// The reason, when another version of the program made the specification or the plan.
    pub fn new(
        record: JobRecord,
        work: Arc<PlannedJob>,
        tiles: Vec<TileRecord>,
    ) -> Result<Self, String> {
        if record.key != owned_key(work.key(), &record.owner) {
            return Err("another version of this program began it; submit it again".to_owned());
        }
        if work.plan().tiles.len() != tiles.len() {
            return Err(format!(
                "it was planned with {} tiles and would now have {}; submit it again",
                tiles.len(),
                work.plan().tiles.len()
            ));
        }
        Ok(Self::with(record, work, tiles))
    }

    /// The job when an earlier epoch may have leased its tiles: they are leased again only after a while.
    pub fn after_restart(mut self) -> Self {
        self.grace = true;
        self
    }

    /// The job with this work and recorded states.
    pub fn with(record: JobRecord, work: Arc<PlannedJob>, tiles: Vec<TileRecord>) -> Self {
        let needs = work.plan().tiles.iter().map(|t| &t.needs);
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
        let cells_total = cells_total(&work);
        let whom = whom(&record);
        let mut job = Self {
            record,
            whom,
            cells_total,
            work,
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
            job.tiles[at].missing =
                job.work.plan().tiles[at].needs.iter().filter(done).count() as u32;
        }
        job.ready = job.indices().filter(|t| job.is_ready(*t)).collect();
        job
    }

    /// Its place in lists that know no users.
    pub(super) fn place(&self) -> QueuePosition {
        (self.whom.priority, self.record.id)
    }

    /// All tiles.
    pub fn indices(&self) -> impl Iterator<Item = TileIndex> + use<> {
        (0..self.tiles.len() as u32).map(TileIndex)
    }

    fn add(&mut self, stats: &TileStats) {
        self.cells = self.cells.saturating_add(stats.cells);
        self.samples = self.samples.saturating_add(stats.samples);
        self.millis = self.millis.saturating_add(stats.millis);
    }

    /// Tiles neither done nor set aside.
    pub fn open(&self) -> u32 {
        self.tiles.len() as u32 - self.done - self.set_aside
    }

    /// What is done and what there is, in cells, or in tiles while the number of cells is not known.
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

    /// Notes how far the job is.
    pub(super) fn mark_pace(&mut self, now: Now) {
        let (done, _) = self.done_of();
        self.pace.mark(now.ms, done);
    }

    /// Milliseconds until the job is done, at the pace of the last minutes; `None` while that is not known.
    pub fn left(&self, now: Now) -> Option<u64> {
        if self.record.state.phase() != JobPhase::Running {
            return None;
        }
        let (done, all) = self.done_of();
        let left = self.pace.left(now.ms, done, all - done)?;
        let spent = now.unix_ms.saturating_sub(self.record.submitted_at_ms);
        Some(match self.work.spec().time_budget() {
            None => left,
            Some(budget) => left.min(budget.get().saturating_sub(spent)),
        })
    }

    /// Whether the job is queued or running.
    pub fn runs(&self) -> bool {
        matches!(
            self.record.state.phase(),
            JobPhase::Queued | JobPhase::Running
        )
    }

    /// To whom a lease of this epoch was given on a tile, if it was.
    pub(super) fn given_to(&self, number: u64, tile: TileIndex) -> Option<Name> {
        let at = self
            .given
            .binary_search_by_key(&number, |(number, ..)| *number)
            .ok()?;
        let (_, of, name) = &self.given[at];
        (*of == tile).then(|| Name::clone(name))
    }

    /// Whether a tile can be leased, by its own state.
    pub(super) fn is_ready(&self, tile: TileIndex) -> bool {
        self.tiles[tile.at()].can_be_leased()
    }

    /// Puts a tile among the ready ones, or takes it out.
    pub(super) fn update_ready(&mut self, tile: TileIndex) {
        if self.is_ready(tile) {
            self.ready.insert(tile);
        } else {
            self.ready.remove(&tile);
        }
    }

    /// Notes the result of a tile; returns whether that is news.
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

    /// Notes the stand-in of an open tile.
    pub(super) fn give_up(&mut self, tile: TileIndex, digest: Digest) {
        let t = &mut self.tiles[tile.at()];
        t.judged = false;
        if t.output == Output::Open {
            t.output = Output::SetAside(digest);
            self.set_aside += 1;
        }
        self.update_ready(tile);
    }

    /// Milliseconds for a tile granted now, when the job has a time budget: the remaining time, divided by
    /// the open tiles and multiplied by the workers that share them. Never zero, however late it is.
    pub(super) fn millis_for_a_tile(&self, workers: u64, now: Now) -> Option<u64> {
        let budget = self.work.spec().time_budget()?.get();
        let open = u64::from(self.open().max(1));
        let spent = now.unix_ms.saturating_sub(self.record.submitted_at_ms);
        // A tenth is kept for assembling the result.
        let share =
            (budget.saturating_sub(spent) / 10 * 9).saturating_mul(workers.clamp(1, open)) / open;
        Some(share.max(budget / (8 * self.tiles.len().max(1) as u64)))
    }

    /// Digests of the packs that `tile` needs, in the plan's order.
    pub(super) fn packs(&self, tile: TileIndex) -> Vec<Option<Digest>> {
        let needs = &self.work.plan().tiles[tile.at()].needs;
        needs
            .iter()
            .map(|n| self.tiles[*n as usize].output.digest())
            .collect()
    }

    /// These tiles and all that were computed from them.
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

    /// `tile` and all open tiles that cannot be computed without it, those that need others first.
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

/// The user and priority of a record.
pub(super) fn whom(record: &JobRecord) -> QueueKey {
    QueueKey {
        user: record.user.as_str().into(),
        priority: Reverse(record.priority),
    }
}

/// Counts the view cells or receivers of a job; 0 for an adaptive division, whose cells are not known before
/// it is sampled.
pub fn cells_total(job: &PlannedJob) -> u64 {
    if let Task::Visibility(task) = &job.spec().task
        && let Division::Adaptive { .. } = task.division()
    {
        return 0;
    }
    let leaves = job.plan().tiles.iter().filter(|t| t.kind == TileKind::Leaf);
    leaves.map(|t| t.cells).sum()
}
