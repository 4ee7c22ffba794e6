//! The pairs of a tile's cells with other cells of the division, decided exactly unless sampling joined them.
//!
//! For each cell, the division's tree is traversed from its root. A box of the tree around cells that
//! sampling has not joined with the cell is the target of one query: if the box is hidden, so is every cell
//! in it. The tile of the cell with the lower number decides a pair. Adaptive trees remain undecided, because
//! a tile does not have the cells of the other tiles.

use std::ops::ControlFlow;

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::HiddenBox;
use sightline_exact::{Cell, ExactScene, FromCellAnswer, QueryCost, box_from_cell};
use sightline_model::{CellSets, PairTable};
use sightline_numbers::Aabb;
use sightline_viewcells::{CellBox, Division, UNITS_PER_CELL};

use crate::deciding::Deciding;

/// The fraction of a distance that covers the rounding of its computation in doubles.
const MARGIN: f64 = 1e-12;

/// The decided pairs of one cell: hidden cells, seen cells, and the proofs of hidden boxes.
#[derive(Default)]
struct Decided {
    hidden: Vec<u32>,
    seen: Vec<u32>,
    proofs: Vec<HiddenBox>,
}

/// A cell from which other cells are queried.
struct FromCell<'a> {
    at: &'a CellBox,
    /// The number of the cell in the division's grid.
    own: u32,
    cell: Cell,
}

/// Decides the pairs of a tile's cells and adds them to `sets`. Returns, for each cell, the hidden boxes with
/// their proofs.
pub fn decide(
    deciding: &Deciding<'_>,
    cells: &[(CellBox, Cell)],
    sets: &mut CellSets,
    scene: &ExactScene,
    stop: &(dyn Fn() -> bool + Sync),
) -> Vec<Vec<HiddenBox>> {
    let nothing = || cells.iter().map(|_| Vec::new()).collect();
    let Some(pairs) = &mut sets.pairs else {
        return nothing();
    };
    let mut hidden = PairTable::empty(pairs.seen.cells());
    let Division::Grid(sides) = deciding.scope.division else {
        pairs.hidden = Some(hidden);
        return nothing();
    };
    let walk = Walk {
        deciding,
        sides,
        seen: &pairs.seen,
        scene,
        stop,
    };
    let found: Vec<Decided> = cells
        .par_iter()
        .with_max_len(1)
        .map(|(at, cell)| walk.from(at, *cell))
        .collect();
    let mut proofs = Vec::with_capacity(found.len());
    for ((at, _), decided) in cells.iter().zip(found) {
        let own = walk.number(at);
        decided
            .hidden
            .iter()
            .for_each(|other| hidden.insert(own, *other));
        proofs.push((own, decided.seen, decided.proofs));
    }
    let mut out = Vec::with_capacity(proofs.len());
    for (own, seen, proofs) in proofs {
        seen.into_iter()
            .for_each(|other| pairs.seen.insert(own, other));
        out.push(proofs);
    }
    pairs.hidden = Some(hidden);
    out
}

