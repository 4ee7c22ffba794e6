//! The traversal of cells by a beam: the cells in which beams start, and the faces through which a beam
//! leaves a cell.
//!
//! Faces between cells do not cut beams: a beam continues to every cell whose face it may overlap. From any
//! point the cells have a front-to-back order, and a beam enters the nearest cell first. Entering a cell that
//! the beam misses costs time and does not affect the result. The parts of a beam inherit the pending entries
//! that the beam found in a cell, so no part enters the cell again.

use sightline_geometry::rounding::UNIT as U;

use super::beam::Edge;
use super::eye::{self, Eye, IntegerVector};
use super::planes::{Facing, Planes};
use super::rounded::Rounded;
use super::stack::StackEntry;
use crate::cells::{CellsView, NONE};

/// Value of [`StackEntry::count`] for an entry that enters a cell through a face.
pub const THROUGH_FACE: u32 = u32::MAX;

/// The cells, and the error of their rounded vertices.
pub struct Space<'a> {
    cells: CellsView<'a>,
    /// A bound on the error of a rounded vertex, without its last rounding, in units of the scene.
    slack: f64,
}

/// The ring of a beam with its cap.
#[derive(Clone, Copy)]
pub struct CappedRing<'a> {
    /// The corners and sides of the beam.
    pub ring: &'a [Edge],
    /// The plane of the nearest triangle so far that covers the beam.
    pub cap: Option<&'a Facing>,
}

/// The role of a cell's face for lines from a viewpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FaceRole {
    /// Lines from the viewpoint leave the cell through the face.
    Out,
    /// Lines from the viewpoint enter the cell through the face.
    In,
    /// The viewpoint is in the face's plane: no open set of lines crosses the face.
    Along,
}

impl<'a> Space<'a> {
    /// Creates the search space of the cells of a box.
    pub fn new(cells: CellsView<'a>) -> Self {
        // The corners of the box are the last eight points.
        let corners = &cells.points[cells.points.len().saturating_sub(8)..];
        let side = (0..3).map(|k| {
            let extreme = |start: f32, pick: fn(f32, f32) -> f32| {
                corners.iter().map(|p| p[k]).fold(start, pick)
            };
            f64::from(extreme(f32::NEG_INFINITY, f32::max))
                - f64::from(extreme(f32::INFINITY, f32::min))
        });
        // Twice the side is at least the power of two above the side.
        Self {
            cells,
            slack: side.fold(0.0, f64::max) * 2.0 * f64::powi(2.0, -44),
        }
    }

    /// Returns the role of a face for lines from the viewpoint. `listed` is an entry of
    /// `CellsView::faces_of`.
    fn way(&self, eye: &Eye<'_>, listed: u32) -> FaceRole {
        let face = (listed >> 1) as usize;
        let [a, b, third] = self.cells.planes[self.cells.faces[face].plane as usize].0;
        let axis = self.cells.planes[self.cells.faces[face].plane as usize].axis();
        // The sign is positive if the viewpoint is behind the plane.
        let behind = match axis {
            None => side(eye, a, [eye.between(a, b), eye.between(a, third)], || {
                [eye.between_exactly(a, b), eye.between_exactly(a, third)]
            }),
            Some(axis) => {
                let way: [f64; 3] = std::array::from_fn(|k| f64::from(u8::from(k == axis)));
                side(eye, a, [eye.between(a, b), Rounded::exact(way)], || {
                    [
                        eye.between_exactly(a, b),
                        way.map(|c| dashu_int::IBig::from(u8::from(c == 1.0))),
                    ]
                })
            }
        };
        if behind == 0 {
            return FaceRole::Along;
        }
        let in_front = behind < 0;
        let cell_in_front = listed & 1 == 0;
        if in_front == cell_in_front {
            FaceRole::Out
        } else {
            FaceRole::In
        }
    }

    /// Finds the cells in which beams start, and writes their entries to `found`.
    ///
    /// Beams start in the cells that contain the viewpoint. If the viewpoint is outside of the box, beams
    /// start in the cells at the faces of the box that are visible from the viewpoint.
    pub fn start(&self, eye: &Eye<'_>, hint: &mut Option<u32>, found: &mut Vec<StackEntry>) {
        found.clear();
        self.around(eye, hint, found);
        if found.is_empty() {
            self.seen_from_outside(eye, found);
        }
        // The order of the cells must not depend on the hint.
        found.sort_unstable_by_key(|e| std::cmp::Reverse(e.first));
        found.dedup();
    }

