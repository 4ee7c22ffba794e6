//! The states of all triangles while a cell is decided, and the decisions that need no query.

use std::cmp::Ordering;

use rayon::prelude::*;
use sightline_certificate::proof::Proof;
use sightline_certificate::{HiddenGroup, Target, Witness};
use sightline_geometry::bvh::{Below, Bvh};
use sightline_scene::{Triangle, TriangleId, overlap};

use crate::cells::sources::Sources;
use crate::cells::task::{CellDecisions, CellTask};
use crate::search::UndecidedReason;
use crate::surfaces::HiddenFrom;

/// The state of a triangle while a cell is decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriangleState {
    /// Not decided so far.
    Open,
    Visible,
    Hidden,
    Undecided,
}

/// The states of all triangles and the decisions so far for one cell.
pub struct CellWork<'a> {
    pub task: &'a CellTask<'a>,
    pub sources: Sources<'a>,
    /// The state of each triangle of the scene, by triangle id.
    pub state: Vec<TriangleState>,
    /// The ids of the triangles that closed surfaces hide from one side of their planes, in ascending order,
    /// with that side.
    pub halves: Vec<(u32, Ordering)>,
    pub decided: CellDecisions,
}

impl<'a> CellWork<'a> {
    pub fn new(task: &'a CellTask<'a>) -> Self {
        let scene = task.scene.occluders();
        let first = |id: u32| {
            // A blocking triangle that cannot be in a set of visible triangles counts as hidden, without a
            // proof.
            if scene.occluder_id(TriangleId(id)).is_some() && !scene.is_target(TriangleId(id)) {
                TriangleState::Hidden
            } else {
                TriangleState::Open
            }
        };
        let state = (0..scene.len() as u32).map(first).collect();
        let sources = Sources::new(task.cell, task.region);
        Self {
            task,
            sources,
            state,
            halves: Vec::new(),
            decided: CellDecisions::default(),
        }
    }
}

impl CellWork<'_> {
    /// Marks the triangles hidden from the box of the cell's group as hidden.
    pub fn take_over(&mut self) {
        let task = self.task;
        for id in task.above {
            debug_assert!(
                self.state[*id as usize] == TriangleState::Open,
                "triangle {id} meets the cell"
            );
            self.state[*id as usize] = TriangleState::Hidden;
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

    /// Marks all triangles as hidden that are not in [`CellTask::listed`], if the task has such a list.
    pub fn keep_to_listed(&mut self) {
        let Some(listed) = self.task.listed else {
            return;
        };
        let scene = self.task.scene.occluders();
        for (id, state) in self.state.iter_mut().enumerate() {
            let id = id as u32;
            if *state == TriangleState::Open
                && scene.is_target(TriangleId(id))
                && listed.binary_search(&id).is_err()
            {
                *state = TriangleState::Hidden;
                self.decided.statistics.hidden += 1;
                self.decided.statistics.refuted +=
                    u64::from(self.task.seen.binary_search(&id).is_ok());
            }
        }
    }

    /// Marks I(C), the triangles that meet the part of the cell with viewpoints, as visible.
    pub fn meeting(&mut self) {
        for id in self.meeting_in(self.task.scene.occluders().targets()) {
            if self
                .sources
                .is_met_by(*self.task.scene.occluders().triangle(id))
            {
                self.state[id as usize] = TriangleState::Visible;
            }
        }
    }

    /// Returns the triangles of a hierarchy that meet the cell.
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

    /// Marks the triangles that closed surfaces hide as hidden: most triangles that face away from the cell.
    pub fn enclose(&mut self) {
        let task = self.task;
        let all = 0..self.state.len() as u32;
        // Surfaces consist of all blocking triangles, including triangles that cannot be in a set.
        let meeting = self.meeting_in(task.scene.occluders().hierarchy());
        let from = task
            .scene
            .surfaces()
            .seen_from(task.scene.occluders(), task.cell, &meeting);
        let open = |id: &u32| self.state[*id as usize] == TriangleState::Open;
        let hidden: Vec<(u32, HiddenFrom)> = all
            .into_par_iter()
            .filter(open)
            .map(|id| (id, from.hides(id)))
            .filter(|h| h.1 != HiddenFrom::Nothing)
            .collect();
        let ids: Vec<u32> = hidden
            .iter()
            .filter(|h| h.1 == HiddenFrom::All)
            .map(|h| h.0)
            .collect();
        self.halves = hidden
            .into_iter()
            .filter_map(|(id, h)| {
                if let HiddenFrom::From(side) = h {
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

    /// Marks a triangle as visible, and stores its witness if the task wants certificates.
    pub fn see(&mut self, id: u32, witness: impl FnOnce(&Self) -> Witness) {
        self.state[id as usize] = TriangleState::Visible;
        if self.task.keep {
            let witness = witness(self);
            self.decided.certificate.seen.push((id, witness));
        }
    }

    /// Marks triangles as hidden, and stores their common proofs if the task wants certificates.
    pub fn hide(&mut self, ids: &[u32], target: Target, proofs: Vec<Proof>) {
        ids.iter()
            .for_each(|id| self.state[*id as usize] = TriangleState::Hidden);
        self.decided.statistics.hidden += ids.len() as u64;
        if self.task.keep && !ids.is_empty() {
            self.decided.certificate.hidden.push(HiddenGroup {
                target,
                triangles: ids.to_vec(),
                proofs,
            });
        }
    }

    /// Marks an open triangle as undecided. A `reason` of `None` means that the caller stopped the search.
    pub fn leave(&mut self, id: u32, reason: Option<UndecidedReason>) {
        if self.state[id as usize] != TriangleState::Open {
            return;
        }
        self.state[id as usize] = TriangleState::Undecided;
        let kind = match reason {
            None | Some(UndecidedReason::Stopped) => 0,
            Some(UndecidedReason::Regions) => 1,
            Some(UndecidedReason::Memory) => 2,
            Some(UndecidedReason::Divisions) => 3,
        };
        self.decided.statistics.open[kind] += 1;
    }

    /// Returns the decisions about all triangles.
    pub fn finish(mut self) -> CellDecisions {
        for (id, state) in self.state.iter().enumerate() {
            let id = id as u32;
            match state {
                TriangleState::Visible => self.decided.visible.push(id),
                TriangleState::Undecided => self.decided.undecided.push(id),
                // Every triangle with area was queried. If a triangle was not, it must not count as hidden.
                TriangleState::Open if self.task.scene.occluders().is_target(TriangleId(id)) => {
                    debug_assert!(false, "triangle {id} was not queried");
                    self.decided.undecided.push(id);
                }
                TriangleState::Open | TriangleState::Hidden => {}
            }
        }
        self.decided.certificate.seen.sort_by_key(|(id, _)| *id);
        self.decided
    }
}