struct Walk<'a> {
    deciding: &'a Deciding<'a>,
    sides: [u32; 3],
    seen: &'a PairTable,
    scene: &'a ExactScene,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl Walk<'_> {
    /// Returns the number of a grid cell.
    fn number(&self, at: &CellBox) -> u32 {
        let [x, y, z] = at.lo.map(|u| u / UNITS_PER_CELL);
        (z * self.sides[1] + y) * self.sides[0] + x
    }

    /// Returns the numbers of the grid cells in a box.
    fn numbers(&self, cells: &CellBox) -> impl Iterator<Item = u32> + use<> {
        let [xs, ys, zs] =
            [0, 1, 2].map(|a| cells.lo[a] / UNITS_PER_CELL..cells.hi[a] / UNITS_PER_CELL);
        let [nx, ny, _] = self.sides;
        zs.flat_map(move |z| {
            let xs = xs.clone();
            ys.clone()
                .flat_map(move |y| xs.clone().map(move |x| (z * ny + y) * nx + x))
        })
    }

    fn is_reached(&self, cell: u32) -> bool {
        let mask = &self.deciding.scope.mask;
        mask.as_ref()
            .is_none_or(|mask| mask.parts(cell as usize) != 0)
    }

    fn from(&self, at: &CellBox, cell: Cell) -> Decided {
        let mut out = Decided::default();
        let own = self.number(at);
        // If the work is stopped, the remaining pairs are undecided.
        let _ = self.below(
            &self
                .deciding
                .scope
                .division
                .root(&self.deciding.scope.lattice),
            0,
            &FromCell { at, own, cell },
            &mut out,
        );
        out
    }

    /// Returns true if the minimum distance between two boxes exceeds the length of the job's sight lines.
    fn is_beyond(&self, a: &CellBox, b: &CellBox) -> bool {
        let gap = |a: [f64; 2], b: [f64; 2]| (b[0] - a[1]).max(a[0] - b[1]).max(0.0);
        self.deciding
            .far
            .is_some_and(|far| self.distance(a, b, gap) > far * (1.0 + MARGIN))
    }

    /// Returns true if no line between two boxes is longer than the job's sight lines.
    fn is_within(&self, a: &CellBox, b: &CellBox) -> bool {
        let most = |a: [f64; 2], b: [f64; 2]| (b[1] - a[0]).max(a[1] - b[0]);
        self.deciding
            .far
            .is_none_or(|far| self.distance(a, b, most) < far * (1.0 - MARGIN))
    }

    /// Computes the length of a vector. Its component on each axis is `axis_distance` of the ranges of two
    /// boxes.
    fn distance(
        &self,
        a: &CellBox,
        b: &CellBox,
        axis_distance: impl Fn([f64; 2], [f64; 2]) -> f64,
    ) -> f64 {
        let [a, b] = [a, b].map(|cell| cell.world(&self.deciding.scope.lattice));
        let sides =
            |(min, max): (Vec3, Vec3), axis: usize| [f64::from(min[axis]), f64::from(max[axis])];
        (0..3)
            .map(|axis| axis_distance(sides(a, axis), sides(b, axis)))
            .map(|x| x * x)
            .sum::<f64>()
            .sqrt()
    }

    fn below(
        &self,
        target: &CellBox,
        depth: u32,
        from: &FromCell<'_>,
        out: &mut Decided,
    ) -> ControlFlow<()> {
        let FromCell { at, own, cell } = *from;
        if (self.stop)() {
            return ControlFlow::Break(());
        }
        let (mut any, mut all) = (false, true);
        for other in self.numbers(target) {
            let known = other == own || self.seen.has(own, other);
            // The tile of the lower cell decides a pair. A pair of cells without viewpoints is never decided.
            any |= !known && other > own && (self.is_reached(own) || self.is_reached(other));
            all &= !known;
        }
        if !any {
            return ControlFlow::Continue(());
        }
        let split = self
            .deciding
            .scope
            .division
            .split(&self.deciding.scope.lattice, target, depth);
        let (min, max) = target.world(&self.deciding.scope.lattice);
        if all && self.is_beyond(at, target) {
            out.hidden.extend(self.numbers(target));
            return ControlFlow::Continue(());
        }
        if all {
            let mut cost = QueryCost::default();
            let limits = &self.deciding.limits;
            let bounds = Aabb { min, max };
            match box_from_cell(
                self.scene.occluders(),
                cell,
                bounds,
                limits,
                self.stop,
                &mut cost,
            ) {
                Some(FromCellAnswer::Hidden(proofs)) => {
                    out.hidden.extend(self.numbers(target));
                    if self.deciding.certificates {
                        out.proofs.push(HiddenBox { bounds, proofs });
                    }
                    return ControlFlow::Continue(());
                }
                // A segment longer than the job's distance does not show that the box is visible.
                Some(FromCellAnswer::Visible(_))
                    if split.is_none() && self.is_within(at, target) =>
                {
                    out.seen.push(self.number(target));
                }
                Some(FromCellAnswer::Visible(_) | FromCellAnswer::Undecided(_)) | None => {}
            }
        }
        if let Some(split) = split {
            for child in target.children(split) {
                self.below(&child, depth + 1, from, out)?;
            }
        }
        ControlFlow::Continue(())
    }
}