    /// Finds the cells at the faces of the box that are visible from the viewpoint outside.
    fn seen_from_outside(&self, eye: &Eye<'_>, found: &mut Vec<StackEntry>) {
        for face in 0..self.cells.face_count() {
            let cells = self.cells.faces[face].cells;
            for (side, cell) in (0u32..).zip(cells) {
                let outside = cells[1 - side as usize] == NONE;
                if cell != NONE && outside && self.way(eye, face as u32 * 2 + side) == FaceRole::In
                {
                    found.push(entry(cell));
                }
            }
        }
    }

    /// Adds the cells that contain the viewpoint to `found`, or no cells if the viewpoint is outside of the
    /// box. A cell contains its border.
    pub fn around(&self, eye: &Eye<'_>, hint: &mut Option<u32>, found: &mut Vec<StackEntry>) {
        let Some(first) = self.locate(eye, *hint) else {
            return;
        };
        *hint = Some(first);
        found.push(entry(first));
        let mut next = 0;
        while next < found.len() {
            let cell = found[next].first;
            next += 1;
            for listed in self.cells.faces_of(cell as usize) {
                let other = self.beyond(*listed);
                let known = other == NONE || found.iter().any(|e| e.first == other);
                if !known && self.way(eye, *listed) == FaceRole::Along && self.holds(eye, other) {
                    found.push(entry(other));
                }
            }
        }
    }

    /// Returns the number of the cell on the other side of a face, or [`NONE`]. `listed` is an entry of
    /// `CellsView::faces_of`.
    fn beyond(&self, listed: u32) -> u32 {
        self.cells.faces[(listed >> 1) as usize].cells[1 - (listed & 1) as usize]
    }

    /// Returns true if a cell contains the viewpoint. A cell contains its border.
    fn holds(&self, eye: &Eye<'_>, cell: u32) -> bool {
        self.cells
            .faces_of(cell as usize)
            .iter()
            .all(|f| self.way(eye, *f) != FaceRole::In)
    }

    /// Finds a cell that contains the viewpoint, by a walk from `hint`.
    ///
    /// Returns `None` if the viewpoint is outside of the box.
    pub fn locate(&self, eye: &Eye<'_>, hint: Option<u32>) -> Option<u32> {
        let count = self.cells.cell_count();
        let mut at = hint
            .filter(|hint| (*hint as usize) < count)
            .or_else(|| self.nearest_of_some(eye.x))?;
        // The front-to-back order of cells has no cycle, so the walk ends. The limit on the number of steps
        // ends the walk if a file is damaged.
        for _ in 0..=count {
            let mut outside = false;
            let step = self.cells.faces_of(at as usize).iter().find_map(|listed| {
                let out = self.way(eye, *listed) == FaceRole::In;
                let other = self.beyond(*listed);
                outside |= out && other == NONE;
                (out && other != NONE).then_some(other)
            });
            match step {
                Some(other) => at = other,
                None if outside => return None,
                None => return Some(at),
            }
        }
        None
    }

    /// Returns the number of a cell near the position `x`, selected from cells that are spread over the
    /// scene.
    ///
    /// The candidates are evenly spaced in the list of cells, whose order follows a curve through space. The
    /// result is the candidate whose first vertex is nearest to `x`. The number of candidates is about the
    /// cubic root of the number of cells. Then the selection takes about as long as the walk from the result
    /// (Mücke, Saias and Zhu, "Fast Randomized Point Location Without Preprocessing in Two- and
    /// Three-Dimensional Delaunay Triangulations", 1996).
    fn nearest_of_some(&self, x: [f64; 3]) -> Option<u32> {
        let count = self.cells.cell_count();
        let step = ((count as f64).powf(2.0 / 3.0) as usize).max(1);
        let apart = |cell: usize| {
            let face = (self.cells.faces_of(cell)[0] >> 1) as usize;
            let place = self.cells.place(self.cells.face_loop(face)[0]);
            (0..3).fold(0.0, |sum, k| sum + (place[k] - x[k]) * (place[k] - x[k]))
        };
        let nearest = (0..count)
            .step_by(step)
            .min_by(|a, b| apart(*a).total_cmp(&apart(*b)));
        nearest.map(|cell| cell as u32)
    }

    /// Returns the number of the cell that an entry enters.
    pub fn cell_of(&self, entry: &StackEntry) -> u32 {
        if entry.count == THROUGH_FACE {
            self.beyond(entry.first)
        } else {
            entry.first
        }
    }

    /// Returns true if a beam may overlap the face through which an entry enters a cell. Returns true for
    /// entries without a face.
    ///
    /// The beam may have become narrower after the entry was created.
    pub fn is_reached(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        beam: CappedRing<'_>,
        entry: &StackEntry,
        ways: &mut Vec<Rounded>,
    ) -> bool {
        entry.count != THROUGH_FACE
            || self
                .overlaps(eye, planes, beam, (entry.first >> 1) as usize, ways)
                .is_some()
    }

