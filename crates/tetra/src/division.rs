//! Division of cells into tetrahedra, for programs that support only tetrahedra.
//!
//! Each face is divided into triangles, and both cells of the face use this division. A cell is divided into
//! the tetrahedra from an apex to the triangles of its faces. The apex is the cell's vertex with the smallest
//! number. If vertices of other cells lie on the cell's edges, the apex is a point inside the cell. So the
//! tetrahedra meet face to face, and a triangle of the scene is a union of their faces. Equality of positions
//! and collinearity are decided modulo two primes, as in the checker (`check/residues.rs`).

use dashu_int::IBig;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::cells::CellsView;
use crate::check::integers::Integers;
use crate::check::residues::{Field, ResiduePlace};
use crate::file::Contents;

/// Tetrahedra that fill the box face to face.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Divided {
    /// The positions of the corners, rounded to doubles.
    pub places: Vec<[f64; 3]>,
    /// The corners a, b, c, d of each tetrahedron, as indices into `places`.
    ///
    /// The corners satisfy (b − a) × (c − a) · (d − a) > 0 before rounding.
    pub tetrahedra: Vec<[u32; 4]>,
    /// The number of the cell that contains each tetrahedron.
    pub cells: Vec<u32>,
    /// The three corners of each tetrahedron face that lies in a triangle of the scene, as indices into
    /// `places`.
    pub faces: Vec<[u32; 3]>,
    /// The id of the scene's triangle for each entry of `faces`. If triangles overlap, a face has one entry
    /// for each triangle.
    pub triangles: Vec<u32>,
}

/// Divides the cells of a file into tetrahedra.
pub fn divide(contents: &Contents<'_>) -> Divided {
    let cells = contents.cells;
    let field = Field::new(&contents.digest);
    let integers = Integers::new(cells);
    let vertices = cells.points.len() + cells.meets.len();
    let places: Vec<ResiduePlace> = (0..vertices as u32)
        .into_par_iter()
        // `check` rejects a file with a vertex whose planes do not meet in one point.
        .map(|v| {
            integers
                .vertex(v)
                .map(|v| field.place(&v))
                .unwrap_or_default()
        })
        .collect();
    let mut first: FxHashMap<ResiduePlace, u32> = FxHashMap::default();
    let same: Vec<u32> = (0..)
        .zip(&places)
        .map(|(v, place)| *first.entry(*place).or_insert(v))
        .collect();
    drop(first);
    let rings = FaceRings {
        cells,
        field,
        places: &places,
        same: &same,
        between: FxHashMap::default(),
    };
    let rings = FaceRings {
        between: rings.lines(&integers),
        ..rings
    };
    let faces: Vec<DividedFace> = (0..cells.face_count())
        .into_par_iter()
        .map(|f| rings.face(f))
        .collect();
    let parts: Vec<CellTetrahedra> = (0..cells.cell_count())
        .into_par_iter()
        .map(|c| rings.cell(c, &faces))
        .collect();
    gather(contents, &faces, parts)
}

/// The tetrahedra of a cell, and the inner point if the cell needs one. The inner point has the number
/// `u32::MAX`.
type CellTetrahedra = (Vec<[u32; 4]>, Option<[f64; 3]>);
/// The numbers of the two vertices at the ends of an edge, the smaller number first.
type EdgeEnds = (u32, u32);
/// The identifier of a line ([`Field::line`]), and an edge on this line.
type OnLine = ([ResiduePlace; 2], EdgeEnds);

/// A face, the vertices of all cells on its edges, and its division into triangles.
struct DividedFace {
    /// True if three consecutive vertices of the ring are collinear.
    uneven: bool,
    /// The numbers of the vertices on the face's edges, in order around the face.
    ring: Vec<u32>,
    /// The triangles of the face, counter-clockwise as seen from in front of the plane.
    triangles: Vec<[u32; 3]>,
}

struct FaceRings<'a> {
    cells: CellsView<'a>,
    field: Field,
    places: &'a [ResiduePlace],
    /// For each vertex, the smallest number of all vertices at the same position.
    same: &'a [u32],
    /// The vertices between the ends of each edge, in order from the end with the smaller number. Edges
    /// without such vertices have no entry.
    between: FxHashMap<EdgeEnds, Vec<u32>>,
}

