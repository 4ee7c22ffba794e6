//! Everything visible from one view cell, decided (thesis §6.2): what sampling has shown gets a witness, the rest is asked
//! about, whole boxes first, the largest as seen from the cell before the others.
//!
//! V(C) = I(C) ∪ V(∂C): what meets the cell is visible, everything else is seen through a face of the cell or not at all. A box whose
//! faces are all hidden from all faces of the cell hides everything in it. Boxes that hold something visible are not asked about.
//! Stopped at any time, what is not decided is said to be undecided, so visible ⊆ V(C) ⊆ visible ∪ undecided always.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use rayon::prelude::*;
use sightline_scene::{Aabb, Triangle, overlap};

use crate::bvh::Below;
use crate::cell::{Cell, Found, faces_towards, from_cell};
use crate::effort::Effort;
use crate::evidence::{Evidence, Hidden, Target, Witness};
use crate::occluder::Occluders;
use crate::polygon::Polygon;
use crate::query::{Cost, Limits, Reason};
use crate::rays;
use crate::segment::shows;
use crate::surface::Hides;

/// Nodes asked about at a time, in parallel: enough to keep a few cores busy, few enough to go by size.
const BATCH: usize = 32;
/// So many open triangles are asked about one by one.
const FEW: u32 = 2;
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
    /// When a single query gives up.
    pub limits: Limits,
    /// Seed of the rays.
    pub seed: u64,
    /// Whether to keep witnesses and proofs.
    pub keep: bool,
    /// Asked now and then whether to stop with what there is.
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
    let mut work = Work {
        task,
        state: vec![State::Open; task.scene.len()],
        halves: Vec::new(),
        decided: Decided::default(),
    };
    if tree.is_empty() {
        return work.decided;
    }
    work.meeting();
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

