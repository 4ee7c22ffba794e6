//! The cells between the surfaces as a beam goes through them: where it starts, and which faces it leaves by.
//!
//! Faces between cells cut nothing: a beam goes on to every cell whose face it may overlap. Seen from any
//! point the cells have a front-to-back order, and a beam takes the nearest cell first. Entering one that it
//! misses costs time and changes nothing. What a beam found in a cell waits in its parts, so none enters the
//! cell again.

use sightline_geometry::rounding::UNIT as U;

use super::beam::Edge;
use super::eye::{self, Eye, IntegerVector};
use super::planes::{Facing, Planes};
use super::rounded::Rounded;
use super::stack::Entry;
use crate::cells::{CellsView, NONE};

/// In place of a number of triangles: a cell to enter by the face that is listed.
pub const THROUGH_FACE: u32 = u32::MAX;

/// The cells, and how far their rounded vertices may be off.
pub struct Space<'a> {
    cells: CellsView<'a>,
    slack: f64,
}

/// What a face of a cell means to a viewpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// Lines from the viewpoint leave the cell by it.
    Out,
    /// They enter by it.
    In,
    /// The viewpoint is in its plane: no open set of lines passes.
    Along,
}

impl<'a> Space<'a> {
    /// The cells of a box.
    pub fn new(cells: CellsView<'a>) -> Self {
        // The box's corners end the points.
        let corners = &cells.points[cells.points.len().saturating_sub(8)..];
        let side = (0..3).map(|k| {
            let extreme = |start: f32, pick: fn(f32, f32) -> f32| {
                corners.iter().map(|p| p[k]).fold(start, pick)
            };
            f64::from(extreme(f32::NEG_INFINITY, f32::max))
                - f64::from(extreme(f32::INFINITY, f32::min))
        });
        // Twice the side is at least the power of two above it.
        Self {
            cells,
            slack: side.fold(0.0, f64::max) * 2.0 * f64::powi(2.0, -44),
        }
    }