impl FaceRings<'_> {
    /// Returns the vertices of a face's loop, with one vertex number per position.
    fn loop_of(&self, face: usize) -> Vec<u32> {
        let mut ring: Vec<u32> = self
            .cells
            .face_loop(face)
            .iter()
            .map(|v| self.same[*v as usize])
            .collect();
        ring.dedup();
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        ring
    }

    /// Finds the vertices between the ends of each edge, by grouping the edges by their lines.
    fn lines(&self, integers: &Integers<'_>) -> FxHashMap<EdgeEnds, Vec<u32>> {
        let mut edges: Vec<EdgeEnds> = (0..self.cells.face_count())
            .into_par_iter()
            .flat_map_iter(|f| {
                let ring = self.loop_of(f);
                (0..ring.len()).map(move |k| {
                    let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
                    (a.min(b), a.max(b))
                })
            })
            .collect();
        edges.par_sort_unstable();
        edges.dedup();
        let place = |v: u32| &self.places[v as usize];
        let mut on_lines: Vec<OnLine> = edges
            .into_par_iter()
            .map(|(a, b)| (self.field.line(place(a), place(b)), (a, b)))
            .collect();
        on_lines.par_sort_unstable();
        let groups: Vec<&[OnLine]> = on_lines
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|group| group.len() > 1)
            .collect();
        let found: Vec<Vec<(EdgeEnds, Vec<u32>)>> = groups
            .into_par_iter()
            .map(|group| between(integers, group))
            .collect();
        found.into_iter().flatten().collect()
    }

    fn face(&self, face: usize) -> DividedFace {
        let own = self.loop_of(face);
        let mut ring = Vec::with_capacity(own.len());
        for (k, a) in own.iter().enumerate() {
            let b = own[(k + 1) % own.len()];
            ring.push(*a);
            if let Some(between) = self.between.get(&(*a.min(&b), *a.max(&b))) {
                match *a < b {
                    true => ring.extend(between),
                    false => ring.extend(between.iter().rev()),
                }
            }
        }
        let n = ring.len();
        let straight =
            (0..n).any(|k| self.are_in_line(ring[k], ring[(k + 1) % n], ring[(k + 2) % n]));
        let triangles = if straight {
            self.clip(ring.clone())
        } else {
            fan(&ring, least(&ring))
        };
        DividedFace {
            uneven: straight,
            ring,
            triangles,
        }
    }

    fn are_in_line(&self, a: u32, b: u32, c: u32) -> bool {
        let [a, b, c] = [a, b, c].map(|v| &self.places[v as usize]);
        self.field
            .cross(&self.field.difference(b, a), &self.field.difference(c, a))
            == ResiduePlace::default()
    }

    /// Divides a convex ring that has vertices inside its sides into triangles.
    ///
    /// Every piece of a side is an edge of a triangle.
    fn clip(&self, mut ring: Vec<u32>) -> Vec<[u32; 3]> {
        let mut out = Vec::with_capacity(ring.len());
        while ring.len() > 3 {
            let n = ring.len();
            let corner =
                |k: usize| !self.are_in_line(ring[(k + n - 1) % n], ring[k], ring[(k + 1) % n]);
            let corners: Vec<usize> = (0..n).filter(|k| corner(*k)).collect();
            // If the ring has three corners, all other vertices may lie on the side opposite one corner.
            let alone = |k: &&usize| {
                let beside = |step: usize| corners.contains(&((**k + step) % n));
                corners.len() == 3 && beside(1) && beside(n - 1)
            };
            if let Some(k) = corners.iter().find(alone) {
                out.extend(fan(&ring, *k));
                return out;
            }
            let Some(k) = corners.into_iter().min_by_key(|k| ring[*k]) else {
                return out;
            };
            out.push([ring[(k + n - 1) % n], ring[k], ring[(k + 1) % n]]);
            ring.remove(k);
        }
        if let [a, b, c] = ring[..] {
            out.push([a, b, c]);
        }
        out
    }

    /// Computes the tetrahedra of a cell.
    fn cell(&self, cell: usize, faces: &[DividedFace]) -> CellTetrahedra {
        let listed = self.cells.faces_of(cell);
        let face_at = |f: &u32| &faces[(f >> 1) as usize];
        let least = listed
            .iter()
            .flat_map(|f| &face_at(f).ring)
            .min()
            .copied()
            .unwrap_or_default();
        let simple = listed.iter().all(|f| {
            let face = face_at(f);
            !face.uneven && (face.ring.contains(&least) || !self.is_in_plane(face, least))
        });
        let tip = if simple { least } else { u32::MAX };
        let cone = listed
            .iter()
            .filter(|f| !simple || !face_at(f).ring.contains(&least))
            .flat_map(|f| {
                // The triangles of a face turn clockwise as seen from inside a cell behind the face.
                let turned = f & 1 == 0;
                face_at(f).triangles.iter().map(move |[a, b, c]| {
                    if turned {
                        [*a, *b, *c, tip]
                    } else {
                        [*a, *c, *b, tip]
                    }
                })
            });
        let tetrahedra = cone.collect();
        let middle = (!simple).then(|| {
            let mut all: Vec<u32> = listed
                .iter()
                .flat_map(|f| &face_at(f).ring)
                .copied()
                .collect();
            all.sort_unstable();
            all.dedup();
            let mut sum = [0.0; 3];
            for v in &all {
                let place = self.cells.place(*v);
                (0..3).for_each(|k| sum[k] += place[k] / all.len() as f64);
            }
            sum
        });
        (tetrahedra, middle)
    }

    fn is_in_plane(&self, face: &DividedFace, vertex: u32) -> bool {
        let Some([a, b, c]) = face.triangles.first() else {
            return true;
        };
        let [a, b, c, v] = [*a, *b, *c, vertex].map(|v| &self.places[v as usize]);
        let offset_from_a = |v: &ResiduePlace| self.field.difference(v, a);
        self.field.dot(
            &self.field.cross(&offset_from_a(b), &offset_from_a(c)),
            &offset_from_a(v),
        ) == [0; 2]
    }
}