/// A node or a triangle that is still to be asked about, by how large it looks.
#[derive(PartialEq)]
struct Doubt {
    size: f64,
    of: Item,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Item {
    Node(u32),
    Triangle(u32),
}

impl Eq for Doubt {}

impl Ord for Doubt {
    fn cmp(&self, o: &Self) -> Ordering {
        self.size.total_cmp(&o.size).then(o.of.cmp(&self.of))
    }
}

impl PartialOrd for Doubt {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}

/// What was found out about an item.
struct Asked {
    of: Item,
    found: Option<Found>,
    cost: Cost,
}

impl Work<'_> {
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
        for answer in asked {
            if let (Item::Triangle(_), Some(Found::Hidden(_))) = (answer.of, &answer.found) {
                self.decided.effort.refuted += 1;
            }
            self.take(answer);
        }
    }

    /// Goes through the hierarchy, from what looks largest.
    fn search(&mut self) {
        let tree = self.task.scene.hierarchy();
        // Whether something below a node is visible, and how much is open; children come after their parents.
        let mut below = vec![(false, 0u32); tree.len()];
        for node in (0..tree.len() as u32).rev() {
            below[node as usize] = match tree.below(node) {
                Below::Nodes(children) => {
                    let [(v, n), (w, m)] = children.map(|c| below[c as usize]);
                    (v || w, n + m)
                }
                Below::Items(items) => {
                    items.iter().fold((false, 0), |(v, n), t| match self.state[*t as usize] {
                        State::Visible => (true, n),
                        State::Open => (v, n + 1),
                        _ => (v, n),
                    })
                }
            };
        }
        let mut doubts = BinaryHeap::new();
        let mut batch: Vec<Item> = Vec::new();
        let mut expand = vec![0u32];
        loop {
            // What needs no query is taken apart at once.
            while let Some(node) = expand.pop() {
                match tree.below(node) {
                    Below::Nodes(children) => {
                        for child in children {
                            let (visible, open) = below[child as usize];
                            if open == 0 {
                                continue;
                            }
                            // A box has more faces than a triangle or two.
                            if visible || open <= FEW || self.task.cell.touches(tree.bounds(child)) {
                                expand.push(child);
                            } else {
                                doubts.push(self.doubt(Item::Node(child)));
                            }
                        }
                    }
                    Below::Items(items) => {
                        let open = items.iter().filter(|t| self.state[**t as usize] == State::Open);
                        doubts.extend(open.map(|t| self.doubt(Item::Triangle(*t))));
                    }
                }
            }
            batch.clear();
            while batch.len() < BATCH {
                let Some(doubt) = doubts.pop() else { break };
                batch.push(doubt.of);
            }
            if batch.is_empty() {
                break;
            }
            let answers: Vec<Asked> = batch.par_iter().with_max_len(1).map(|item| self.ask(*item)).collect();
            for answer in answers {
                if let (Item::Node(node), false) = (answer.of, matches!(answer.found, Some(Found::Hidden(_))))
                {
                    // A single triangle is asked about as such, and nothing at all any more once it is time to stop.
                    if answer.found.is_some() {
                        expand.push(node);
                    } else {
                        self.each_below(node, |work, id| work.leave(id, None));
                    }
                    self.decided.effort.cost += answer.cost;
                    self.decided.effort.queries += u64::from(answer.found.is_some());
                    continue;
                }
                self.take(answer);
            }
        }
    }

    fn doubt(&self, of: Item) -> Doubt {
        let [min, max] = match of {
            Item::Node(node) => self.task.scene.hierarchy().bounds(node),
            Item::Triangle(id) => {
                let [a, b, c] = *self.task.scene.triangle(id);
                [a.min(b).min(c), a.max(b).max(c)]
            }
        };
        Doubt { size: self.task.cell.size_of(min, max), of }
    }

    /// Asks about one item; nothing is found when it is time to stop.
    fn ask(&self, of: Item) -> Asked {
        let mut cost = Cost::default();
        if (self.task.stop)() {
            return Asked { of, found: None, cost };
        }
        let targets = match of {
            Item::Node(node) => {
                let [min, max] = self.task.scene.hierarchy().bounds(node);
                faces_towards(min, max, self.task.cell)
            }
            Item::Triangle(id) => {
                Polygon::triangle(self.task.scene.triangle(id).map(|v| v.as_dvec3())).into_iter().collect()
            }
        };
        let hidden = self.hidden_half(of);
        let found =
            from_cell(self.task.scene, self.task.cell, (&targets, hidden), &self.task.limits, &mut cost);
        (self.task.asked)();
        Asked { of, found: Some(found), cost }
    }

    /// The side of its plane from which a triangle is known to be hidden.
    fn hidden_half(&self, of: Item) -> Option<Ordering> {
        let Item::Triangle(id) = of else { return None };
        self.halves.binary_search_by_key(&id, |h| h.0).ok().map(|at| self.halves[at].1)
    }

    /// Takes up an answer that decides.
    fn take(&mut self, Asked { of, found, cost }: Asked) {
        self.decided.effort.cost += cost;
        self.decided.effort.queries += u64::from(found.is_some());
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
            (Item::Node(_), _) => {}
        }
    }

    fn each_below(&mut self, node: u32, mut f: impl FnMut(&mut Self, u32)) {
        let tree = self.task.scene.hierarchy();
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match tree.below(node) {
                Below::Nodes(children) => open.extend(children),
                Below::Items(items) => items.iter().for_each(|id| f(self, *id)),
            }
        }
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
            None => 0,
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
                // Whatever has area was asked about.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubts_are_ordered_by_size_and_then_by_number() {
        let doubt = |size, of| Doubt { size, of };
        let mut heap = BinaryHeap::from([
            doubt(1.0, Item::Triangle(3)),
            doubt(2.0, Item::Node(9)),
            doubt(2.0, Item::Node(4)),
        ]);
        let order: Vec<Item> = std::iter::from_fn(|| heap.pop().map(|d| d.of)).collect();
        assert_eq!(order, [Item::Node(4), Item::Node(9), Item::Triangle(3)]);
    }
}
