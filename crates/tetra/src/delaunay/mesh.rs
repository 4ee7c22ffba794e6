//! The tetrahedra while points are inserted, one after another.
//!
//! Bowyer, "Computing Dirichlet tessellations", 1981, and Watson, "Computing the n-dimensional Delaunay
//! tessellation", 1981: the tetrahedra in conflict with a point are star-shaped around it; they go, and the
//! point is joined to each face of their border.

use std::cmp::Ordering;

use super::error::DelaunayError;
use super::predicates::Predicates;

/// No tetrahedron: what is across a face of the box.
pub const NONE: u32 = u32::MAX;

/// A tetrahedron of positive orientation and, for each corner, the tetrahedron across the opposite face.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) corners: [u32; 4],
    pub(super) across: [u32; 4],
}

/// The Delaunay tetrahedra of the corners of a box and the points inserted so far.
pub(super) struct Mesh<'a> {
    predicates: &'a Predicates<'a>,
    cells: Vec<Cell>,
    /// 2k: the cell conflicts with the k-th point inserted, k ≥ 1; 2k + 1: it does not; [`FREE`].
    marks: Vec<u32>,
    free: Vec<u32>,
    inserted: u32,
    /// A cell that exists; the last made. Walks start there.
    last: u32,
    /// Cells in conflict, and the faces on the border of their union. Kept to be filled again.
    conflicts: Vec<u32>,
    border: Vec<(u32, usize)>,
}

const FREE: u32 = u32::MAX;

/// The most points that [`Mesh::insert`] can take: marks are twice their count.
pub(super) const MOST_POINTS: usize = 1 << 30;