/// Returns the index, in a ring, of the vertex with the smallest number.
fn least(ring: &[u32]) -> usize {
    (0..ring.len()).min_by_key(|k| ring[*k]).unwrap_or(0)
}

/// Returns the triangles of a fan from the vertex at index `from` of a ring.
fn fan(ring: &[u32], from: usize) -> Vec<[u32; 3]> {
    let n = ring.len();
    let at = |k: usize| ring[(from + k) % n];
    (1..n.saturating_sub(1))
        .map(|k| [ring[from], at(k), at(k + 1)])
        .collect()
}

/// Returns the vertices between the ends of each edge of `group`, whose edges lie on one line. Omits edges
/// without such vertices.
fn between(integers: &Integers<'_>, group: &[OnLine]) -> Vec<(EdgeEnds, Vec<u32>)> {
    let mut vertices: Vec<u32> = group.iter().flat_map(|(_, (a, b))| [*a, *b]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let whole: Vec<(u32, [IBig; 4])> = vertices
        .iter()
        .map(|v| (*v, integers.vertex(*v).unwrap_or_default()))
        .collect();
    // If two positions on the line differ along an axis, any two positions on the line differ along this
    // axis.
    let less =
        |axis: usize, p: &[IBig; 4], q: &[IBig; 4]| (&p[axis] * &q[3]).cmp(&(&q[axis] * &p[3]));
    let apart = |axis: &usize| match &whole[..] {
        [first, second, ..] => less(*axis, &first.1, &second.1).is_ne(),
        _ => false,
    };
    let axis = (0..3).find(apart).unwrap_or(0);
    let mut order: Vec<&(u32, [IBig; 4])> = whole.iter().collect();
    order.sort_by(|p, q| less(axis, &p.1, &q.1));
    let order: Vec<u32> = order.into_iter().map(|(v, _)| *v).collect();
    let rank: FxHashMap<u32, usize> = order.iter().enumerate().map(|(k, v)| (*v, k)).collect();
    let inner = group.iter().filter_map(|(_, (a, b))| {
        let (from, to) = (rank[a], rank[b]);
        let mut inner: Vec<u32> = order[from.min(to) + 1..from.max(to)].to_vec();
        if from > to {
            inner.reverse();
        }
        (!inner.is_empty()).then_some(((*a, *b), inner))
    });
    inner.collect()
}

fn gather(contents: &Contents<'_>, faces: &[DividedFace], parts: Vec<CellTetrahedra>) -> Divided {
    let cells = contents.cells;
    let vertices = cells.points.len() + cells.meets.len();
    let mut out = Divided::default();
    let mut numbers = vec![u32::MAX; vertices];
    let mut number = |v: u32, places: &mut Vec<[f64; 3]>| {
        let number = &mut numbers[v as usize];
        if *number == u32::MAX {
            *number = places.len() as u32;
            places.push(cells.place(v));
        }
        *number
    };
    for (cell, (tetrahedra, middle)) in (0..).zip(parts) {
        let tip = middle.map(|middle| {
            out.places.push(middle);
            out.places.len() as u32 - 1
        });
        for corners in tetrahedra {
            let named = corners.map(|v| match (v, tip) {
                (u32::MAX, Some(tip)) => tip,
                (v, _) => number(v, &mut out.places),
            });
            out.tetrahedra.push(named);
            out.cells.push(cell);
        }
    }
    for (f, face) in faces.iter().enumerate() {
        for triangle in cells.face_triangles(f) {
            for corners in &face.triangles {
                out.faces.push(corners.map(|v| number(v, &mut out.places)));
                out.triangles.push(*triangle);
            }
        }
    }
    out
}