    /// Adds the entries of a beam in a cell to `pending`, and sorts `pending` so that the nearest entry is
    /// last.
    ///
    /// The entries are the triangles of the faces through which the beam may leave the cell, and the cells
    /// beyond faces without blocking triangles.
    pub fn leave(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        beam: CappedRing<'_>,
        cell: u32,
        blocks: impl Fn(u32) -> bool,
        is_entered: impl Fn(u32) -> bool,
        pending: &mut Vec<StackEntry>,
        ways: &mut Vec<Rounded>,
    ) {
        let before = pending.len();
        for listed in self.cells.faces_of(cell as usize) {
            let face = (listed >> 1) as usize;
            if self.way(eye, *listed) != FaceRole::Out {
                continue;
            }
            let other = self.beyond(*listed);
            let triangles = self.cells.face_triangles(face);
            let passes =
                other != NONE && !is_entered(other) && !triangles.iter().any(|t| blocks(*t));
            if triangles.is_empty() && !passes {
                continue;
            }
            let Some(key) = self.overlaps(eye, planes, beam, face, ways) else {
                continue;
            };
            for triangle in triangles {
                pending.push(StackEntry {
                    key: -1.0,
                    first: *triangle,
                    count: 1,
                });
            }
            if passes {
                pending.push(StackEntry {
                    key,
                    first: *listed,
                    count: THROUGH_FACE,
                });
            }
        }
        // Triangles precede cells, because triangles may end the beam; nearer cells precede farther cells.
        // The older entries are already sorted, and most of these entries keep their positions.
        for new in before..pending.len() {
            let StackEntry { key, first, .. } = pending[new];
            let at = pending[..new].partition_point(|e| (e.key, e.first) >= (key, first));
            pending[at..=new].rotate_right(1);
        }
    }

    /// Returns the squared distance of a face's middle from the viewpoint, or `None` if the beam certainly
    /// does not overlap the face in front of the beam's cap.
    ///
    /// `ways` receives the vectors from the viewpoint to the face's vertices.
    fn overlaps(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        beam: CappedRing<'_>,
        face: usize,
        ways: &mut Vec<Rounded>,
    ) -> Option<f64> {
        ways.clear();
        ways.extend(self.cells.face_loop(face).iter().map(|v| self.to(eye, *v)));
        let outside = |edge: &Edge| {
            let normal = planes.normal(edge.side);
            ways.iter().all(|way| normal.dot(way).sign() == Some(-1))
        };
        if beam.ring.iter().any(outside) {
            return None;
        }
        if beam.cap.is_some_and(|cap| cap.hides(ways)) {
            return None;
        }
        let mut middle = [0.0; 3];
        for (k, a) in ways.iter().enumerate() {
            let b = &ways[if k + 1 == ways.len() { 0 } else { k + 1 }];
            (0..3).for_each(|j| middle[j] += a.v[j]);
            // The face is convex, so one vertex shows the side of an edge on which the face lies.
            let normal = a.cross(b);
            let inner = ways.iter().find_map(|way| normal.dot(way).sign());
            let Some(inner) = inner else { continue };
            if beam
                .ring
                .iter()
                .all(|e| e.corner.way.dot(&normal).sign() == Some(-inner))
            {
                return None;
            }
        }
        Some(middle.iter().map(|c| c * c).sum::<f64>() / (ways.len() * ways.len()) as f64)
    }

    /// Returns the vector from the viewpoint to a vertex.
    fn to(&self, eye: &Eye<'_>, vertex: u32) -> Rounded {
        let place = self.cells.place(vertex);
        let way = Rounded::difference(place, eye.x);
        if (vertex as usize) < self.cells.points.len() {
            return way;
        }
        // The error of a rounded position is at most the slack plus one unit in the last place
        // (`Cells::rounded`).
        let last = 2.0 * U * place.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        Rounded {
            error: way.error + self.slack + last,
            ..way
        }
    }
}

fn entry(cell: u32) -> StackEntry {
    StackEntry {
        key: 0.0,
        first: cell,
        count: 0,
    }
}

/// Returns the sign of (p × q) · (a − x). `exactly` returns p and q in integers, for signs that doubles do
/// not decide.
///
/// The sign is positive if the viewpoint is behind the plane through point `a` along the vectors p and q.
fn side(
    eye: &Eye<'_>,
    a: u32,
    [p, q]: [Rounded; 2],
    exactly: impl Fn() -> [IntegerVector; 2],
) -> i32 {
    eye.to(a).dot(&p.cross(&q)).sign().unwrap_or_else(|| {
        let [p, q] = exactly();
        eye::sign(&eye::dot(&eye.to_exactly(a), &eye::cross(&p, &q)))
    })
}
