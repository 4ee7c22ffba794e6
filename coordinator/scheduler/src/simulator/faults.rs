//! The initial state of a schedule, and its faults and client commands.

use sightline_numbers::random::SplitMix64;
use sightline_records::ids::{JobId, TileIndex};
use sightline_records::{JobPhase, JobState, NewJob, SceneRecord};
use sightline_store::StoreError;
use sightline_store::failing::FailingDisk;
use sightline_viewcells::{Plan, Tile, TileKind};

use super::parts::{Ground, SimulatedEvent, SimulatedWorker, WorkerMessage, spec};
use super::world::World;
use crate::Event;

/// Creates a world with some workers and jobs.
pub(super) fn world(seed: u64) -> World {
    let mut random = SplitMix64::named(&[seed]);
    let tile_ms = [50, 500, 5000, 10_000][(random.bits() % 4) as usize];
    let slowest_link = [5, 50, 500, 3000][(random.bits() % 4) as usize];
    let mut world = World::new(random, tile_ms, slowest_link);
    populate(&mut world, seed);
    world
}

/// Creates a world on a disk that fails, in which done tiles are computed again.
///
/// # Errors
/// The reason why the store cannot be opened.
pub(super) fn world_on_disk(seed: u64) -> Result<World, String> {
    let mut random = SplitMix64::named(&[seed, 11]);
    let tile_ms = [50, 500, 5000][(random.bits() % 3) as usize];
    let slowest_link = [5, 50, 500][(random.bits() % 3) as usize];
    let mut world = World::new(random, tile_ms, slowest_link);
    world.ground = Ground::Disk(Box::new(FailingDisk::new(seed)));
    world.spot_check = [0.1, 0.5, 1.0][world.below(3) as usize];
    world.open_store()?;
    populate(&mut world, seed);
    // The coordinator opens the store again at its start.
    world.close_store();
    Ok(world)
}

/// Adds workers and jobs.
fn populate(world: &mut World, seed: u64) {
    let mut lethal = SplitMix64::named(&[seed, 2]);
    // Each tile needs a checker, and each dispute needs a judge.
    let checked = world.spot_check > 0.0;
    let workers = if checked { 3 } else { 1 } + world.below(if checked { 3 } else { 5 });
    for _ in 0..workers {
        let other = world.one_in(6) && !checked;
        let (slow, broken) = (world.one_in(8), world.one_in(12));
        world.workers.push(SimulatedWorker {
            profile: if other { "cpu/b" } else { "cpu/a" }.to_owned(),
            alive: true,
            life: 0,
            paused_until: 0,
            cut_until: 0,
            stream: None,
            wait: 200,
            held: Default::default(),
            draining: false,
            slowness: if slow { 5 } else { 1 },
            broken,
        });
    }
    let scene = SceneRecord {
        digest: [7; 32],
        bytes: 1,
        triangles: 1,
        objects: 1,
        owners: Default::default(),
    };
    world.store().record_scene(scene).unwrap();
    for job in 0..1 + world.below(3) {
        let tiles = 1 + world.below(10) as u32;
        let (mut key, plan) = ([0; 32], plan(world, tiles));
        let (user, priority) = world.submitter();
        key[0] = job as u8;
        let new = NewJob {
            key,
            request_id: String::new(),
            name: "simulated".to_owned(),
            owner: String::new(),
            user: user.to_owned(),
            priority,
            scene: [7; 32],
            spec: Vec::new(),
            tiles,
            submitted_at_ms: world.unix_ms,
        };
        let id = world.store().submit_job(new).unwrap().id;
        world.plans.insert(id, plan);
        for tile in 0..tiles {
            if world.one_in(25) {
                world.poison(id, TileIndex(tile));
            }
            if lethal.bits().is_multiple_of(40) {
                world.lethal.insert((id, TileIndex(tile)));
            }
        }
    }
}

/// Creates a plan in which every tile may need some of the tiles before it.
fn plan(world: &mut World, tiles: u32) -> Plan {
    let spec = spec();
    let cell = spec
        .visibility()
        .map(|task| task.division().root(task.lattice()))
        .unwrap();
    let mut all = Vec::new();
    let dense = world.below(3);
    for at in 0..tiles {
        let needs = (0..at).filter(|_| dense > 0 && world.one_in(4)).collect();
        all.push(Tile {
            kind: TileKind::Leaf,
            cell,
            depth: 0,
            needs,
            cells: 1,
        });
    }
    Plan {
        tiles: all,
        outline: Vec::new(),
    }
}

