//! The states of all triangles while a cell is decided, and the decisions that need no query.

use std::cmp::Ordering;

use rayon::prelude::*;
use sightline_certificate::proof::Proof;
use sightline_certificate::{HiddenGroup, Target, Witness};
use sightline_geometry::bvh::{Below, Bvh};
use sightline_scene::{Triangle, overlap};

use crate::cells::sources::Sources;
use crate::cells::task::{Decided, Task};
use crate::search::Reason;
use crate::surfaces::Hides;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    Open,
    Visible,
    Hidden,
    Undecided,
}

pub struct Work<'a> {
    pub task: &'a Task<'a>,
    pub sources: Sources<'a>,
    pub state: Vec<State>,
    /// Triangles that surfaces hide from one side of their planes, ascending, with that side.
    pub halves: Vec<(u32, Ordering)>,
    pub decided: Decided,
}

impl<'a> Work<'a> {
    pub fn new(task: &'a Task<'a>) -> Self {
        let scene = task.scene.occluders();
        let first = |id: u32| {
            // A blocking triangle that cannot be in a set counts as hidden, without a proof.
            if scene.of(id).is_some() && !scene.is_target(id) {
                State::Hidden
            } else {
                State::Open
            }
        };
        let state = (0..scene.len() as u32).map(first).collect();
        let sources = Sources::new(task.cell, task.places);
        Self {
            task,
            sources,
            state,
            halves: Vec::new(),
            decided: Decided::default(),
        }
    }
}

impl Work<'_> {
    /// Marks the triangles hidden from the box around the cell's group.
    pub fn take_over(&mut self) {
        let task = self.task;
        for id in task.above {
            debug_assert!(
                self.state[*id as usize] == State::Open,
                "triangle {id} meets the cell"
            );
            self.state[*id as usize] = State::Hidden;
        }
        let statistics = &mut self.decided.statistics;
        statistics.above = task.above.len() as u64;
        statistics.hidden += statistics.above;
        statistics.refuted += task
            .above
            .iter()
            .filter(|id| task.seen.binary_search(id).is_ok())
            .count() as u64;
    }

    /// Marks the triangles hidden that the task does not list.
    pub fn keep_to_listed(&mut self) {
        let Some(listed) = self.task.listed else {
            return;
        };
        let scene = self.task.scene.occluders();
        for (id, state) in self.state.iter_mut().enumerate() {
            let id = id as u32;
            if *state == State::Open && scene.is_target(id) && listed.binary_search(&id).is_err() {
                *state = State::Hidden;
                self.decided.statistics.hidden += 1;
                self.decided.statistics.refuted +=
                    u64::from(self.task.seen.binary_search(&id).is_ok());
            }
        }
    }

    /// Marks the triangles that meet the cell where viewpoints are, I(C).
    pub fn meeting(&mut self) {
        for id in self.meeting_in(self.task.scene.occluders().targets()) {
            if self
                .sources
                .is_met_by(*self.task.scene.occluders().triangle(id))
            {
                self.state[id as usize] = State::Visible;
            }
        }
    }

    /// The triangles of a hierarchy that meet the cell.
    fn meeting_in(&self, tree: &Bvh) -> Vec<u32> {
        let bounds = self.task.cell.bounds();
        let mut meeting = Vec::new();
        let mut open = if tree.is_empty() { Vec::new() } else { vec![0] };
        while let Some(node) = open.pop() {
            if !self.task.cell.touches(tree.bounds(node)) {
                continue;
            }
            match tree.below(node) {
                Below::Nodes(children) => open.extend(children),
                Below::Items(items) => {
                    for id in items {
                        let triangle = Triangle {
                            v: *self.task.scene.occluders().triangle(*id),
                        };
                        if overlap::triangle_touches_box(&triangle, &bounds) {
                            meeting.push(*id);
                        }
                    }
                }
            }
        }
        meeting
    }

    /// Marks the triangles that closed surfaces hide: most of those that face away from the cell.
    pub fn enclose(&mut self) {
        let task = self.task;
        let all = 0..self.state.len() as u32;
        // Surfaces consist of all blocking triangles, those that cannot be in a set included.
        let meeting = self.meeting_in(task.scene.occluders().hierarchy());
        let from = task
            .scene
            .surfaces()
            .seen_from(task.scene.occluders(), task.cell, &meeting);
        let open = |id: &u32| self.state[*id as usize] == State::Open;
        let hidden: Vec<(u32, Hides)> = all
            .into_par_iter()
            .filter(open)
            .map(|id| (id, from.hides(id)))
            .filter(|h| h.1 != Hides::Nothing)
            .collect();
        let ids: Vec<u32> = hidden
            .iter()
            .filter(|h| h.1 == Hides::All)
            .map(|h| h.0)
            .collect();
        self.halves = hidden
            .into_iter()
            .filter_map(|(id, h)| {
                if let Hides::From(side) = h {
                    Some((id, side))
                } else {
                    None
                }
            })
            .collect();
        self.decided.statistics.enclosed = ids.len() as u64;
        self.decided.statistics.refuted += ids
            .iter()
            .filter(|id| task.seen.binary_search(id).is_ok())
            .count() as u64;
        if !ids.is_empty() {
            self.hide(&ids, Target::Surfaces, Vec::new());
        }
    }

    pub fn see(&mut self, id: u32, witness: impl FnOnce(&Self) -> Witness) {
        self.state[id as usize] = State::Visible;
        if self.task.keep {
            let witness = witness(self);
            self.decided.certificate.seen.push((id, witness));
        }
    }

    pub fn hide(&mut self, ids: &[u32], target: Target, proofs: Vec<Proof>) {
        ids.iter()
            .for_each(|id| self.state[*id as usize] = State::Hidden);
        self.decided.statistics.hidden += ids.len() as u64;
        if self.task.keep && !ids.is_empty() {
            self.decided.certificate.hidden.push(HiddenGroup {
                target,
                triangles: ids.to_vec(),
                proofs,
            });
        }
    }

    /// Marks a triangle undecided; no reason means that the search was stopped.
    pub fn leave(&mut self, id: u32, reason: Option<Reason>) {
        if self.state[id as usize] != State::Open {
            return;
        }
        self.state[id as usize] = State::Undecided;
        let kind = match reason {
            None | Some(Reason::Stopped) => 0,
            Some(Reason::Regions) => 1,
            Some(Reason::Memory) => 2,
            Some(Reason::Divisions) => 3,
        };
        self.decided.statistics.open[kind] += 1;
    }

    pub fn finish(mut self) -> Decided {
        for (id, state) in self.state.iter().enumerate() {
            let id = id as u32;
            match state {
                State::Visible => self.decided.visible.push(id),
                State::Undecided => self.decided.undecided.push(id),
                // Every triangle with area was queried; if one were not, it must not be reported as hidden.
                State::Open if self.task.scene.occluders().is_target(id) => {
                    debug_assert!(false, "triangle {id} was not queried");
                    self.decided.undecided.push(id);
                }
                State::Open | State::Hidden => {}
            }
        }
        self.decided.certificate.seen.sort_by_key(|(id, _)| *id);
        self.decided
    }
}
