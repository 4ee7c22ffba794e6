//! Which cells of the division see the cells of a tile, decided exactly where sampling has joined none.
//!
//! From each cell the division's tree is walked from its root. A box of the tree around cells that sampling
//! has not joined with the cell is the target of one query: when it is hidden, so is every cell in it. A pair
//! is decided by the tile of its cell with the lower number. Adaptive trees are left undecided: a tile does
//! not know the cells of the other tiles.

use std::ops::ControlFlow;

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::HiddenBox;
use sightline_exact::{Cell, Cost, ExactScene, Found, box_from_cell};
use sightline_model::{CellSets, PairTable};
use sightline_numbers::Aabb;
use sightline_viewcells::{CellBox, Division, UNITS_PER_CELL};

use crate::deciding::Deciding;

/// Part of a distance that covers the rounding of its computation in doubles.
const MARGIN: f64 = 1e-12;

/// What is found from one cell.
#[derive(Default)]
struct Decided {
    hidden: Vec<u32>,
    seen: Vec<u32>,
    proofs: Vec<HiddenBox>,
}

/// Decides the pairs of a tile's cells, adds them to `sets`, and returns the proofs of each cell.
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
    /// The number of a grid cell.
    fn number(&self, at: &CellBox) -> u32 {
        let [x, y, z] = at.lo.map(|u| u / UNITS_PER_CELL);
        (z * self.sides[1] + y) * self.sides[0] + x
    }

    /// The numbers of the grid cells in a box.
    fn numbers(&self, of: &CellBox) -> impl Iterator<Item = u32> + use<> {
        let [xs, ys, zs] = [0, 1, 2].map(|a| of.lo[a] / UNITS_PER_CELL..of.hi[a] / UNITS_PER_CELL);
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
        // A stop leaves the rest undecided.
        let _ = self.below(
            &self
                .deciding
                .scope
                .division
                .root(&self.deciding.scope.lattice),
            0,
            (at, own, cell),
            &mut out,
        );
        out
    }

    /// Whether every point of a box is farther from every point of another one than the job's lines reach.
    fn is_beyond(&self, a: &CellBox, b: &CellBox) -> bool {
        let gap = |a: [f64; 2], b: [f64; 2]| (b[0] - a[1]).max(a[0] - b[1]).max(0.0);
        self.deciding
            .far
            .is_some_and(|far| self.distance(a, b, gap) > far * (1.0 + MARGIN))
    }

    /// Whether all their points are so near to each other that lines between them are not ended.
    fn is_within(&self, a: &CellBox, b: &CellBox) -> bool {
        let most = |a: [f64; 2], b: [f64; 2]| (b[1] - a[0]).max(a[1] - b[0]);
        self.deciding
            .far
            .is_none_or(|far| self.distance(a, b, most) < far * (1.0 - MARGIN))
    }

    /// The length of the vector whose components `of` gives from the sides of two boxes along each axis.
    fn distance(&self, a: &CellBox, b: &CellBox, of: impl Fn([f64; 2], [f64; 2]) -> f64) -> f64 {
        let [a, b] = [a, b].map(|of| of.world(&self.deciding.scope.lattice));
        let sides =
            |(min, max): (Vec3, Vec3), axis: usize| [f64::from(min[axis]), f64::from(max[axis])];
        (0..3)
            .map(|axis| of(sides(a, axis), sides(b, axis)))
            .map(|x| x * x)
            .sum::<f64>()
            .sqrt()
    }

    fn below(
        &self,
        of: &CellBox,
        depth: u32,
        (at, own, cell): (&CellBox, u32, Cell),
        out: &mut Decided,
    ) -> ControlFlow<()> {
        if (self.stop)() {
            return ControlFlow::Break(());
        }
        let (mut any, mut all) = (false, true);
        for other in self.numbers(of) {
            let known = other == own || self.seen.has(own, other);
            // Pairs with lower cells are decided elsewhere, and pairs without viewpoints nowhere.
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
            .split(&self.deciding.scope.lattice, of, depth);
        let (min, max) = of.world(&self.deciding.scope.lattice);
        if all && self.is_beyond(at, of) {
            out.hidden.extend(self.numbers(of));
            return ControlFlow::Continue(());
        }
        if all {
            let mut cost = Cost::default();
            let limits = (&self.deciding.limits, self.stop as &dyn Fn() -> bool);
            let bounds = Aabb { min, max };
            match box_from_cell(self.scene.occluders(), cell, bounds, limits, &mut cost) {
                Some(Found::Hidden(proofs)) => {
                    out.hidden.extend(self.numbers(of));
                    if self.deciding.certificates {
                        out.proofs.push(HiddenBox { bounds, proofs });
                    }
                    return ControlFlow::Continue(());
                }
                // A segment longer than the job's distance shows nothing.
                Some(Found::Visible(_)) if split.is_none() && self.is_within(at, of) => {
                    out.seen.push(self.number(of));
                }
                Some(Found::Visible(_) | Found::Undecided(_)) | None => {}
            }
        }
        if let Some(split) = split {
            for child in of.children(split) {
                self.below(&child, depth + 1, (at, own, cell), out)?;
            }
        }
        ControlFlow::Continue(())
    }
}
