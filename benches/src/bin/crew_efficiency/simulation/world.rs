//! The state of a simulated cluster, its clock, and its result.

use std::collections::{BTreeMap, BTreeSet};

use super::network::{FRAME, Links, Network};
use super::parts::{For, PURPOSES, Role, Task, Tile, ToCoordinator, ToWorker, Worker};
use super::processors::Processors;
use crate::trace::{BlockTrace, PhaseTrace, SceneTrace};

/// A job: what it takes, tile by tile.
pub struct Job<'a> {
    /// The scene.
    pub scene: &'a SceneTrace,
    /// The tiles, in the plan's order.
    pub tiles: Vec<&'a BlockTrace>,
}

/// A cluster.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Workers with one thread each.
    pub workers: usize,
    /// Cores that they share; `None` for one each.
    pub cores: Option<u64>,
    /// Helpers that a crew is sent at most.
    pub most_helpers: usize,
    /// The network.
    pub network: Network,
    /// Whether the coordinator and the workers have the scene, and the workers its facts.
    pub is_warm: bool,
}

/// The result of a simulation.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Nanoseconds from submission to the last output.
    pub sampled: u64,
    /// The same until the result is assembled.
    pub wall: u64,
    /// What the workers' cores did, by [`For`].
    pub spent: [u64; PURPOSES],
    /// Time on items whose answers were there already, or came too late.
    pub repeated: u64,
    /// Bytes into and out of the coordinator.
    pub bytes: u64,
}

enum Event {
    At(usize, usize, ToCoordinator),
    Hears(usize, ToWorker, Option<usize>),
}

/// A simulated cluster.
pub struct World<'a> {
    pub(super) now: u64,
    job: &'a Job<'a>,
    events: BTreeMap<(u64, u64), Event>,
    next: u64,
    processors: Processors,
    links: Links,
    pub(super) workers: Vec<Worker>,
    pub(super) tiles: Vec<Tile>,
    /// Workers without a tile, as the coordinator knows them.
    pub(super) idle: BTreeSet<usize>,
    /// Crews, by the number of workers that were sent to them.
    pub(super) open: BTreeSet<(usize, usize)>,
    pub(super) most_helpers: usize,
    /// Tiles that were granted.
    pub(super) granted: usize,
    /// Tiles without output.
    pub(super) left: usize,
    spent: [u64; PURPOSES],
}

/// Simulates a job.
pub fn run(job: &Job<'_>, settings: Settings) -> Outcome {
    let worker = || Worker {
        has_scene: settings.is_warm,
        has_facts: settings.is_warm,
        ..Worker::default()
    };
    let mut world = World {
        now: 0,
        job,
        events: BTreeMap::new(),
        next: 0,
        processors: Processors::new(settings.cores),
        links: Links::new(settings.network, settings.workers),
        workers: (0..settings.workers).map(|_| worker()).collect(),
        tiles: job.tiles.iter().map(|_| Tile::default()).collect(),
        idle: (0..settings.workers).collect(),
        open: BTreeSet::new(),
        most_helpers: settings.most_helpers,
        granted: 0,
        left: job.tiles.len(),
        spent: [0; PURPOSES],
    };
    if !settings.is_warm {
        // The client reads and uploads the scene, and the coordinator checks it.
        world.now = job.scene.load + world.links.upload(job.scene.bytes) + job.scene.parse;
        world.processors.advance(world.now);
    }
    world.grant();
    while world.left > 0 && world.happen() {}
    let items: u64 = job
        .tiles
        .iter()
        .flat_map(|t| &t.phases)
        .map(PhaseTrace::work)
        .sum();
    Outcome {
        sampled: world.now,
        wall: world.now + job.tiles.iter().map(|t| t.assemble).sum::<u64>(),
        spent: world.spent,
        repeated: world.spent[For::Items as usize].saturating_sub(items),
        bytes: world.links.bytes,
    }
}