impl World {
    /// Executes a fault or a client command, and schedules the next one. The last one repairs everything.
    pub(super) fn fault(&mut self) -> Result<(), String> {
        if !self.faults_on() {
            return self.repair();
        }
        let next = 500 + self.below(15_000);
        self.after(next, SimulatedEvent::Fault);
        let w = self.below(self.workers.len() as u64) as usize;
        let long = 1000 + self.below(40_000);
        match self.below(12) {
            0 => {
                self.kill(w, long);
            }
            1 => self.workers[w].paused_until = self.now + long,
            2 | 3 => {
                // The network between a worker and the coordinator is interrupted for a while.
                self.workers[w].cut_until = self.now + if self.one_in(2) { 500 } else { long };
                if let Some(stream) = self.workers[w].stream {
                    self.break_stream(stream, 25_000);
                }
            }
            4 => {
                if self.scheduler.is_some() {
                    self.stop_coordinator();
                    let wait = if self.one_in(2) { 200 } else { long / 2 };
                    self.after(wait, SimulatedEvent::CoordinatorUp);
                }
            }
            5 => {
                self.fill(true);
                self.after(long, SimulatedEvent::DiskFree);
            }
            6 => {
                self.unix_ms = self
                    .unix_ms
                    .saturating_add(self.below(1 << 30))
                    .saturating_sub(1 << 29)
            }
            7 => self.stalled_until = self.now + long / 2,
            8 => {
                if !self.workers[w].draining && self.workers[w].alive {
                    self.drains(w);
                }
            }
            _ => return self.client(),
        }
        Ok(())
    }

    /// Kills a worker; another process replaces it after `wait` milliseconds. The connection ends at once, or
    /// once the coordinator notices.
    pub(super) fn kill(&mut self, w: usize, wait: u64) {
        self.workers[w].alive = false;
        self.workers[w].life += 1;
        if let Some(stream) = self.workers[w].stream.take() {
            self.break_stream(stream, 30_000);
        }
        self.after(wait, SimulatedEvent::Revive(w, self.workers[w].life));
    }

    /// Drains a worker: it returns the tiles that have not begun, and delivers the others.
    fn drains(&mut self, w: usize) {
        self.workers[w].draining = true;
        if let Some(stream) = self.workers[w].stream {
            self.send_up(stream, WorkerMessage::Drains);
        }
        let waiting: Vec<_> = self.workers[w]
            .held
            .values()
            .filter(|h| !h.runs)
            .map(|h| h.lease.id)
            .collect();
        waiting.into_iter().for_each(|id| self.cancel(w, id));
        if self.workers[w].held.is_empty() {
            self.retire(w);
        }
    }

    fn client(&mut self) -> Result<(), String> {
        let ids: Vec<JobId> = self.plans.keys().copied().collect();
        if ids.is_empty() {
            return Ok(());
        }
        let id = ids[self.below(ids.len() as u64) as usize];
        let what = self.below(6);
        if self.scheduler.is_none() || self.disk_full {
            return Ok(());
        }
        let live = [JobPhase::Queued, JobPhase::Running];
        let all = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
        match what {
            0 | 1 => self.turn(id, &live, JobState::Paused),
            2 => self.turn(id, &[JobPhase::Paused], JobState::Queued),
            5 => self.tell(Event::Stopped(id)),
            3 if self.one_in(3) => self.turn(id, &all, JobState::Cancelled),
            _ => self.retry(id),
        }
    }

    fn turn(&mut self, id: JobId, from: &[JobPhase], to: JobState) -> Result<(), String> {
        match self.store().set_job_state(id, from, to, self.unix_ms) {
            Ok(record) => self.tell(Event::JobChanged(Box::new(record))),
            Err(StoreError::IllegalTransition { .. }) => Ok(()),
            Err(e) => self.refused(&e).map(drop),
        }
    }

    fn retry(&mut self, id: JobId) -> Result<(), String> {
        let ended = |w: &Self| w.store().job(id).unwrap().unwrap().state.phase().ended();
        if !ended(self) {
            return Ok(());
        }
        if let Err(e) = self.store().reopen_tiles(id) {
            return self.refused(&e).map(drop);
        }
        if ended(self) {
            return Ok(());
        }
        let job = Box::new(self.job(id));
        self.tell(Event::TakenUp(job))
    }

    /// Ends all faults.
    fn repair(&mut self) -> Result<(), String> {
        self.disk_full = false;
        self.end_faults();
        if self.scheduler.is_none() {
            self.after(500, SimulatedEvent::Fault);
            return Ok(());
        }
        // The operator has repaired the machines and releases their workers, now and every minute: checks may
        // detect earlier wrong outputs later.
        if self.spot_check > 0.0 {
            self.after(60_000, SimulatedEvent::Fault);
        }
        self.workers
            .iter_mut()
            .for_each(|worker| worker.broken &= self.spot_check == 0.0);
        for record in self.store().quarantined().map_err(|e| e.to_string())? {
            self.store()
                .release(&record.worker)
                .map_err(|e| e.to_string())?;
            self.tell(Event::Released(record.worker))?;
        }
        let paused = self
            .open_jobs()
            .into_iter()
            .filter(|(_, phase)| *phase == JobPhase::Paused);
        for (id, _) in paused.collect::<Vec<_>>() {
            self.turn(id, &[JobPhase::Paused], JobState::Queued)?;
        }
        Ok(())
    }
}
