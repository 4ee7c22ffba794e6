//! The program of a helper.

use sightline_sampling::crew::IN_HAND;

use super::parts::{Helps, Role, Task, ToCoordinator, ToWorker};
use super::world::World;

impl World<'_> {
    fn helps(&mut self, w: usize) -> Option<(&mut Helps, u32)> {
        let worker = &mut self.workers[w];
        match &mut worker.role {
            Role::Helps(helps) => Some((helps, worker.phase)),
            _ => None,
        }
    }

    /// Whether the items of the present phase are not needed any more.
    fn is_finished(&mut self, w: usize) -> bool {
        self.helps(w)
            .is_none_or(|(helps, phase)| helps.is_over || helps.outcomes.contains(&phase))
    }

    /// What follows when the helper has the scene.
    pub(super) fn helper_begins(&mut self, w: usize) {
        self.say(w, ToCoordinator::Enter);
        let task = if self.workers[w].has_facts {
            Task::Begin
        } else {
            Task::Facts
        };
        self.begin(w, task);
    }

    /// A helper has ended a task.
    pub(super) fn helper_did(&mut self, w: usize, task: Task) {
        let phase = self.workers[w].phase;
        match task {
            Task::Parse => {
                self.workers[w].has_scene = true;
                self.helper_begins(w);
            }
            Task::Facts => {
                self.workers[w].has_facts = true;
                self.begin(w, Task::Begin);
            }
            Task::Begin => self.enter_phase(w),
            Task::Prepare => {
                let Some((helps, _)) = self.helps(w) else {
                    return;
                };
                if !std::mem::replace(&mut helps.has_asked, true) {
                    (0..IN_HAND).for_each(|_| self.say(w, ToCoordinator::Ask(phase)));
                }
                self.step(w);
            }
            Task::Item(_) => {
                if let Some((
                    Helps {
                        piece: Some((_, done)),
                        ..
                    },
                    _,
                )) = self.helps(w)
                {
                    *done += 1;
                }
                self.step(w);
            }
            Task::Take(items) => {
                self.say(w, ToCoordinator::Found(phase, items));
                self.say(w, ToCoordinator::Ask(phase));
                self.step(w);
            }
            Task::AddOutcome => self.begin(w, Task::Gap),
            Task::Gap => {
                self.workers[w].phase += 1;
                if (self.workers[w].phase as usize) < self.block(w).phases.len() {
                    self.enter_phase(w);
                } else {
                    self.is_free(w);
                }
            }
            Task::AddPiece(_) | Task::Encode | Task::End => {}
        }
    }

    fn enter_phase(&mut self, w: usize) {
        match self.is_finished(w) {
            true => self.step(w),
            false => self.begin(w, Task::Prepare),
        }
    }

    /// What a helper does next in a phase.
    fn step(&mut self, w: usize) {
        let finished = self.is_finished(w);
        let Some((helps, phase)) = self.helps(w) else {
            return;
        };
        if let Some((items, done)) = helps.piece.take()
            && !finished
        {
            if let Some(item) = items.get(done).copied() {
                helps.piece = Some((items, done));
                return self.begin(w, Task::Item(item));
            }
            return self.begin(w, Task::Take(items));
        }
        if helps.is_over {
            return self.is_free(w);
        }
        if helps.outcomes.remove(&phase) {
            return self.begin(w, Task::AddOutcome);
        }
        helps.pieces.retain(|(of, _)| *of >= phase);
        if helps.pieces.front().is_some_and(|(of, _)| *of == phase)
            && let Some((_, items)) = helps.pieces.pop_front()
        {
            helps.piece = Some((items, 0));
            return self.step(w);
        }
        helps.waits = true;
    }

    fn is_free(&mut self, w: usize) {
        self.workers[w].role = Role::Idle;
        self.say(w, ToCoordinator::Free);
    }

    /// A message to a helper.
    pub(super) fn helper_hears(&mut self, w: usize, message: ToWorker) {
        let Some((helps, phase)) = self.helps(w) else {
            return;
        };
        match message {
            ToWorker::Take(of, items) => helps.pieces.push_back((of, items)),
            ToWorker::Outcome(of) if of >= phase => drop(helps.outcomes.insert(of)),
            ToWorker::Over => helps.is_over = true,
            _ => {}
        }
        if std::mem::take(&mut helps.waits) {
            self.step(w);
        }
    }
}
