//! Incremental construction of Delaunay tetrahedra, one point at a time.
//!
//! The method is from Bowyer, "Computing Dirichlet tessellations", 1981, and Watson, "Computing the
//! n-dimensional Delaunay tessellation", 1981. The tetrahedra in conflict with a point form a star-shaped
//! region around the point. The construction removes these tetrahedra, and connects the point to each face of
//! the region's border.

use std::cmp::Ordering;

use super::error::DelaunayError;
use super::predicates::Predicates;

/// Marker for a missing neighbour of a tetrahedron, across a face on the border of the box.
pub const NONE: u32 = u32::MAX;

/// A tetrahedron of positive orientation, with its neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// The corners, as point numbers.
    pub(super) corners: [u32; 4],
    /// For each corner, the number of the tetrahedron across the opposite face, or [`NONE`].
    pub(super) across: [u32; 4],
}

/// The Delaunay tetrahedra of the corners of a box and the points inserted so far.
pub(super) struct Mesh<'a> {
    predicates: &'a Predicates<'a>,
    cells: Vec<Cell>,
    /// The mark of each cell. For the k-th inserted point, k ≥ 1, 2k marks a cell in conflict and 2k + 1 a
    /// cell without conflict. [`FREE`] marks a removed cell.
    marks: Vec<u32>,
    /// The numbers of the removed cells, whose entries new cells reuse.
    free: Vec<u32>,
    /// The number of inserted points.
    inserted: u32,
    /// The number of the cell that was created last. Walks start at this cell.
    last: u32,
    /// The numbers of the cells in conflict, and the faces on the border of their union, each as cell number
    /// and index of the opposite corner. Each insertion reuses the lists to save allocations.
    conflicts: Vec<u32>,
    border: Vec<(u32, usize)>,
}

/// Mark of a removed cell.
const FREE: u32 = u32::MAX;

/// Maximum number of points that [`Mesh::insert`] accepts. Marks reach twice this number.
pub(super) const MOST_POINTS: usize = 1 << 30;

impl<'a> Mesh<'a> {
    /// Creates the Delaunay tetrahedra of the corners of a box.
    ///
    /// The corners are the points `first` to `first + 7`. The tetrahedra are all quadruples of corners of
    /// positive orientation without a conflict with another corner.
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

    /// Returns the approximate memory of the cells after they are sorted, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.cells.len() as u64 * 110
    }

    /// Returns the list of cells, and for each cell false if the cell was removed.
    pub(super) fn into_cells(self) -> (Vec<Cell>, Vec<bool>) {
        let alive = self.marks.iter().map(|mark| *mark != FREE).collect();
        (self.cells, alive)
    }

    /// Inserts the point with this number, which must be strictly inside the box.
    ///
    /// # Errors
    ///
    /// [`InsertionRefusal::Same`] if the point equals an inserted point or a corner of the box,
    /// [`InsertionRefusal::Full`] if all numbers of tetrahedra are used.
    pub(super) fn insert(&mut self, point: u32) -> Result<(), InsertionRefusal> {
        let start = self.find(point);
        if let Some(&same) = self.cells[start as usize]
            .corners
            .iter()
            .find(|c| self.predicates.same(**c, point))
        {
            return Err(InsertionRefusal::Same(same));
        }
        self.inserted += 1;
        let inside = 2 * self.inserted;
        self.gather_conflicts(point, start, inside);
        for at in 0..self.border.len() {
            let (old, k) = self.border[at];
            self.join(point, old, k)?;
        }
        for at in 0..self.border.len() {
            let (old, k) = self.border[at];
            self.connect(old, k, inside);
        }
        for cell in &self.conflicts {
            self.marks[*cell as usize] = FREE;
        }
        self.free.extend_from_slice(&self.conflicts);
        Ok(())
    }

    /// Finds the cell that contains a point of the box, by a walk from the cell `last`. `ties.rs` explains
    /// why the walk ends.
    fn find(&self, point: u32) -> u32 {
        let (mut at, mut from) = (self.last, NONE);
        'walk: loop {
            let cell = &self.cells[at as usize];
            for k in 0..4 {
                if cell.across[k] == from || cell.across[k] == NONE {
                    // The point is neither beyond the face just crossed nor beyond a face of the box.
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

    /// Fills `conflicts` and `border`, starting from a cell that contains the point.
    ///
    /// The start cell is in conflict, even if the point is on its border: a strictly convex height is below
    /// the interpolation of the heights at the cell's corners.
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

    /// Creates the cell whose corners are the point and the corners of face `k` of the cell `old`. The cell
    /// `old` is in conflict, and the face is on the border of the cells in conflict.
    ///
    /// Also connects the new cell with the cell outside. Afterwards the new cell is across face `k` of `old`.
    fn join(&mut self, point: u32, old: u32, k: usize) -> Result<(), InsertionRefusal> {
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
                new.ok_or(InsertionRefusal::Full)?
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

    /// Connects the new cell at face `k` of the cell `old` with its three new neighbours.
    ///
    /// The face is on the border of the cells in conflict.
    ///
    /// The search for each neighbour turns around an edge of the face, through the cells in conflict, up to
    /// the next border face.
    fn connect(&mut self, old: u32, k: usize, inside: u32) {
        let new = self.cells[old as usize].across[k];
        let corners = self.cells[old as usize].corners;
        for j in (0..4).filter(|j| *j != k) {
            if self.cells[new as usize].across[j] != NONE {
                continue;
            }
            // The walk next crosses the face opposite corner `cross` of the cell `at`. This face contains the
            // edge and the corner `third`.
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

/// The reason why a point was not inserted.
#[derive(Debug)]
pub(super) enum InsertionRefusal {
    /// The point equals the inserted point with this number.
    Same(u32),
    /// All numbers of tetrahedra are used.
    Full,
}

impl InsertionRefusal {
    /// Converts the reason why point `number` was not inserted to the error of the whole construction.
    pub(super) fn into_error(self, number: u32, point: [f32; 3]) -> DelaunayError {
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

/// Returns the index of a value in an array that contains the value.
fn position(among: &[u32; 4], value: u32) -> usize {
    among.iter().position(|v| *v == value).unwrap_or(3)
}
