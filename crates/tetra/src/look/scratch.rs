//! Memory that queries use again.

use super::outline::Outlines;
use super::pieces::Patch;
use super::planes::Planes;
use super::rings::Rings;
use super::sieve::Sieve;
use super::stack::{Beam, Entry, Stack};
use super::view::Seen;

/// Memory that queries use again: one for each thread. Round cones and distances still allocate, and so do
/// integers where doubles do not decide a sign.
#[derive(Default)]
pub struct Scratch {
    pub(super) planes: Planes,
    pub(super) stack: Stack,
    pub(super) beam: Beam,
    pub(super) rings: Rings,
    pub(super) tally: Tally,
    pub(super) entered: Entered,
    /// Boxes that are open, in any search among them.
    pub(super) boxes: Vec<u32>,
    /// What the beam that is followed does not meet.
    pub(super) sieve: Sieve,
    /// A list of boxes that is made on the way.
    pub(super) refined: Vec<Entry>,
    pub(super) patch: Patch,
    pub(super) outlines: Outlines,
    /// The cell of the last viewpoint, where the search for the next one begins.
    pub(super) hint: Option<u32>,
    /// The answer of the last query.
    pub seen: Seen,
}

/// The cells that a beam has entered, and those of which it is a part.
#[derive(Default)]
pub(super) struct Entered {
    list: Vec<u32>,
    is_in: Vec<bool>,
}

impl Entered {
    /// Begins a query among so many cells.
    pub fn begin(&mut self, cells: usize) {
        self.truncate(0);
        self.is_in.resize(cells, false);
    }

    /// Forgets all but the first that were added.
    pub fn truncate(&mut self, length: usize) {
        self.list
            .drain(length..)
            .for_each(|cell| self.is_in[cell as usize] = false);
    }

    /// Whether a cell was added.
    pub fn holds(&self, cell: u32) -> bool {
        self.is_in[cell as usize]
    }

    /// Adds a cell.
    pub fn add(&mut self, cell: u32) {
        self.is_in[cell as usize] = true;
        self.list.push(cell);
    }

    /// How many were added.
    pub fn len(&self) -> usize {
        self.list.len()
    }
}

/// What is known of each triangle.
#[derive(Default)]
pub(super) struct Tally {
    /// The number of the query that last saw each triangle.
    stamps: Vec<u64>,
    query: u64,
    areas: Vec<f64>,
    /// The largest part so far, and its middle.
    best: Vec<(f64, Option<[f64; 3]>)>,
    /// Whether this query wants witnesses.
    wanted: bool,
    seen: Vec<u32>,
}

impl Tally {
    /// Begins a query of a scene with so many triangles.
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

    /// Counts a triangle as seen.
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

    /// Adds to the solid angle of a triangle that is seen.
    pub fn add(&mut self, triangle: u32, area: f64) {
        self.areas[triangle as usize] += area;
    }

    /// Keeps a witness if its part is the largest so far. The direction is computed only then.
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

    /// Writes the answer, in the order of ids.
    pub fn finish(&mut self, witnesses: bool, seen: &mut Seen) {
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
