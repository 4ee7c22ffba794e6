//! Everything visible from one view cell, decided (thesis §6.2): what sampling has shown gets a witness, the rest is asked
//! about ([`search`]), whole boxes first, the largest as seen from the cell before the others.
//!
//! V(C) = I(C) ∪ V(∂C): what meets the cell is visible, everything else is seen through a face of the cell or not at all. A box whose
//! faces are all hidden from all faces of the cell hides everything in it. Boxes that hold something visible are not asked about.
//! What is hidden from a box around several cells is hidden from each, and asked about once ([`together`]).
//! Stopped at any time, what is not decided is said to be undecided, so visible ⊆ V(C) ⊆ visible ∪ undecided always.

use std::cmp::Ordering;

use rayon::prelude::*;
use sightline_scene::{Aabb, Triangle, overlap};

use crate::bvh::Below;
use crate::cell::{Cell, Found};
use crate::effort::Effort;
use crate::evidence::{Evidence, Hidden, Target, Witness};
use crate::occluder::Occluders;
use crate::query::{Limits, Reason};
use crate::rays;
use crate::segment::shows;
use crate::surface::Hides;

mod progress;
mod search;
mod together;

use search::{Asked, Item};
pub use together::{Together, together};

/// Witnesses of queries are rounded to points so far beyond the triangle, in parts of the segment's length.
const BEYOND: f64 = 1e-5;

/// How a cell is to be decided.
pub struct Task<'a> {
    /// What blocks.
    pub scene: &'a Occluders,
    /// The cell.
    pub cell: Cell,
    /// Triangles sampling has shown, ascending: guesses, each of which is checked.
    pub seen: &'a [u32],
    /// Triangles that are hidden from a box around the cell, ascending: none of them meets the cell.
    pub above: &'a [u32],
    /// When a single query gives up.
    pub limits: Limits,
    /// Seed of the rays.
    pub seed: u64,
    /// Whether to keep witnesses and proofs.
    pub keep: bool,
    /// Asked before every region of every query whether to stop with what there is.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Told after every query.
    pub asked: &'a (dyn Fn() + Sync),
}

/// What was decided about a cell.
#[derive(Debug, Default, PartialEq)]
pub struct Decided {
    /// Triangles seen or meeting the cell, ascending.
    pub visible: Vec<u32>,
    /// Triangles neither seen nor proved hidden, ascending.
    pub undecided: Vec<u32>,
    /// Witnesses and proofs, if they are kept.
    pub evidence: Evidence,
    /// What it took.
    pub effort: Effort,
}

/// Decides every triangle with area. On one of rayon's threads only after [`Occluders::surfaces`] was called elsewhere.
pub fn decide(task: &Task<'_>) -> Decided {
    let tree = task.scene.hierarchy();
    let mut work = Work::new(task);
    if tree.is_empty() {
        return work.decided;
    }
    work.meeting();
    work.take_over();
    work.enclose();
    work.show();
    work.search();
    work.finish()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Open,
    Visible,
    Hidden,
    Undecided,
}

struct Work<'a> {
    task: &'a Task<'a>,
    state: Vec<State>,
    /// Triangles that surfaces hide from one side of their planes, ascending, with that side.
    halves: Vec<(u32, Ordering)>,
    decided: Decided,
}

impl<'a> Work<'a> {
    fn new(task: &'a Task<'a>) -> Self {
        let state = vec![State::Open; task.scene.len()];
        Self { task, state, halves: Vec::new(), decided: Decided::default() }
    }
}

