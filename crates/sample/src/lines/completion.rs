//! Completion: the likely items of a cell, on which its missed sight lines most likely end.
//!
//! When sampling ends, half to three quarters of the missed lines end on candidates ([`super::candidates`]).
//! The expected number of missed lines that end on a candidate grows with the square root of its fraction of
//! the sphere, because uniform lines have already found most visible triangles with a large fraction. It also
//! grows with the number of faces through which neighbouring cells see the candidate, and with the number of
//! adjacent triangles that the cell sees (`docs/experiments/completion.md`).
//!
//! Likely items have no witness. A set lists them as undecided.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use sightline_scene::TriangleId;

use super::block::Block;
use super::candidates::Candidate;
use super::likely_items::{Completion, LikelyItem, SEEN_PER_LIKELY};

/// The missed fraction with the likely items as a fraction of the missed fraction without them. Measured as
/// 0.45 to 0.6 for triangles.
const LEFT_AFTER_COMPLETION: f64 = 0.6;

impl<'a> Block<'a> {
    /// Lets [`Self::complete_all`] determine likely items, and lets sampling end at the error before
    /// completion. `duplicates` are the classes of triangles with the same three vertices.
    ///
    /// A block of one cell has no candidates, so the function has no effect there.
    pub fn enable_completion(&mut self, duplicates: &'a [Vec<u32>]) {
        if self.table.active().len() < 2 {
            return;
        }
        let classes = (0..).zip(duplicates);
        let class = classes.flat_map(|(class, members)| members.iter().map(move |t| (*t, class)));
        self.completion = Some(Completion {
            duplicates,
            class: class.collect(),
            likely: Vec::new(),
        });
    }

    /// Returns the expected error without likely items at which a cell is finished for a target error.
    ///
    /// The factor was measured for triangles, so clusters and objects have none.
    pub(super) fn error_before_completion(&self, target: f64) -> f64 {
        let has_triangles =
            !self.inputs.rows.are_finer() && self.inputs.rows.of_triangles().is_empty();
        match self.completion {
            Some(_) if has_triangles => target / LEFT_AFTER_COMPLETION,
            _ => target,
        }
    }

    /// Determines the likely items of all cells with viewpoints from the state of the last barrier. Without
    /// completion, does nothing.
    pub fn complete_all(&mut self) {
        let all = self.table.active();
        self.complete(&all);
    }

    /// Determines the likely items of each of `cells` from the state of the last barrier, and replaces
    /// the items of earlier calls. Without completion, does nothing.
    ///
    /// All cells together have at most one likely item for [`SEEN_PER_LIKELY`] seen ones.
    pub(super) fn complete(&mut self, cells: &[usize]) {
        let Some(mut completion) = self.completion.take() else {
            return;
        };
        completion.likely.resize(self.table.cells.len(), Vec::new());
        cells
            .iter()
            .for_each(|cell| completion.likely[*cell].clear());
        let others: usize = completion.likely.iter().map(Vec::len).sum();
        let seen = self.table.seen_items(&self.table.active()) as usize;
        let limit = (seen / SEEN_PER_LIKELY).saturating_sub(others);
        let lists = self.candidates(cells, &self.least_parts(cells));
        let mut ranked: Vec<(f32, usize, u32)> = cells
            .par_iter()
            .zip(lists)
            .flat_map_iter(|(cell, list)| {
                let items = self.ranked_items(*cell, &list, &completion);
                items.into_iter().map(|(item, rank)| (rank, *cell, item))
            })
            .collect();
        ranked.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        // Duplicates have the same rank and are drawn together.
        let same = |a: &(f32, usize, u32), b: &(f32, usize, u32)| (a.0, a.1) == (b.0, b.1);
        let mut count = limit.min(ranked.len());
        while count > 0 && count < ranked.len() && same(&ranked[count - 1], &ranked[count]) {
            count -= 1;
        }
        for (rank, cell, item) in ranked.drain(..count) {
            completion.likely[cell].push(LikelyItem { item, rank });
        }
        completion
            .likely
            .par_iter_mut()
            .for_each(|items| items.sort_unstable_by_key(|likely| likely.item));
        self.completion = Some(completion);
    }

    /// Returns the items of a cell's candidates with their ranks, by ascending item. An item has the rank of
    /// its highest candidate.
    fn ranked_items(
        &self,
        cell: usize,
        list: &[Candidate],
        completion: &Completion<'_>,
    ) -> Vec<(u32, f32)> {
        let rows = self.inputs.rows;
        let mut items = Vec::with_capacity(list.len());
        for candidate in list {
            let rank = self.rank(cell, candidate);
            if rank == 0.0 {
                continue;
            }
            match completion.class.get(&candidate.triangle) {
                Some(class) => items.extend(
                    completion.duplicates[*class as usize]
                        .iter()
                        .map(|t| (rows.item(TriangleId(*t)), rank)),
                ),
                None => items.push((rows.item(TriangleId(candidate.triangle)), rank)),
            }
        }
        items.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        items.dedup_by_key(|(item, _)| *item);
        items
    }

    /// Returns the rank of a candidate of a cell; 0 if the candidate cannot show in the cell.
    fn rank(&self, cell: usize, candidate: &Candidate) -> f32 {
        if !self.can_show(cell, candidate.triangle) {
            return 0.0;
        }
        let faces = self.faces_that_show(cell, candidate.triangle);
        // A candidate of an unseen cluster or object need not be adjacent to a seen triangle.
        let beside = self.seen_neighbours(cell, candidate.triangle).max(1);
        candidate.part.sqrt() * (faces * beside) as f32
    }

    /// Returns false if a triangle is farther from a cell than lines reach, or turns its hidden side to the
    /// whole cell.
    fn can_show(&self, cell: usize, triangle: u32) -> bool {
        let cell = &self.table.cells[cell];
        let (low, high) = (cell.lo, cell.lo + cell.size);
        let scene = self.inputs.scene;
        let bounds = scene.triangles()[triangle as usize].bounds();
        let apart = (bounds.min - high).max(low - bounds.max).max(Vec3::ZERO);
        if apart.length() > self.inputs.sight.far() {
            return false;
        }
        let front = scene.front(TriangleId(triangle));
        if front == DVec3::ZERO {
            return true;
        }
        let at = scene.triangles()[triangle as usize].v[0].as_dvec3();
        let highest = DVec3::select(front.cmpgt(DVec3::ZERO), high.as_dvec3(), low.as_dvec3());
        front.dot(highest - at) > 0.0
    }

    /// Returns true if a triangle's item is a likely item of a cell.
    pub(super) fn is_likely(&self, cell: usize, triangle: u32) -> bool {
        let item = self.inputs.rows.item(TriangleId(triangle));
        let likely = self.completion.as_ref().and_then(|c| c.likely.get(cell));
        likely.is_some_and(|items| items.binary_search_by_key(&item, |l| l.item).is_ok())
    }

    /// Returns the likely items of each cell, in the order of `CellGrid::each` and by ascending item. A cell
    /// may have seen some of them since.
    pub fn likely_items(&self) -> Vec<Vec<LikelyItem>> {
        let mut likely = self
            .completion
            .as_ref()
            .map_or_else(Vec::new, |completion| completion.likely.clone());
        likely.resize(self.table.cells.len(), Vec::new());
        likely
    }
}
