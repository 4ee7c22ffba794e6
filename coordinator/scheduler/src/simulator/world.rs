//! The simulated world: time, streams, the store, the coordinator around its state machine, and the checks.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_numbers::random::SplitMix64;
use sightline_records::JobPhase;
use sightline_records::ids::{JobId, Lease, LeaseId, TileIndex};
use sightline_store::MemoryStore;
use sightline_viewcells::Plan;

use super::parts::{
    CoordinatorMessage, Ground, SimulatedEvent, SimulatedWorker, StreamEnds, WorkerMessage, spec,
};
use crate::{Effect, Event, Now, OpenJob, Output, Scheduler, WorkerCommand};

pub(super) const TTL: u64 = 10_000;
/// The time after a restart in which tiles that a worker may hold are not leased, in milliseconds.
const GRACE: u64 = 2500;
/// The time at which faults stop, in milliseconds.
pub(super) const FAULTS: u64 = 120_000;

/// The state of a simulated cluster.
pub(super) struct World {
    pub(super) random: SplitMix64,
    /// The random numbers only of crews, users and priorities, so that schedules without crews do not change.
    crews: SplitMix64,
    pub(super) now: u64,
    pub(super) unix_ms: u64,
    next: u64,
    pub(super) queue: BTreeMap<(u64, u64), SimulatedEvent>,
    pub(super) ground: Ground,
    /// The share of tiles that are computed again, from 0 to 1.
    pub(super) spot_check: f64,
    pub(super) scheduler: Option<Scheduler>,
    /// The number of lives of the coordinator.
    pub(super) life: u64,
    pub(super) epoch: u64,
    pub(super) stalled_until: u64,
    pub(super) disk_full: bool,
    pub(super) streams: Vec<StreamEnds>,
    pub(super) workers: Vec<SimulatedWorker>,
    pub(super) plans: BTreeMap<JobId, Plan>,
    poison: BTreeSet<(JobId, TileIndex)>,
    /// The tiles whose workers die.
    pub(super) lethal: BTreeSet<(JobId, TileIndex)>,
    /// The acknowledged outputs.
    pub(super) acknowledged: BTreeMap<(JobId, TileIndex), Vec<u8>>,
    pub(super) leased: BTreeSet<LeaseId>,
    /// The jobs that ran before the last start of the coordinator.
    pub(super) ran_before: BTreeSet<JobId>,
    pub(super) started: u64,
    /// The tiles that workers have claimed since the last start of the coordinator.
    pub(super) claimed: BTreeSet<(JobId, TileIndex)>,
    pub(super) tile_ms: u64,
    pub(super) slowest_link: u64,
}

impl World {
    /// Creates a world without workers and jobs.
    pub(super) fn new(random: SplitMix64, tile_ms: u64, slowest_link: u64) -> Self {
        Self {
            crews: SplitMix64::named(&[random.clone().bits(), 1]),
            random,
            now: 0,
            unix_ms: 1_000_000_000,
            next: 0,
            queue: BTreeMap::new(),
            ground: Ground::Memory(MemoryStore::new()),
            spot_check: 0.0,
            scheduler: None,
            life: 0,
            epoch: 0,
            stalled_until: 0,
            disk_full: false,
            streams: Vec::new(),
            workers: Vec::new(),
            plans: BTreeMap::new(),
            poison: BTreeSet::new(),
            lethal: BTreeSet::new(),
            acknowledged: BTreeMap::new(),
            leased: BTreeSet::new(),
            ran_before: BTreeSet::new(),
            started: 0,
            claimed: BTreeSet::new(),
            tile_ms,
            slowest_link,
        }
    }

    pub(super) fn below(&mut self, n: u64) -> u64 {
        self.random.bits() % n.max(1)
    }