impl Work<'_> {
    /// Marks what is hidden from all around.
    fn take_over(&mut self) {
        let task = self.task;
        for id in task.above {
            debug_assert!(self.state[*id as usize] == State::Open, "triangle {id} meets the cell");
            self.state[*id as usize] = State::Hidden;
        }
        let effort = &mut self.decided.effort;
        effort.above = task.above.len() as u64;
        effort.hidden += effort.above;
        effort.refuted += task.above.iter().filter(|id| task.seen.binary_search(id).is_ok()).count() as u64;
    }

    /// Marks what meets the cell, I(C).
    fn meeting(&mut self) {
        let [min, max] = self.task.cell.corners();
        let bounds = Aabb { min, max };
        let tree = self.task.scene.hierarchy();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            if !self.task.cell.touches(tree.bounds(node)) {
                continue;
            }
            match tree.below(node) {
                Below::Nodes(children) => open.extend(children),
                Below::Items(items) => {
                    for id in items {
                        let triangle = Triangle { v: *self.task.scene.triangle(*id) };
                        if overlap::triangle_touches_box(&triangle, &bounds) {
                            self.state[*id as usize] = State::Visible;
                        }
                    }
                }
            }
        }
    }

    /// Marks what closed surfaces hide: most of what faces away.
    fn enclose(&mut self) {
        let task = self.task;
        let all = 0..self.state.len() as u32;
        let meeting: Vec<u32> = all.clone().filter(|id| self.state[*id as usize] == State::Visible).collect();
        let from = task.scene.surfaces().seen_from(task.scene, task.cell, &meeting);
        let open = |id: &u32| self.state[*id as usize] == State::Open;
        let hidden: Vec<(u32, Hides)> = all
            .into_par_iter()
            .filter(open)
            .map(|id| (id, from.hides(id)))
            .filter(|h| h.1 != Hides::Nothing)
            .collect();
        let ids: Vec<u32> = hidden.iter().filter(|h| h.1 == Hides::All).map(|h| h.0).collect();
        self.halves = hidden
            .into_iter()
            .filter_map(|(id, h)| if let Hides::From(side) = h { Some((id, side)) } else { None })
            .collect();
        self.decided.effort.enclosed = ids.len() as u64;
        self.decided.effort.refuted +=
            ids.iter().filter(|id| task.seen.binary_search(id).is_ok()).count() as u64;
        if !ids.is_empty() {
            self.hide(&ids, Target::Surfaces, Vec::new());
        }
    }

    /// Finds witnesses for what sampling has shown: by rays, then by queries.
    fn show(&mut self) {
        let task = self.task;
        let open = |id: &u32| self.state[*id as usize] == State::Open && task.scene.of(*id).is_some();
        let wanted: Vec<u32> = task.seen.iter().copied().filter(open).collect();
        let (found, rays) = rays::witnesses(task.scene, &task.cell, &wanted, task.seed, task.stop);
        self.decided.effort.rays = rays;
        let left: Vec<u32> = wanted.into_iter().filter(|id| !found.contains_key(id)).collect();
        for (id, ends) in found {
            self.see(id, || Witness::Floats(ends));
        }
        let asked: Vec<Asked> = left.par_iter().map(|id| self.ask(Item::Triangle(*id))).collect();
        for mut answer in asked {
            self.show_beside(&mut answer);
            if let (Item::Triangle(_), Some(Found::Hidden(_))) = (answer.of, &answer.found) {
                self.decided.effort.refuted += 1;
            }
            self.take(answer);
        }
    }

    /// Takes up an answer that decides.
    fn take(&mut self, Asked { of, found, cost, .. }: Asked) {
        self.decided.effort.cost += cost;
        self.decided.effort.queries += u64::from(found.is_some());
        // A ray may have shown it in the meantime, or a box it is in may have turned out to be hidden.
        if matches!(of, Item::Triangle(id) if self.state[id as usize] != State::Open) {
            return;
        }
        match (of, found) {
            (Item::Triangle(id), Some(Found::Visible(ends))) => {
                if self.task.seen.binary_search(&id).is_err() {
                    self.decided.effort.missed += 1;
                }
                let scene = self.task.scene;
                let cell = self.task.cell;
                self.see(id, || witness(scene, &cell, id, &ends));
            }
            (Item::Triangle(id), Some(Found::Undecided(reason))) => self.leave(id, Some(reason)),
            (Item::Triangle(id), None) => self.leave(id, None),
            (Item::Triangle(id), Some(Found::Hidden(proofs))) => {
                let half = self.hidden_half(of).is_some();
                self.hide(&[id], if half { Target::Half } else { Target::Triangle }, proofs);
            }
            (Item::Node(node), Some(Found::Hidden(proofs))) => {
                let mut ids = Vec::new();
                self.each_below(node, |work, id| {
                    if work.state[id as usize] == State::Open {
                        ids.push(id);
                    }
                });
                ids.sort_unstable();
                self.decided.effort.boxes += 1;
                self.hide(&ids, Target::Box(self.task.scene.hierarchy().bounds(node)), proofs);
            }
            (Item::Face(face), Some(Found::Hidden(proofs))) => {
                let mut ids = self.open_of(face);
                ids.sort_unstable();
                // The corners as the query had them: single-precision points of the scene.
                let corners = self.outline(face).map_or_else(Vec::new, |p| p.rounded());
                let corners = corners.iter().map(|c| c.as_vec3()).collect();
                self.hide(&ids, Target::Polygon(corners), proofs);
            }
            (Item::Node(_) | Item::Face(_), _) => {}
        }
    }

    /// Takes up witnesses that were found by the way.
    fn show_beside(&mut self, answer: &mut Asked) -> Vec<u32> {
        self.decided.effort.rays += answer.rays;
        let mut beside = std::mem::take(&mut answer.beside);
        beside.retain(|(id, _)| self.state[*id as usize] == State::Open);
        for (id, ends) in &beside {
            self.decided.effort.missed += u64::from(self.task.seen.binary_search(id).is_err());
            self.see(*id, || Witness::Floats(*ends));
        }
        beside.into_iter().map(|(id, _)| id).collect()
    }

    fn see(&mut self, id: u32, witness: impl FnOnce() -> Witness) {
        self.state[id as usize] = State::Visible;
        if self.task.keep {
            self.decided.evidence.seen.push((id, witness()));
        }
    }

    fn hide(&mut self, ids: &[u32], target: Target, proofs: Vec<crate::Proof>) {
        ids.iter().for_each(|id| self.state[*id as usize] = State::Hidden);
        self.decided.effort.hidden += ids.len() as u64;
        if self.task.keep && !ids.is_empty() {
            self.decided.evidence.hidden.push(Hidden { target, triangles: ids.to_vec(), proofs });
        }
    }

    /// Leaves a triangle undecided; without a reason because it was time to stop.
    fn leave(&mut self, id: u32, reason: Option<Reason>) {
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
        self.decided.effort.open[kind] += 1;
    }

    fn finish(mut self) -> Decided {
        for (id, state) in self.state.iter().enumerate() {
            let id = id as u32;
            match state {
                State::Visible => self.decided.visible.push(id),
                State::Undecided => self.decided.undecided.push(id),
                // Whatever has area was asked about; were it not, it would not be called hidden.
                State::Open if self.task.scene.of(id).is_some() => {
                    debug_assert!(false, "triangle {id} was not asked about");
                    self.decided.undecided.push(id);
                }
                State::Open | State::Hidden => {}
            }
        }
        self.decided.evidence.seen.sort_by_key(|(id, _)| *id);
        self.decided
    }
}

/// A query's witness as it is kept: by floats where these will do.
fn witness(scene: &Occluders, cell: &Cell, id: u32, ends: &[crate::Source; 2]) -> Witness {
    let [p, q] = ends.each_ref().map(crate::polygon::rounded);
    let [min, max] = cell.corners();
    let near = p.as_vec3().clamp(min, max);
    let far = (p + (q - p) * (1.0 + BEYOND)).as_vec3();
    if far.is_finite() && shows(scene, near, far, id, &mut Vec::new()) {
        return Witness::Floats([near, far]);
    }
    Witness::Exact(Box::new(ends.each_ref().map(crate::predicates::integers)))
}
