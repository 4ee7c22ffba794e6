//! Simulated workers: they hold tiles, renew leases, deliver outputs and reconnect, as real workers do.

use sightline_records::ids::LeaseId;

use super::parts::{
    CommitAnswer, CoordinatorMessage, SimulatedEvent, SimulatedTile, WorkerMessage,
};
use super::world::World;
use crate::{Event, Introduction, Progress};

const IN_HAND: usize = 2;

impl World {
    /// Tries to open a stream.
    pub(super) fn connect(&mut self, w: usize) {
        if !self.workers[w].alive || self.workers[w].stream.is_some() {
            return;
        }
        let reachable = self.scheduler.is_some() && self.workers[w].cut_until <= self.now;
        if !reachable {
            let wait = self.workers[w].wait;
            self.workers[w].wait = (wait * 2).min(2000);
            self.after(wait, SimulatedEvent::Connect(w, self.workers[w].life));
            return;
        }
        let stream = self.open_stream(w);
        self.workers[w].stream = Some(stream);
        let held = self.workers[w].held.values().map(|h| h.lease).collect();
        let worker = &self.workers[w];
        let intro = Introduction {
            name: format!("w{w}"),
            signature: format!("w{w}"),
            version: String::new(),
            instance: worker.life * 100 + w as u64 + 1,
            profiles: vec![worker.profile.clone()],
            held,
            helps: !w.is_multiple_of(4),
        };
        self.send_up(stream, WorkerMessage::Hello(intro));
    }

    /// Handles a message of the coordinator.
    pub(super) fn worker_hears(&mut self, w: usize, stream: usize, down: CoordinatorMessage) {
        if self.workers[w].stream != Some(stream) {
            return;
        }
        match down {
            CoordinatorMessage::Welcome(kept) => {
                self.workers[w].wait = 200;
                let lost: Vec<LeaseId> = self.workers[w]
                    .held
                    .values()
                    .filter(|h| !kept.contains(&h.lease))
                    .map(|h| h.lease.id)
                    .collect();
                lost.into_iter().for_each(|id| self.cancel(w, id));
                if self.workers[w].draining {
                    self.send_up(stream, WorkerMessage::Drains);
                }
                self.want_all(w);
            }
            CoordinatorMessage::Grant(lease) => {
                let held = SimulatedTile {
                    lease,
                    runs: false,
                    ran: false,
                    cancelled: false,
                    samples: 0,
                    tries: 0,
                };
                self.workers[w].held.insert(lease.id, held);
                self.run_next(w);
            }
            CoordinatorMessage::Revoke(lease) if self.workers[w].held.contains_key(&lease.id) => {
                self.cancel(w, lease.id)
            }
            // The coordinator assumed a tile that the worker does not hold.
            CoordinatorMessage::Revoke(_) => self.want_all(w),
            CoordinatorMessage::Refused => self.worker_breaks(w),
        }
    }

    /// Cancels a tile, which stops after a while.
    pub(super) fn cancel(&mut self, w: usize, id: LeaseId) {
        let wait = 1 + self.below(200);
        let life = self.workers[w].life;
        if let Some(held) = self.workers[w].held.get_mut(&id)
            && !std::mem::replace(&mut held.cancelled, true)
        {
            self.after(wait, SimulatedEvent::Stopped(w, life, id));
        }
    }

    /// Begins the next tile if no tile runs.
    fn run_next(&mut self, w: usize) {
        if self.workers[w].held.values().any(|h| h.runs && !h.ran) {
            return;
        }
        let Some(next) = self.workers[w]
            .held
            .values_mut()
            .find(|h| !h.runs && !h.cancelled)
        else {
            return;
        };
        next.runs = true;
        let (id, lease) = (next.lease.id, next.lease);
        self.crew(50, Event::CrewOpened(lease));
        let time = (1 + self.below(self.tile_ms)) * self.workers[w].slowness;
        self.after(time, SimulatedEvent::Ran(w, self.workers[w].life, id));
    }

    /// Handles a tile that was computed or has failed.
    pub(super) fn ran(&mut self, w: usize, id: LeaseId) {
        let poisoned = self.workers[w]
            .held
            .get(&id)
            .is_some_and(|h| self.poisoned(&h.lease));
        let faulty = self.faults_on() && self.one_in(15);
        if let Some(held) = self.workers[w].held.get(&id) {
            let lease = held.lease;
            self.crew(500, Event::CrewClosed(lease));
        }
        if self.workers[w]
            .held
            .get(&id)
            .is_some_and(|h| !h.cancelled && self.is_lethal(&h.lease))
        {
            let wait = 1000 + self.below(5000);
            self.kill(w, wait);
            return;
        }
        let Some(held) = self.workers[w].held.get_mut(&id) else {
            return;
        };
        held.ran = true;
        let lease = held.lease;
        if (poisoned || faulty) && !held.cancelled {
            self.workers[w].held.remove(&id);
            let infrastructure = !poisoned && self.one_in(2);
            self.say(w, WorkerMessage::Failed(lease, infrastructure));
            self.want_more(w);
        } else {
            self.deliver(w, id);
        }
        self.run_next(w);
    }