impl World<'_> {
    /// The next thing happens; `false` when nothing is left.
    fn happen(&mut self) -> bool {
        let event = self.events.first_key_value().map(|((at, _), _)| *at);
        let Some(now) = event.into_iter().chain(self.processors.next()).min() else {
            return false;
        };
        self.processors.advance(now);
        self.now = now;
        if event == Some(now) {
            match self.events.pop_first() {
                Some((_, Event::At(w, tile, message))) => self.coordinate(w, tile, message),
                // What concerns an earlier tile of the worker comes too late.
                Some((_, Event::Hears(w, message, about)))
                    if about.is_none_or(|tile| tile == self.workers[w].tile) =>
                {
                    self.hears(w, message);
                }
                _ => {}
            }
        } else if let Some(w) = self.processors.end() {
            let Some(task) = self.workers[w].task.take() else {
                return true;
            };
            match self.workers[w].role {
                Role::Leads(_) => self.leader_did(w, task),
                Role::Helps(_) => self.helper_did(w, task),
                Role::Idle => {}
            }
        }
        true
    }

    /// The tile of a worker.
    pub(super) fn block(&self, w: usize) -> &BlockTrace {
        self.job.tiles[self.workers[w].tile]
    }

    /// The phase of a worker.
    pub(super) fn phase(&self, w: usize) -> &PhaseTrace {
        &self.block(w).phases[self.workers[w].phase as usize]
    }

    /// A worker begins a task.
    pub(super) fn begin(&mut self, w: usize, task: Task) {
        let work = match &task {
            Task::Parse => self.job.scene.parse,
            Task::Facts => self.job.scene.facts,
            Task::Begin => self.block(w).begin,
            Task::Prepare => self.phase(w).prepare,
            Task::Item(item) => self.phase(w).items[*item as usize].compute,
            Task::AddPiece(items) => self.phase(w).add_finds(items),
            Task::Encode => self.phase(w).encode,
            Task::Take(items) => self.phase(w).take(items),
            Task::AddOutcome => self.phase(w).add,
            Task::Gap => self.phase(w).gap,
            Task::End => self.block(w).end,
        };
        self.spent[task.purpose() as usize] += work;
        self.workers[w].task = Some(task);
        self.processors.begin(w, work);
    }

    fn at(&mut self, time: u64, event: Event) {
        self.events.insert((time, self.next), event);
        self.next += 1;
    }

    /// A worker sends a message.
    pub(super) fn say(&mut self, w: usize, message: ToCoordinator) {
        let tile = self.workers[w].tile;
        let phases = &self.job.tiles[tile].phases;
        let bytes = match &message {
            ToCoordinator::Found(phase, items) => {
                phases[*phase as usize].finds(items) + 3 * items.len() as u64
            }
            ToCoordinator::Take(_, _, items) => 3 * items.len() as u64,
            ToCoordinator::Outcome(phase) => phases[*phase as usize].outcome,
            ToCoordinator::Output => self.job.tiles[tile].output,
            _ => 0,
        };
        let time = self.links.up(self.now, w, FRAME + bytes);
        self.at(time, Event::At(w, tile, message));
    }

    /// The coordinator sends a message about a tile.
    pub(super) fn tell(&mut self, w: usize, tile: usize, message: ToWorker) {
        let phases = &self.job.tiles[tile].phases;
        let (bytes, about) = match &message {
            ToWorker::Grant(_) | ToWorker::Help(_) => (0, None),
            ToWorker::Scene => (self.job.scene.bytes, None),
            ToWorker::Found(phase, items) => (
                phases[*phase as usize].finds(items) + 3 * items.len() as u64,
                Some(tile),
            ),
            ToWorker::Take(_, items) => (3 * items.len() as u64, Some(tile)),
            ToWorker::Outcome(phase) => (phases[*phase as usize].outcome, Some(tile)),
            _ => (0, Some(tile)),
        };
        let time = self.links.down(self.now, w, FRAME + bytes);
        self.at(time, Event::Hears(w, message, about));
    }
}
