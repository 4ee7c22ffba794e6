//! The program of a leader.

use std::collections::VecDeque;

use sightline_sampling::crew::{IN_HAND, Member, Queue};

use super::parts::{Leads, Role, Task, ToCoordinator, ToWorker};
use super::world::World;

/// Without helpers, outcomes are handed over this often.
const HAND_OVER: u64 = 1_000_000_000;

impl World<'_> {
    fn leads(&mut self, w: usize) -> Option<&mut Leads> {
        match &mut self.workers[w].role {
            Role::Leads(leads) => Some(leads),
            _ => None,
        }
    }

    /// A leader has ended a task.
    pub(super) fn leader_did(&mut self, w: usize, task: Task) {
        let now = self.now;
        match task {
            Task::Parse => {
                self.workers[w].has_scene = true;
                self.say(w, ToCoordinator::Enter);
                self.leader_begins(w);
            }
            Task::Facts => {
                self.workers[w].has_facts = true;
                self.begin(w, Task::Begin);
            }
            Task::Begin => self.begin(w, Task::Prepare),
            Task::Prepare => {
                let costs = self.phase(w).costs.clone();
                let Some(leads) = self.leads(w) else { return };
                let number = leads.number;
                leads.answered = vec![false; costs.len()];
                leads.queue = Some(Queue::new(costs));
                leads.asking.clear();
                for _ in 0..IN_HAND {
                    leads
                        .asking
                        .extend(leads.ready.iter().map(|member| (*member, number)));
                }
                self.give(w);
                self.next_item(w);
            }
            Task::Item(item) => {
                self.answer(w, &[item]);
                self.next_item(w);
            }
            Task::AddPiece(items) => {
                self.answer(w, &items);
                self.next_item(w);
            }
            Task::Encode => {
                let Some(leads) = self.leads(w) else { return };
                let number = leads.number - 1;
                leads.kept.push(number);
                let since = *leads.handed_over.get_or_insert(now);
                if !leads.helpers.is_empty() || now - since >= HAND_OVER {
                    self.hand_over(w);
                }
                self.begin(w, Task::Gap);
            }
            Task::Gap => {
                self.workers[w].phase += 1;
                if (self.workers[w].phase as usize) < self.block(w).phases.len() {
                    self.begin(w, Task::Prepare);
                } else {
                    self.say(w, ToCoordinator::Over);
                    self.begin(w, Task::End);
                }
            }
            Task::End => {
                self.say(w, ToCoordinator::Output);
                self.workers[w].role = Role::Idle;
                self.next_tile(w);
            }
            Task::Take(_) | Task::AddOutcome => {}
        }
    }

    /// What follows when the leader has the scene.
    pub(super) fn leader_begins(&mut self, w: usize) {
        let task = if self.workers[w].has_facts {
            Task::Begin
        } else {
            Task::Facts
        };
        self.begin(w, task);
    }

    /// What the leader does next in a phase.
    fn next_item(&mut self, w: usize) {
        let Some(leads) = self.leads(w) else { return };
        if let Some(items) = leads.done.pop_front() {
            return self.begin(w, Task::AddPiece(items));
        }
        while let Some(item) = leads
            .queue
            .as_mut()
            .and_then(|q| q.next_free().or_else(|| q.next_given()))
        {
            if !leads.answered[item] {
                return self.begin(w, Task::Item(item as u32));
            }
        }
        leads.queue = None;
        leads.done.clear();
        leads.number += 1;
        leads.asking.clear();
        self.begin(w, Task::Encode);
    }

    fn answer(&mut self, w: usize, items: &[u32]) {
        let Some(leads) = self.leads(w) else { return };
        for item in items {
            leads.answered[*item as usize] = true;
            if let Some(queue) = &mut leads.queue {
                queue.answered(*item as usize);
            }
        }
    }

    /// A message to the leader.
    pub(super) fn leader_hears(&mut self, w: usize, message: ToWorker) {
        let Some(leads) = self.leads(w) else { return };
        match message {
            ToWorker::Joined(member) => {
                leads.helpers.insert(member);
                self.hand_over(w);
            }
            ToWorker::Ask(member, phase) => {
                let number = leads.number;
                if leads.helpers.contains(&member) && leads.ready.insert(member) && phase < number {
                    (0..IN_HAND).for_each(|_| leads.asking.push_back((member, number)));
                    self.give(w);
                } else if phase >= number
                    && leads.asking.iter().filter(|(m, _)| *m == member).count() < IN_HAND
                {
                    leads.asking.push_back((member, phase));
                    self.give(w);
                }
            }
            ToWorker::Found(phase, items) if phase == leads.number && leads.queue.is_some() => {
                leads.done.push_back(items);
            }
            _ => {}
        }
    }

    /// Gives free items to helpers that ask.
    fn give(&mut self, w: usize) {
        let Some(leads) = self.leads(w) else { return };
        let (number, members) = (leads.number, leads.helpers.len() + 1);
        let Some(queue) = &mut leads.queue else {
            return;
        };
        let (mut waiting, mut given) = (VecDeque::new(), Vec::<(Member, Vec<u32>)>::new());
        while let Some((member, phase)) = leads.asking.pop_front() {
            let piece = if phase == number {
                queue.piece(member, members)
            } else {
                Vec::new()
            };
            if piece.is_empty() {
                waiting.push_back((member, phase));
            } else {
                given.push((member, piece.into_iter().map(|i| i as u32).collect()));
            }
        }
        leads.asking = waiting;
        for (member, items) in given {
            self.say(w, ToCoordinator::Take(member, number, items));
        }
    }

    fn hand_over(&mut self, w: usize) {
        let now = self.now;
        let Some(leads) = self.leads(w) else { return };
        leads.handed_over = Some(now);
        for phase in std::mem::take(&mut leads.kept) {
            self.say(w, ToCoordinator::Outcome(phase));
        }
    }
}
