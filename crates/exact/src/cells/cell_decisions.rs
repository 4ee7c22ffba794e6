//! The decision of all triangles for one view cell (Nirenstein 2003, section 6.2).
//!
//! First, the search looks for witnesses of the triangles that sampling has shown. Then it queries the other
//! triangles: whole boxes of the hierarchy come first, in descending order of their size as seen from the
//! cell.
//!
//! V(C) = I(C) ∪ V(∂C): a triangle that meets the cell is visible, and any other triangle is visible only
//! through a face of the cell. A box whose faces are all hidden from all faces of the cell hides every
//! triangle in it. The search does not query boxes that contain a visible triangle. A triangle hidden from a
//! box around a group of cells is hidden from each of these cells, so one query decides it for all of them
//! ([`crate::cells::decide_group`]). If the caller stops the search, all remaining triangles are undecided,
//! so visible ⊆ V(C) ⊆ visible ∪ undecided always holds.

use rayon::prelude::*;
use sightline_certificate::Witness;
use sightline_scene::TriangleId;

use crate::cells::cell_queries::{ItemAnswer, QueryItem};
use crate::cells::from_cell::FromCellAnswer;
use crate::cells::rays;
use crate::cells::task::{CellDecisions, CellTask};
use crate::cells::work::{CellWork, TriangleState};

/// Decides, for one cell, every triangle with area that can be in a set of visible triangles.
pub fn decide(task: &CellTask<'_>) -> CellDecisions {
    let tree = task.scene.occluders().targets();
    let mut work = CellWork::new(task);
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

impl CellWork<'_> {
    /// Searches for witnesses of the triangles that sampling has shown, first by rays, then by queries.
    fn show(&mut self) {
        let task = self.task;
        let open = |id: &u32| {
            self.state[*id as usize] == TriangleState::Open
                && task.scene.occluders().is_target(TriangleId(*id))
        };
        let wanted: Vec<u32> = task.seen.iter().copied().filter(open).collect();
        let (found, rays) = rays::witnesses(
            task.scene.occluders(),
            &self.sources,
            &wanted,
            rays::TRIES,
            task.seed,
            task.stop,
        );
        self.decided.statistics.rays = rays;
        let left: Vec<u32> = wanted
            .iter()
            .copied()
            .filter(|id| !found.contains_key(id))
            .collect();
        for (id, ends) in found {
            self.see(id, |_| Witness::Floats(ends));
        }
        let asked: Vec<ItemAnswer> = left
            .par_iter()
            .map(|id| self.ask(QueryItem::Triangle(*id)))
            .collect();
        for mut answer in asked {
            self.show_beside(&mut answer);
            if let (QueryItem::Triangle(_), Some(FromCellAnswer::Hidden(_))) =
                (answer.item, &answer.found)
            {
                self.decided.statistics.refuted += 1;
            }
            self.take(answer);
        }
    }
}