    pub(super) fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }

    pub(super) fn delay(&mut self) -> u64 {
        1 + self.below(self.slowest_link)
    }

    pub(super) fn faults_on(&self) -> bool {
        self.now < FAULTS
    }

    pub(super) fn after(&mut self, wait: u64, event: SimulatedEvent) {
        self.at(self.now + wait, event);
    }

    pub(super) fn at(&mut self, at: u64, event: SimulatedEvent) {
        self.next += 1;
        self.queue.insert((at, self.next), event);
    }

    /// Schedules an event of a crew within `most` milliseconds, unless the coordinator ends before.
    pub(super) fn crew(&mut self, most: u64, event: Event) {
        let wait = 1 + self.crews.bits() % most;
        self.after(wait, SimulatedEvent::Crew(self.life, Box::new(event)));
    }

    /// Returns the user and the priority of a new job.
    pub(super) fn submitter(&mut self) -> (&'static str, i32) {
        let bits = self.crews.bits();
        (
            ["one", "two"][(bits % 2) as usize],
            [0, 0, 1][(bits / 2 % 3) as usize],
        )
    }

    /// Sometimes changes the priority of an open job, as a client does.
    pub(super) fn prioritize(&mut self) -> Result<(), String> {
        let bits = self.crews.bits();
        let (open, priority) = (self.open_jobs(), (bits / 8 % 3) as i32 - 1);
        if open.is_empty() || !bits.is_multiple_of(8) {
            return Ok(());
        }
        let (id, _) = open[(bits / 24) as usize % open.len()];
        match self.store().prioritize_job(id, priority) {
            Ok(record) => self.tell(Event::JobChanged(Box::new(record))),
            Err(e) => self.refused(&e).map(drop),
        }
    }

    pub(super) fn poison(&mut self, job: JobId, tile: TileIndex) {
        self.poison.insert((job, tile));
    }

    pub(super) fn poisoned(&self, lease: &Lease) -> bool {
        self.poison.contains(&(lease.job, lease.tile))
    }

    pub(super) fn is_lethal(&self, lease: &Lease) -> bool {
        self.lethal.contains(&(lease.job, lease.tile))
    }

    pub(super) fn open_jobs(&self) -> Vec<(JobId, JobPhase)> {
        let jobs = self.store().jobs().unwrap();
        let all = jobs.iter().map(|j| (j.id, j.state.phase()));
        all.filter(|(_, phase)| !phase.ended()).collect()
    }

    pub(super) fn open_stream(&mut self, worker: usize) -> usize {
        let (life, now) = (self.life, self.now);
        let stream = StreamEnds {
            worker,
            life,
            number: None,
            closed: false,
            up_at: now,
            down_at: now,
        };
        self.streams.push(stream);
        self.streams.len() - 1
    }

    pub(super) fn send_up(&mut self, stream: usize, up: WorkerMessage) {
        let at = (self.now + self.delay()).max(self.streams[stream].up_at);
        self.streams[stream].up_at = at;
        self.at(at, SimulatedEvent::Up(stream, up));
    }

    pub(super) fn send_down(&mut self, stream: usize, down: CoordinatorMessage) {
        let at = (self.now + self.delay()).max(self.streams[stream].down_at);
        self.streams[stream].down_at = at;
        self.at(at, SimulatedEvent::Down(stream, down));
    }

    /// Ends a worker's stream in order: all sent messages arrive first.
    pub(super) fn close_up(&mut self, stream: usize) {
        let at = self.streams[stream].up_at;
        self.at(at.max(self.now), SimulatedEvent::UpBroken(stream));
    }

    /// Breaks a stream: messages in transit are lost, and both ends notice the break after a while.
    pub(super) fn break_stream(&mut self, stream: usize, longest: u64) {
        self.streams[stream].closed = true;
        let (up, down) = (self.below(longest), self.below(longest));
        self.after(up, SimulatedEvent::UpBroken(stream));
        self.after(down, SimulatedEvent::DownBroken(stream));
    }

    /// Returns a job in its state in the store.
    pub(super) fn job(&self, id: JobId) -> OpenJob {
        let planned = PlannedJob::with_plan(spec(), self.plans[&id].clone());
        OpenJob::with(
            self.store().job(id).unwrap().unwrap(),
            Arc::new(planned),
            self.store().tiles(id).unwrap(),
        )
    }

    /// Passes an event to the scheduler, checks the scheduler, and executes its effects.
    pub(super) fn tell(&mut self, event: Event) -> Result<(), String> {
        let now = Now {
            ms: self.now,
            unix_ms: self.unix_ms,
        };
        let tick = matches!(event, Event::Tick);
        let Some(scheduler) = &mut self.scheduler else {
            return Ok(());
        };
        let effects = scheduler.step(event, now);
        scheduler.check()?;
        if tick {
            scheduler.check_expiries(now)?;
        }
        effects
            .into_iter()
            .try_for_each(|effect| self.carry(effect))
    }

    pub(super) fn carry(&mut self, effect: Effect) -> Result<(), String> {
        match effect {
            Effect::Tell(worker, command) => {
                let stream = self
                    .streams
                    .iter()
                    .rposition(|s| s.number == Some(worker) && s.life == self.life);
                if let WorkerCommand::Grant(grant) = &command {
                    self.may_lease(&grant.lease)?;
                }
                let Some(stream) = stream else {
                    return Err("a command to a worker without a stream".to_owned());
                };
                match command {
                    WorkerCommand::Grant(grant) => {
                        self.send_down(stream, CoordinatorMessage::Grant(grant.lease))
                    }
                    WorkerCommand::Revoke(lease) => {
                        self.send_down(stream, CoordinatorMessage::Revoke(lease))
                    }
                    WorkerCommand::Help(help) => {
                        let back = Event::Helped(worker, help.lease);
                        self.crew(3000, back);
                    }
                    WorkerCommand::Time { .. } => {}
                }
            }
            Effect::Run(command) => {
                let wait = self.below(20);
                self.after(wait, SimulatedEvent::Run(self.life, Box::new(command)));
            }
            Effect::Assemble(job) => {
                let wait = self.below(500);
                self.after(wait, SimulatedEvent::Assemble(self.life, job));
            }
            Effect::Changed(_) | Effect::Note(_) | Effect::Joined(_) | Effect::Left(_) => {}
        }
        Ok(())
    }

    fn may_lease(&mut self, lease: &Lease) -> Result<(), String> {
        if !self.leased.insert(lease.id) {
            return Err(format!("{lease:?} is given twice"));
        }
        // A tile that its worker has claimed may move to another worker.
        let claimed = self.claimed.contains(&(lease.job, lease.tile));
        // The check of a done tile does not affect the worker that made the tile.
        let job = self
            .scheduler
            .as_ref()
            .and_then(|scheduler| scheduler.job(lease.job));
        let is_open = job.is_some_and(|job| job.tiles[lease.tile.at()].output == Output::Open);
        if is_open
            && self.ran_before.contains(&lease.job)
            && !claimed
            && self.now < self.started + GRACE
        {
            return Err(format!(
                "{lease:?} is given while an earlier epoch's worker may hold the tile"
            ));
        }
        Ok(())
    }
}
