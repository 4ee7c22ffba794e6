//! Reusable memory of queries.

use super::outline::Outlines;
use super::pieces::Patch;
use super::planes::Planes;
use super::rings::Rings;
use super::sieve::Sieve;
use super::stack::{Beam, Stack, StackEntry};
use super::view::VisibleTriangles;

/// Reusable memory of queries. Each thread needs a separate value.
///
/// Queries with round cones or distances still allocate memory, and so do integers if doubles do not decide a
/// sign.
#[derive(Default)]
pub struct Scratch {
    pub(super) planes: Planes,
    pub(super) stack: Stack,
    pub(super) beam: Beam,
    pub(super) rings: Rings,
    pub(super) tally: TriangleTally,
    pub(super) entered: Entered,
    /// The numbers of the boxes that a search through boxes has yet to visit.
    pub(super) boxes: Vec<u32>,
    /// The test that excludes boxes and triangles outside of the current beam or behind its cap.
    pub(super) sieve: Sieve,
    /// A temporary list of pending entries of a beam.
    pub(super) refined: Vec<StackEntry>,
    pub(super) patch: Patch,
    pub(super) outlines: Outlines,
    /// The number of the cell that contained the last viewpoint. The search for the next viewpoint's cell
    /// starts at this cell.
    pub(super) hint: Option<u32>,
    /// The result of the last query.
    pub seen: VisibleTriangles,
}

/// The cells that a beam and its enclosing beams have entered.
#[derive(Default)]
pub(super) struct Entered {
    /// The numbers of the entered cells, in the order in which beams entered the cells.
    list: Vec<u32>,
    /// For each cell, true if the cell is in `list`.
    is_in: Vec<bool>,
}

impl Entered {
    /// Begins a query among the given number of cells.
    pub fn begin(&mut self, cells: usize) {
        self.truncate(0);
        self.is_in.resize(cells, false);
    }

    /// Removes all cells except the first `length` added cells.
    pub fn truncate(&mut self, length: usize) {
        self.list
            .drain(length..)
            .for_each(|cell| self.is_in[cell as usize] = false);
    }

    /// Returns true if the cell with this number was added.
    pub fn holds(&self, cell: u32) -> bool {
        self.is_in[cell as usize]
    }

    /// Adds the cell with this number.
    pub fn add(&mut self, cell: u32) {
        self.is_in[cell as usize] = true;
        self.list.push(cell);
    }

    /// Returns the number of added cells.
    pub fn len(&self) -> usize {
        self.list.len()
    }
}

/// The visibility, solid angle and witness of each triangle so far.
#[derive(Default)]
pub(super) struct TriangleTally {
    /// The number of the last query in which each triangle was visible.
    stamps: Vec<u64>,
    /// The number of the current query.
    query: u64,
    /// The solid angle of each triangle, in steradians. Valid for the triangles in `seen`.
    areas: Vec<f64>,
    /// For each triangle, the solid angle of its largest visible part so far, and the middle of this part.
    /// Empty before the first query that computes witnesses.
    best: Vec<(f64, Option<[f64; 3]>)>,
    /// True if this query computes witnesses.
    wanted: bool,
    /// The ids of the visible triangles so far.
    seen: Vec<u32>,
}

impl TriangleTally {
    /// Begins a query of a scene with the given number of triangles.
    pub fn begin(&mut self, triangles: usize, witnesses: bool) {
        if self.stamps.len() != triangles {
            self.stamps = vec![0; triangles];
            self.areas = vec![0.0; triangles];
            self.best.clear();
            self.query = 0;
        }
        if witnesses && self.best.is_empty() {
            self.best = vec![(0.0, None); triangles];
        }
        self.wanted = witnesses;
        self.query += 1;
        self.seen.clear();
    }

    /// Marks the triangle with this id as visible.
    pub fn see(&mut self, triangle: u32) {
        let t = triangle as usize;
        if self.stamps[t] != self.query {
            self.stamps[t] = self.query;
            self.areas[t] = 0.0;
            if let Some(best) = self.best.get_mut(t) {
                *best = (-1.0, None);
            }
            self.seen.push(triangle);
        }
    }

    /// Adds to the solid angle of a visible triangle, in steradians.
    pub fn add(&mut self, triangle: u32, area: f64) {
        self.areas[triangle as usize] += area;
    }

    /// Stores a witness of a visible part with the solid angle `area` if the part is the triangle's largest
    /// so far. Calls `way` for the direction only in this case.
    pub fn witness(&mut self, triangle: u32, area: f64, way: impl FnOnce() -> Option<[f64; 3]>) {
        let Some(best) = self.best.get_mut(triangle as usize).filter(|_| self.wanted) else {
            return;
        };
        if area > best.0 || best.1.is_none() {
            let way = way();
            if way.is_some() {
                *best = (area, way);
            }
        }
    }

    /// Writes the visible triangles, solid angles and witnesses to `seen`, in the order of triangle ids.
    pub fn finish(&mut self, witnesses: bool, seen: &mut VisibleTriangles) {
        self.seen.sort_unstable();
        seen.visible.clear();
        seen.visible.extend_from_slice(&self.seen);
        seen.areas.clear();
        seen.areas
            .extend(self.seen.iter().map(|t| self.areas[*t as usize]));
        seen.witnesses.clear();
        if witnesses {
            seen.witnesses
                .extend(self.seen.iter().map(|t| self.best[*t as usize].1));
        }
    }
}