    /// Sends an output, which arrives, or is lost and sent again.
    pub(super) fn deliver(&mut self, w: usize, id: LeaseId) {
        let Some(held) = self.workers[w].held.get_mut(&id).filter(|h| !h.cancelled) else {
            return;
        };
        held.tries += 1;
        let (lease, wait) = (held.lease, (250u64 << held.tries.min(6)).min(10_000));
        let life = self.workers[w].life;
        let lost = self.scheduler.is_none()
            || self.workers[w].cut_until > self.now
            || self.faults_on() && self.one_in(10);
        if lost {
            self.after(wait, SimulatedEvent::Deliver(w, life, id));
        } else {
            let delay = self.delay();
            self.after(delay, SimulatedEvent::Arrives(w, life, lease));
        }
    }

    /// Handles the coordinator's answer to an output.
    pub(super) fn answered(&mut self, w: usize, id: LeaseId, answer: CommitAnswer) {
        match answer {
            CommitAnswer::Kept => {
                self.workers[w].held.remove(&id);
            }
            CommitAnswer::NotNeeded => {
                if let Some(held) = self.workers[w].held.remove(&id)
                    && self.workers[w].draining
                {
                    self.say(w, WorkerMessage::Failed(held.lease, true));
                }
            }
            CommitAnswer::Differs => {
                if let Some(held) = self.workers[w].held.remove(&id) {
                    self.say(w, WorkerMessage::Failed(held.lease, false));
                }
            }
            CommitAnswer::Later => {
                let wait = 250 + self.below(5000);
                self.after(wait, SimulatedEvent::Deliver(w, self.workers[w].life, id));
                return;
            }
        }
        self.want_more(w);
    }

    /// Removes a cancelled tile that has stopped.
    pub(super) fn stopped(&mut self, w: usize, id: LeaseId) {
        if let Some(held) = self.workers[w].held.remove(&id) {
            if self.workers[w].draining {
                self.say(w, WorkerMessage::Failed(held.lease, true));
            }
            self.want_more(w);
            self.run_next(w);
        }
    }

    /// Requests tiles up to the number that a worker may hold.
    fn want_all(&mut self, w: usize) {
        let wants = IN_HAND.saturating_sub(self.workers[w].held.len()) as u32;
        if !self.workers[w].draining && wants > 0 {
            self.say(w, WorkerMessage::Want(wants));
        }
    }

    fn want_more(&mut self, w: usize) {
        if !self.workers[w].draining {
            self.say(w, WorkerMessage::Want(1));
        } else if self.workers[w].held.is_empty() {
            self.retire(w);
        }
    }

    /// Ends a draining worker without tiles, and starts another one in its place.
    pub(super) fn retire(&mut self, w: usize) {
        if let Some(stream) = self.workers[w].stream.take() {
            self.close_up(stream);
        }
        self.restart_worker(w);
    }

    /// Starts a new worker process without tiles.
    pub(super) fn restart_worker(&mut self, w: usize) {
        let wait = 100 + self.below(3000);
        let worker = &mut self.workers[w];
        worker.life += 1;
        (worker.alive, worker.draining, worker.stream, worker.wait) = (true, false, None, 200);
        worker.held.clear();
        let life = worker.life;
        self.after(wait, SimulatedEvent::Connect(w, life));
        self.after(wait + 1000, SimulatedEvent::Beat(w, life));
    }

    /// Renews all leases of a worker.
    pub(super) fn beat(&mut self, w: usize) {
        let life = self.workers[w].life;
        self.after(1000, SimulatedEvent::Beat(w, life));
        let mut reports = Vec::new();
        for held in self.workers[w].held.values_mut() {
            held.samples += u64::from(held.runs && !held.ran);
            reports.push(Progress {
                lease: held.lease,
                cells: 0,
                samples: held.samples,
            });
        }
        reports
            .into_iter()
            .for_each(|p| self.say(w, WorkerMessage::Progress(p)));
    }

    fn say(&mut self, w: usize, up: WorkerMessage) {
        if let Some(stream) = self.workers[w].stream {
            self.send_up(stream, up);
        }
    }

    /// Handles a broken stream that a worker has noticed.
    pub(super) fn worker_breaks(&mut self, w: usize) {
        if self.workers[w].stream.take().is_some() {
            let worker = &self.workers[w];
            self.after(worker.wait, SimulatedEvent::Connect(w, worker.life));
        }
    }
}
