//! Deciding everything visible from one view cell (Nirenstein 2003, section 6.2).
//!
//! Triangles that sampling has shown get a witness. The others are queried, whole boxes of the hierarchy
//! first, the largest as seen from the cell before the others.
//!
//! V(C) = I(C) ∪ V(∂C): a triangle that meets the cell is visible, and any other triangle is seen through a
//! face of the cell or not at all. A box whose faces are all hidden from all faces of the cell hides every
//! triangle in it. Boxes that contain a visible triangle are not queried. A triangle hidden from a box around
//! a group of cells is hidden from each of them, and queried once ([`crate::cells::decide_group`]). When
//! stopped, all remaining triangles are reported as undecided, so visible ⊆ V(C) ⊆ visible ∪ undecided always
//! holds.

use rayon::prelude::*;
use sightline_certificate::Witness;

use crate::cells::ask::{Asked, Item};
use crate::cells::from_cell::Found;
use crate::cells::rays;
use crate::cells::task::{Decided, Task};
use crate::cells::work::{State, Work};

/// Decides every triangle with area.
pub fn decide(task: &Task<'_>) -> Decided {
    let tree = task.scene.occluders().targets();
    let mut work = Work::new(task);
    if tree.is_empty() {
        return work.decided;
    }
    work.meeting();
    work.take_over();
    work.keep_to_listed();
    work.enclose();
    work.show();
    work.search();
    work.finish()
}

impl Work<'_> {
    /// Finds witnesses for the triangles that sampling has shown: by rays, then by queries.
    fn show(&mut self) {
        let task = self.task;
        let open = |id: &u32| {
            self.state[*id as usize] == State::Open && task.scene.occluders().is_target(*id)
        };
        let wanted: Vec<u32> = task.seen.iter().copied().filter(open).collect();
        let wanted = (&wanted[..], rays::TRIES);
        let (found, rays) = rays::witnesses(
            task.scene.occluders(),
            &self.sources,
            wanted,
            task.seed,
            task.stop,
        );
        let (wanted, _) = wanted;
        self.decided.statistics.rays = rays;
        let left: Vec<u32> = wanted
            .iter()
            .copied()
            .filter(|id| !found.contains_key(id))
            .collect();
        for (id, ends) in found {
            self.see(id, |_| Witness::Floats(ends));
        }
        let asked: Vec<Asked> = left
            .par_iter()
            .map(|id| self.ask(Item::Triangle(*id)))
            .collect();
        for mut answer in asked {
            self.show_beside(&mut answer);
            if let (Item::Triangle(_), Some(Found::Hidden(_))) = (answer.of, &answer.found) {
                self.decided.statistics.refuted += 1;
            }
            self.take(answer);
        }
    }
}
