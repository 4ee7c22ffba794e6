//! The coordinator: grants tiles, sends helpers, passes messages on, keeps outcomes.

use super::parts::{Role, Task, ToCoordinator, ToWorker};
use super::world::World;

/// Most helpers of each of a number of crews, as in `coordinator/src/scheduler/pools.rs`.
fn most_helpers(crews: usize) -> usize {
    (256 / crews.max(1)).clamp(7, 31)
}

impl World<'_> {
    /// Gives tiles and orders to help to workers without either.
    pub(super) fn grant(&mut self) {
        while let Some(w) = self.idle.first().copied() {
            if self.granted < self.tiles.len() {
                self.idle.remove(&w);
                self.tell(w, self.granted, ToWorker::Grant(self.granted));
                self.granted += 1;
                continue;
            }
            let Some((sent, tile)) = self.open.first().copied() else {
                return;
            };
            if sent >= most_helpers(self.open.len()).min(self.most_helpers) {
                return;
            }
            self.open.remove(&(sent, tile));
            self.tiles[tile].sent += 1;
            self.open.insert((self.tiles[tile].sent, tile));
            self.idle.remove(&w);
            self.tell(w, tile, ToWorker::Help(tile));
        }
    }

    /// A worker that has ended a tile and holds another one begins it at once: it was granted before, while
    /// there were more tiles than workers without one.
    pub(super) fn next_tile(&mut self, w: usize) {
        if self.granted < self.tiles.len() {
            let tile = self.granted;
            self.granted += 1;
            self.hears(w, ToWorker::Grant(tile));
        }
    }

    /// A message of a worker has come, about the tile that it had.
    pub(super) fn coordinate(&mut self, w: usize, tile: usize, message: ToCoordinator) {
        let member = w as u64;
        let leader = self.tiles[tile].leader;
        match message {
            ToCoordinator::Fetch => self.tell(w, tile, ToWorker::Scene),
            ToCoordinator::Enter if self.tiles[tile].leader == w => {
                self.tiles[tile].is_open = true;
                self.open.insert((0, tile));
                self.grant();
            }
            ToCoordinator::Enter if !self.tiles[tile].is_open => self.tell(w, tile, ToWorker::Over),
            ToCoordinator::Enter => {
                self.tiles[tile].helpers.push(w);
                self.tell(leader, tile, ToWorker::Joined(member));
                (0..self.tiles[tile].outcomes)
                    .for_each(|phase| self.tell(w, tile, ToWorker::Outcome(phase)));
            }
            ToCoordinator::Ask(phase) => self.tell_leader(tile, ToWorker::Ask(member, phase)),
            ToCoordinator::Found(phase, items) => {
                self.tell_leader(tile, ToWorker::Found(phase, items));
            }
            ToCoordinator::Take(to, phase, items) => {
                self.tell(to as usize, tile, ToWorker::Take(phase, items))
            }
            ToCoordinator::Outcome(phase) => {
                self.tiles[tile].outcomes = phase + 1;
                for helper in self.tiles[tile].helpers.clone() {
                    self.tell(helper, tile, ToWorker::Outcome(phase));
                }
            }
            ToCoordinator::Over => {
                self.open.remove(&(self.tiles[tile].sent, tile));
                self.tiles[tile].is_open = false;
                for helper in std::mem::take(&mut self.tiles[tile].helpers) {
                    self.tell(helper, tile, ToWorker::Over);
                }
            }
            ToCoordinator::Free => self.is_idle(w),
            ToCoordinator::Output => {
                self.tiles[tile].is_done = true;
                self.left -= 1;
                self.is_idle(w);
            }
        }
    }

    fn is_idle(&mut self, w: usize) {
        // It may have begun another tile meanwhile.
        if matches!(self.workers[w].role, Role::Idle) {
            self.idle.insert(w);
            self.grant();
        }
    }

    fn tell_leader(&mut self, tile: usize, message: ToWorker) {
        if self.tiles[tile].is_open {
            self.tell(self.tiles[tile].leader, tile, message);
        }
    }

    /// A worker hears a message.
    pub(super) fn hears(&mut self, w: usize, message: ToWorker) {
        match message {
            ToWorker::Grant(tile) | ToWorker::Help(tile) => {
                let leads = matches!(message, ToWorker::Grant(_));
                let worker = &mut self.workers[w];
                (worker.tile, worker.phase) = (tile, 0);
                worker.role = if leads {
                    Role::Leads(Default::default())
                } else {
                    Role::Helps(Default::default())
                };
                if leads {
                    self.tiles[tile].leader = w;
                }
                match (self.workers[w].has_scene, leads) {
                    (false, _) => self.say(w, ToCoordinator::Fetch),
                    (true, true) => {
                        self.say(w, ToCoordinator::Enter);
                        self.leader_begins(w);
                    }
                    (true, false) => self.helper_begins(w),
                }
            }
            ToWorker::Scene => self.begin(w, Task::Parse),
            message => match self.workers[w].role {
                Role::Leads(_) => self.leader_hears(w, message),
                Role::Helps(_) => self.helper_hears(w, message),
                Role::Idle => {}
            },
        }
    }
}