impl<'a> Mesh<'a> {
    /// The Delaunay tetrahedra of the corners of a box, which are the points `first` to `first + 7`: of all
    /// quadruples those of positive orientation that no other corner conflicts with.
    pub(super) fn of_box(predicates: &'a Predicates<'a>, first: u32) -> Self {
        let mut cells: Vec<Cell> = Vec::new();
        for bits in 0u32..1 << 8 {
            if bits.count_ones() != 4 {
                continue;
            }
            let mut chosen = (0..8).filter(|k| bits >> k & 1 == 1).map(|k| first + k);
            let mut corners: [u32; 4] = std::array::from_fn(|_| chosen.next().unwrap_or(first));
            match predicates.orient(corners) {
                Ordering::Greater => {}
                Ordering::Less => corners.swap(2, 3),
                Ordering::Equal => continue,
            }
            let mut others = (0..8).filter(|k| bits >> k & 1 == 0).map(|k| first + k);
            if others.all(|e| !predicates.conflicts(corners, e)) {
                cells.push(Cell {
                    corners,
                    across: [NONE; 4],
                });
            }
        }
        for i in 0..cells.len() {
            for k in 0..4 {
                let corners = cells[i].corners;
                let has_face =
                    |cell: &Cell| (0..4).all(|m| m == k || cell.corners.contains(&corners[m]));
                let other = cells
                    .iter()
                    .enumerate()
                    .position(|(j, cell)| j != i && has_face(cell));
                cells[i].across[k] = other.map_or(NONE, |j| j as u32);
            }
        }
        let marks = vec![0; cells.len()];
        let (free, conflicts, border) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            predicates,
            cells,
            marks,
            free,
            inserted: 0,
            last: 0,
            conflicts,
            border,
        }
    }

    /// About the memory that the cells take once they are in order.
    pub(super) fn bytes(&self) -> u64 {
        self.cells.len() as u64 * 110
    }

    /// The cells, each with its number; the numbers have gaps.
    pub(super) fn into_cells(self) -> (Vec<Cell>, Vec<bool>) {
        let alive = self.marks.iter().map(|mark| *mark != FREE).collect();
        (self.cells, alive)
    }

    /// Adds a point that is strictly inside of the box.
    ///
    /// # Errors
    ///
    /// The number of the corner that the point equals, or that there are too many tetrahedra.
    pub(super) fn insert(&mut self, point: u32) -> Result<(), Refusal> {
        let start = self.find(point);
        if let Some(&same) = self.cells[start as usize]
            .corners
            .iter()
            .find(|c| self.predicates.same(**c, point))
        {
            return Err(Refusal::Same(same));
        }
        self.inserted += 1;
        let inside = 2 * self.inserted;
        self.gather_conflicts(point, start, inside);
        for at in 0..self.border.len() {
            self.join(point, self.border[at])?;
        }
        for at in 0..self.border.len() {
            self.connect(self.border[at], inside);
        }
        for cell in &self.conflicts {
            self.marks[*cell as usize] = FREE;
        }
        self.free.extend_from_slice(&self.conflicts);
        Ok(())
    }

    /// The cell that holds a point of the box, by a walk from the last cell made. It ends: see `ties.rs`.
    fn find(&self, point: u32) -> u32 {
        let (mut at, mut from) = (self.last, NONE);
        'walk: loop {
            let cell = &self.cells[at as usize];
            for k in 0..4 {
                if cell.across[k] == from || cell.across[k] == NONE {
                    // The point is not beyond the face just passed, nor beyond a face of the box.
                    continue;
                }
                let mut corners = cell.corners;
                corners[k] = point;
                if self.predicates.orient(corners) == Ordering::Less {
                    (at, from) = (cell.across[k], at);
                    continue 'walk;
                }
            }
            return at;
        }
    }

    /// Fills `conflicts` and `border`, from a cell that holds the point. That cell is in conflict, also when
    /// the point is on its border: a strictly convex height is below its interpolation.
    fn gather_conflicts(&mut self, point: u32, start: u32, inside: u32) {
        self.conflicts.clear();
        self.border.clear();
        self.conflicts.push(start);
        self.marks[start as usize] = inside;
        let mut done = 0;
        while let Some(&at) = self.conflicts.get(done) {
            done += 1;
            let cell = self.cells[at as usize];
            for (k, &next) in cell.across.iter().enumerate() {
                if next == NONE {
                    self.border.push((at, k));
                    continue;
                }
                let mark = &mut self.marks[next as usize];
                if *mark != inside && *mark != inside + 1 {
                    let conflicts = self
                        .predicates
                        .conflicts(self.cells[next as usize].corners, point);
                    *mark = if conflicts { inside } else { inside + 1 };
                    if conflicts {
                        self.conflicts.push(next);
                    }
                }
                if *mark == inside + 1 {
                    self.border.push((at, k));
                }
            }
        }
    }

    /// Makes the cell of the point and a border face, and connects it with the cell outside. The cell in
    /// conflict then has the new cell across that face.
    fn join(&mut self, point: u32, (old, k): (u32, usize)) -> Result<(), Refusal> {
        let Cell {
            mut corners,
            across,
        } = self.cells[old as usize];
        corners[k] = point;
        let outside = across[k];
        let mut cell = Cell {
            corners,
            across: [NONE; 4],
        };
        cell.across[k] = outside;
        let new = match self.free.pop() {
            Some(new) => {
                self.cells[new as usize] = cell;
                self.marks[new as usize] = 0;
                new
            }
            None => {
                let new = u32::try_from(self.cells.len())
                    .ok()
                    .filter(|new| *new != NONE);
                self.cells.push(cell);
                self.marks.push(0);
                new.ok_or(Refusal::Full)?
            }
        };
        if outside != NONE {
            for back in &mut self.cells[outside as usize].across {
                if *back == old {
                    *back = new;
                }
            }
        }
        self.cells[old as usize].across[k] = new;
        self.last = new;
        Ok(())
    }

    /// Connects the new cell of a border face with its three neighbours among the new cells: each is found by
    /// turning around an edge of the face through the cells in conflict, up to the next border face.
    fn connect(&mut self, (old, k): (u32, usize), inside: u32) {
        let new = self.cells[old as usize].across[k];
        let corners = self.cells[old as usize].corners;
        for j in (0..4).filter(|j| *j != k) {
            if self.cells[new as usize].across[j] != NONE {
                continue;
            }
            // The face opposite to corner `cross` of the cell `at` is passed next; it has the edge and
            // `third`.
            let (mut at, mut cross, mut third) = (old, j, corners[k]);
            let other = loop {
                let next = self.cells[at as usize].across[cross];
                if self.marks[next as usize] != inside {
                    break next;
                }
                let cell = &self.cells[next as usize];
                let fresh = position(&cell.across, at);
                cross = position(&cell.corners, third);
                third = cell.corners[fresh];
                at = next;
            };
            let back = position(&self.cells[other as usize].corners, third);
            self.cells[new as usize].across[j] = other;
            self.cells[other as usize].across[back] = new;
        }
    }
}

/// Why a point was not inserted.
#[derive(Debug)]
pub(super) enum Refusal {
    /// It equals the point of this number.
    Same(u32),
    /// There are no more numbers for tetrahedra.
    Full,
}

impl Refusal {
    /// The error of the whole construction, when `point` was refused.
    pub(super) fn of(self, number: u32, point: [f32; 3]) -> DelaunayError {
        match self {
            Self::Same(other) => DelaunayError::Duplicate {
                first: other.min(number),
                second: other.max(number),
                point,
            },
            Self::Full => DelaunayError::TooManyTetrahedra,
        }
    }
}

/// Where a value that is among four is.
fn position(among: &[u32; 4], value: u32) -> usize {
    among.iter().position(|v| *v == value).unwrap_or(3)
}
