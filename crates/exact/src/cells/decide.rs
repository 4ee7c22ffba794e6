//! Everything visible from one view cell, decided (thesis §6.2): what sampling has shown gets a witness, the rest is asked
//! about ([`search`]), whole boxes first, the largest as seen from the cell before the others.
//!
//! V(C) = I(C) ∪ V(∂C): what meets the cell is visible, everything else is seen through a face of the cell or not at all. A box whose
//! faces are all hidden from all faces of the cell hides everything in it. Boxes that hold something visible are not asked about.
//! What is hidden from a box around several cells is hidden from each, and asked about once ([`together`]).
//! Stopped at any time, what is not decided is said to be undecided, so visible ⊆ V(C) ⊆ visible ∪ undecided always.

use rayon::prelude::*;

use crate::cells::ask::{Asked, Item};
use crate::cells::from_cell::Found;
use crate::cells::rays;
use crate::cells::task::{Decided, Task};
use crate::cells::work::{State, Work};
use crate::evidence::Witness;

/// Decides every triangle with area.
pub fn decide(task: &Task<'_>) -> Decided {
    let tree = task.scene.occluders().hierarchy();
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

impl Work<'_> {
    /// Finds witnesses for what sampling has shown: by rays, then by queries.
    fn show(&mut self) {
        let task = self.task;
        let open =
            |id: &u32| self.state[*id as usize] == State::Open && task.scene.occluders().of(*id).is_some();
        let wanted: Vec<u32> = task.seen.iter().copied().filter(open).collect();
        let (found, rays) =
            rays::witnesses(task.scene.occluders(), &task.cell, &wanted, task.seed, task.stop);
        self.decided.statistics.rays = rays;
        let left: Vec<u32> = wanted.into_iter().filter(|id| !found.contains_key(id)).collect();
        for (id, ends) in found {
            self.see(id, || Witness::Floats(ends));
        }
        let asked: Vec<Asked> = left.par_iter().map(|id| self.ask(Item::Triangle(*id))).collect();
        for mut answer in asked {
            self.show_beside(&mut answer);
            if let (Item::Triangle(_), Some(Found::Hidden(_))) = (answer.of, &answer.found) {
                self.decided.statistics.refuted += 1;
            }
            self.take(answer);
        }
    }
}
