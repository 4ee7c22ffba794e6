//! The execution of one schedule: all events from its seed, in the order of time, and the verdict.

use sightline_store::failing::Counts as DiskCounts;

use super::faults;
use super::parts::{Ground, SimulatedEvent};
use super::world::World;
use crate::Event;

/// The time after the last fault within which every job must end, in milliseconds.
const PATIENCE: u64 = 10_800_000;

/// Runs a schedule.
///
/// # Errors
/// The description of the first violated rule.
pub(super) fn run(seed: u64) -> Result<(), String> {
    run_in(faults::world(seed)).map(drop)
}

/// Runs a schedule on a disk that fails, with spot checks. Returns the numbers of disk faults.
///
/// # Errors
/// The description of the first violated rule.
pub(super) fn run_on_disk(seed: u64) -> Result<DiskCounts, String> {
    run_in(faults::world_on_disk(seed)?)
}

fn run_in(mut world: World) -> Result<DiskCounts, String> {
    world.start_coordinator()?;
    for w in 0..world.workers.len() {
        world.workers[w].life = 0;
        world.restart_worker(w);
    }
    let first = 500 + world.below(3000);
    world.after(first, SimulatedEvent::Fault);
    while let Some(((at, _), event)) = world.queue.pop_first() {
        world.now = at;
        if world.now > super::world::FAULTS + PATIENCE {
            let open: Vec<_> = world.open_jobs();
            let state = world
                .scheduler
                .as_ref()
                .map(|scheduler| scheduler.state_text());
            let tiles: Vec<_> = open
                .iter()
                .map(|(id, _)| world.store().tiles(*id))
                .collect();
            return Err(format!(
                "jobs do not end: {open:?}\n{}\n{tiles:?}",
                state.unwrap_or_default()
            ));
        }
        world.handle(event)?;
        if !world.faults_on() && world.scheduler.is_some() && world.open_jobs().is_empty() {
            break;
        }
    }
    world.end_faults();
    world.nothing_is_lost()?;
    Ok(match &world.ground {
        Ground::Memory(_) => DiskCounts::default(),
        Ground::Disk(disk) => disk.counts(),
    })
}

impl World {
    fn handle(&mut self, event: SimulatedEvent) -> Result<(), String> {
        use SimulatedEvent as H;
        // A suspended worker or coordinator handles every event later, in the same order.
        let later = match &event {
            H::Tick(_)
            | H::Up(..)
            | H::UpBroken(_)
            | H::Arrives(..)
            | H::Durable(..)
            | H::Run(..)
            | H::Assemble(..)
            | H::Crew(..) => self.stalled_until,
            H::Connect(w, _)
            | H::Beat(w, _)
            | H::Ran(w, ..)
            | H::Deliver(w, ..)
            | H::Answered(w, ..)
            | H::Stopped(w, ..) => self.workers[*w].paused_until,
            H::Down(s, _) | H::DownBroken(s) => self.workers[self.streams[*s].worker].paused_until,
            H::Fault | H::Revive(..) | H::CoordinatorUp | H::DiskFree => 0,
        };
        if later > self.now {
            self.at(later, event);
            return Ok(());
        }
        let alive = |w: usize, life: u64| self.workers[w].alive && self.workers[w].life == life;
        match event {
            H::Tick(life) if life == self.life => {
                self.after(1000, H::Tick(life));
                self.tell(Event::Tick)?;
            }
            H::Crew(life, event) if life == self.life && self.scheduler.is_some() => {
                self.tell(*event)?;
                self.prioritize()?;
            }
            H::Connect(w, life) if alive(w, life) => self.connect(w),
            H::Up(s, up) if !self.streams[s].closed && self.streams[s].life == self.life => {
                self.hears(s, up)?;
            }
            H::Down(s, down) if !self.streams[s].closed => {
                self.worker_hears(self.streams[s].worker, s, down);
            }
            H::UpBroken(s) => {
                self.streams[s].closed = true;
                if let Some(number) = self.streams[s]
                    .number
                    .filter(|_| self.streams[s].life == self.life)
                {
                    self.tell(Event::Left(number))?;
                    self.streams[s].number = None;
                }
            }
            H::DownBroken(s) => {
                let w = self.streams[s].worker;
                if self.workers[w].stream == Some(s) {
                    self.worker_breaks(w);
                }
            }
            H::Beat(w, life) if alive(w, life) => self.beat(w),
            H::Ran(w, life, id) if alive(w, life) => self.ran(w, id),
            H::Deliver(w, life, id) if alive(w, life) => self.deliver(w, id),
            H::Arrives(w, life, lease) => self.arrives(w, life, lease)?,
            H::Durable(life, w, worker_life, events, id, answer) if life == self.life => {
                events.into_iter().try_for_each(|event| self.tell(event))?;
                self.answer(w, worker_life, id, answer);
            }
            H::Answered(w, life, id, answer) if alive(w, life) => self.answered(w, id, answer),
            H::Stopped(w, life, id) if alive(w, life) => self.stopped(w, id),
            H::Run(life, command) if life == self.life => self.run_command(*command)?,
            H::Assemble(life, job) if life == self.life => self.assemble(job)?,
            H::Fault => self.fault()?,
            H::Revive(w, life) if self.workers[w].life == life => self.restart_worker(w),
            H::CoordinatorUp => self.start_coordinator()?,
            H::DiskFree => self.fill(false),
            _ => {}
        }
        Ok(())
    }
}