    /// What a face, as `faces_of` lists it, means to the viewpoint.
    fn way(&self, eye: &Eye<'_>, listed: u32) -> Way {
        let face = (listed >> 1) as usize;
        let [a, b, third] = self.cells.planes[self.cells.faces[face].plane as usize].0;
        let axis = self.cells.planes[self.cells.faces[face].plane as usize].axis();
        // The side on which the viewpoint is not: towards the plane's front.
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
            return Way::Along;
        }
        let in_front = behind < 0;
        let cell_in_front = listed & 1 == 0;
        if in_front == cell_in_front {
            Way::Out
        } else {
            Way::In
        }
    }

    /// The cells in which beams start: those that hold the viewpoint, and from outside of the box those whose
    /// faces it sees.
    pub fn start(&self, eye: &Eye<'_>, hint: &mut Option<u32>, found: &mut Vec<Entry>) {
        found.clear();
        self.around(eye, hint, found);
        if found.is_empty() {
            self.seen_from_outside(eye, found);
        }
        // In one order, wherever the search for them began.
        found.sort_unstable_by_key(|e| std::cmp::Reverse(e.first));
        found.dedup();
    }

    /// The cells at the faces of the box that are seen from outside of it.
    fn seen_from_outside(&self, eye: &Eye<'_>, found: &mut Vec<Entry>) {
        for face in 0..self.cells.face_count() {
            let cells = self.cells.faces[face].cells;
            for (side, cell) in (0u32..).zip(cells) {
                let outside = cells[1 - side as usize] == NONE;
                if cell != NONE && outside && self.way(eye, face as u32 * 2 + side) == Way::In {
                    found.push(entry(cell));
                }
            }
        }
    }

    /// The cells that hold the viewpoint, their borders included; none outside of the box.
    pub fn around(&self, eye: &Eye<'_>, hint: &mut Option<u32>, found: &mut Vec<Entry>) {
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
                if !known && self.way(eye, *listed) == Way::Along && self.holds(eye, other) {
                    found.push(entry(other));
                }
            }
        }
    }

    /// The cell on the other side of a face.
    fn beyond(&self, listed: u32) -> u32 {
        self.cells.faces[(listed >> 1) as usize].cells[1 - (listed & 1) as usize]
    }

    /// Whether a cell holds the viewpoint, its border included.
    fn holds(&self, eye: &Eye<'_>, cell: u32) -> bool {
        self.cells
            .faces_of(cell as usize)
            .iter()
            .all(|f| self.way(eye, *f) != Way::In)
    }

    /// A cell that holds the viewpoint, by a walk from `hint`; nothing outside of the box.
    pub fn locate(&self, eye: &Eye<'_>, hint: Option<u32>) -> Option<u32> {
        let count = self.cells.cell_count();
        let mut at = hint
            .filter(|hint| (*hint as usize) < count)
            .or_else(|| self.nearest_of_some(eye.x))?;
        // Cells are in front of one another without a circle, so the walk ends; the count stops it in damaged
        // data.
        for _ in 0..=count {
            let mut outside = false;
            let step = self.cells.faces_of(at as usize).iter().find_map(|listed| {
                let out = self.way(eye, *listed) == Way::In;
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

    /// Of some cells, spread evenly over the list and so over space, the one with a vertex nearest to a
    /// place. With as many as the cubic root of all, finding it takes about as long as the walk from it
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

    /// The cell that an entry is about.
    pub fn cell_of(&self, entry: &Entry) -> u32 {
        if entry.count == THROUGH_FACE {
            self.beyond(entry.first)
        } else {
            entry.first
        }
    }

    /// Whether a beam may still go through the face by which an entry is to be entered. It has become
    /// narrower since the entry was made.
    pub fn is_reached(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        beam: (&[Edge], Option<&Facing>),
        entry: &Entry,
        ways: &mut Vec<Rounded>,
    ) -> bool {
        entry.count != THROUGH_FACE
            || self
                .overlaps(eye, planes, beam, (entry.first >> 1) as usize, ways)
                .is_some()
    }

    /// What a beam meets in a cell: the triangles of the faces by which it may leave, and the cells beyond
    /// those that nothing blocks. The nearest is pushed last.
    pub fn leave(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        (ring, cap): (&[Edge], Option<&Facing>),
        cell: u32,
        (blocks, is_entered): (impl Fn(u32) -> bool, impl Fn(u32) -> bool),
        (pending, ways): (&mut Vec<Entry>, &mut Vec<Rounded>),
    ) {
        let before = pending.len();
        for listed in self.cells.faces_of(cell as usize) {
            let face = (listed >> 1) as usize;
            if self.way(eye, *listed) != Way::Out {
                continue;
            }
            let other = self.beyond(*listed);
            let triangles = self.cells.face_triangles(face);
            let passes =
                other != NONE && !is_entered(other) && !triangles.iter().any(|t| blocks(*t));
            if triangles.is_empty() && !passes {
                continue;
            }
            let Some(key) = self.overlaps(eye, planes, (ring, cap), face, ways) else {
                continue;
            };
            for triangle in triangles {
                pending.push(Entry {
                    key: -1.0,
                    first: *triangle,
                    count: 1,
                });
            }
            if passes {
                pending.push(Entry {
                    key,
                    first: *listed,
                    count: THROUGH_FACE,
                });
            }
        }
        // Triangles first, for they may end the beam; then the nearest cells. What was there is in order
        // already, and most of it stays where it is.
        for new in before..pending.len() {
            let Entry { key, first, .. } = pending[new];
            let at = pending[..new].partition_point(|e| (e.key, e.first) >= (key, first));
            pending[at..=new].rotate_right(1);
        }
    }

    /// Whether a beam may overlap a face in front of its cap, and the square of how far away the face's
    /// middle is. The ways to its vertices are kept in `ways` meanwhile.
    fn overlaps(
        &self,
        eye: &Eye<'_>,
        planes: &Planes,
        (ring, cap): (&[Edge], Option<&Facing>),
        face: usize,
        ways: &mut Vec<Rounded>,
    ) -> Option<f64> {
        ways.clear();
        ways.extend(self.cells.face_loop(face).iter().map(|v| self.to(eye, *v)));
        let outside = |edge: &Edge| {
            let normal = planes.normal(edge.side);
            ways.iter().all(|way| normal.dot(way).sign() == Some(-1))
        };
        if ring.iter().any(outside) {
            return None;
        }
        if cap.is_some_and(|cap| cap.hides(ways)) {
            return None;
        }
        let mut middle = [0.0; 3];
        for (k, a) in ways.iter().enumerate() {
            let b = &ways[if k + 1 == ways.len() { 0 } else { k + 1 }];
            (0..3).for_each(|j| middle[j] += a.v[j]);
            // The face is convex, so that one vertex tells on which side of an edge all of it is.
            let normal = a.cross(b);
            let inner = ways.iter().find_map(|way| normal.dot(way).sign());
            let Some(inner) = inner else { continue };
            if ring
                .iter()
                .all(|e| e.corner.way.dot(&normal).sign() == Some(-inner))
            {
                return None;
            }
        }
        Some(middle.iter().map(|c| c * c).sum::<f64>() / (ways.len() * ways.len()) as f64)
    }

    /// The way to a vertex.
    fn to(&self, eye: &Eye<'_>, vertex: u32) -> Rounded {
        let place = self.cells.place(vertex);
        let way = Rounded::difference(place, eye.x);
        if (vertex as usize) < self.cells.points.len() {
            return way;
        }
        // Rounded places are off by this and one unit in the last place (`Cells::rounded`).
        let last = 2.0 * U * place.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        Rounded {
            error: way.error + self.slack + last,
            ..way
        }
    }
}

fn entry(cell: u32) -> Entry {
    Entry {
        key: 0.0,
        first: cell,
        count: 0,
    }
}

/// The sign of (p × q) · (a − x): positive where the viewpoint is behind the plane through a along p and q.
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
