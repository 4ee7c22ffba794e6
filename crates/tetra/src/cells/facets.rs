//! The faces between cells.
//!
//! A facet is the part of a cut's plane inside the cut part of a tetrahedron, or a face of a tetrahedron.
//! This module divides facets into faces, so that each face has one cell on either side, and each triangle
//! covers the whole face or no part of it.

use super::bsp::{Cuts, Cutter, LEAF};
use super::local::{LocalGeometry, VertexKey};
use super::planes::NONE;
use super::polygon::{Corners, Polygon, Split, part, section, split};

/// The cells of a tetrahedron: its cuts, and the number of its first cell.
#[derive(Clone, Copy)]
pub struct TetrahedronCells<'a> {
    /// The cuts of the tetrahedron; `None` if it has no cuts.
    pub cuts: Option<&'a Cuts>,
    /// The number of the tetrahedron's first cell; `NONE` outside of the box.
    pub first_cell: u32,
}

/// The faces of one tetrahedron. A vertex is an index into `keys`.
#[derive(Debug, Default)]
pub struct Faces {
    /// The keys of the vertices.
    pub keys: Vec<VertexKey>,
    /// The positions of the vertices in doubles.
    pub rounded: Vec<[f64; 3]>,
    /// The list of faces.
    pub faces: Vec<Face>,
    /// The loops of the faces, one after another, as indices into `keys`.
    pub loops: Vec<u32>,
    /// The ids of the triangles that cover the faces, one face after another.
    pub triangles: Vec<u32>,
    /// For each vertex number of a [`LocalGeometry`], the index into `keys`, or `NONE` if the vertex has
    /// none.
    index_of: Vec<u32>,
}

/// A face in a list of [`Faces`].
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// The global number of the face's plane, or `NONE` if no decision used the plane.
    pub plane: u32,
    /// The numbers of the cells in front of the plane and behind the plane.
    pub cells: [u32; 2],
    /// The end of the face's loop in [`Faces::loops`]. The loop turns counter-clockwise as seen from the
    /// front.
    pub loop_end: u32,
    /// The end of the face's triangles in [`Faces::triangles`]. Their ids ascend.
    pub triangles_end: u32,
}

impl Faces {
    /// Adds a face of a tetrahedron between two tetrahedra without cuts. `whole` lists the triangles that
    /// equal the face.
    ///
    /// The number of the plane is `NONE`. The first three vertices of the loop define the plane.
    pub fn plain(
        &mut self,
        corners: [u32; 3],
        sides: [TetrahedronCells<'_>; 2],
        whole: &[(u32, u32)],
    ) {
        for corner in corners {
            self.loops.push(self.keys.len() as u32);
            self.keys.push(super::local::point_key(corner));
            self.rounded.push([0.0; 3]);
        }
        self.triangles.extend(whole.iter().map(|(_, id)| *id));
        self.faces.push(Face {
            plane: NONE,
            cells: sides.map(|s| s.first_cell),
            loop_end: self.loops.len() as u32,
            triangles_end: self.triangles.len() as u32,
        });
    }
}

/// A piece of a facet that is being divided.
struct FacetPiece {
    polygon: Polygon,
    /// The numbers of the cells in front and behind that are known so far; otherwise `NONE`.
    cells: [u32; 2],
    /// The ids of the triangles that cover the piece, ascending.
    triangles: Vec<u32>,
}

/// Adds the faces in the cuts of a tetrahedron to `out`, in the order of the cuts. `cutter` returns the
/// triangle with an id.
///
/// Returns false if the plane of a cut does not pass through the tetrahedron, which exact decisions exclude.
pub fn of_cuts(
    local: &mut LocalGeometry<'_>,
    corners: Corners,
    parts: TetrahedronCells<'_>,
    cutter: &impl Fn(u32) -> Cutter,
    out: &mut Faces,
) -> bool {
    let Some(cuts) = parts.cuts else { return true };
    for (at, cut) in (0u32..).zip(&cuts.cuts) {
        let plane = local.plane(cut.plane, &[]);
        let mut facet = section(local, corners, plane);
        let (mut above, mut side) = cut.parent;
        while above != NONE {
            let by = local.plane(cuts.cuts[above as usize].plane, &[]);
            facet = facet.and_then(|f| part(local, f, by, if side == 0 { 1 } else { -1 }));
            (above, side) = cuts.cuts[above as usize].parent;
        }
        let Some(polygon) = facet else { return false };
        let mut pieces = vec![FacetPiece {
            polygon,
            cells: [NONE; 2],
            triangles: Vec::new(),
        }];
        for side in 0..2 {
            pieces = down(local, parts, cut.children[side], side, pieces);
        }
        for (_, id) in cuts.triangles_in(at) {
            pieces = cover(local, &cutter(*id), pieces);
        }
        push(local, pieces, out);
    }
    true
}

/// Adds the faces in a face of a tetrahedron to `out`.
///
/// The polygon must turn counter-clockwise as seen from in front of its plane. `sides` are the cells in front
/// and behind, `whole` lists the triangles that equal the face, and `within` are other triangles in its
/// plane.
pub fn of_face(
    local: &mut LocalGeometry<'_>,
    polygon: Polygon,
    sides: [TetrahedronCells<'_>; 2],
    whole: &[(u32, u32)],
    within: impl Iterator<Item = Cutter>,
    out: &mut Faces,
) {
    let mut pieces = vec![FacetPiece {
        polygon,
        cells: [NONE; 2],
        triangles: whole.iter().map(|(_, id)| *id).collect(),
    }];
    for (side, parts) in sides.into_iter().enumerate() {
        let root = if parts.cuts.is_some_and(|c| !c.cuts.is_empty()) {
            0
        } else {
            LEAF
        };
        pieces = down(local, parts, root, side, pieces);
    }
    for cutter in within {
        pieces = cover(local, &cutter, pieces);
    }
    push(local, pieces, out);
}

/// Divides pieces by the cuts of a tetrahedron below `node`, and records the cell of each piece on one side:
/// 0 in front, 1 behind.
fn down(
    local: &mut LocalGeometry<'_>,
    parts: TetrahedronCells<'_>,
    node: u32,
    side: usize,
    pieces: Vec<FacetPiece>,
) -> Vec<FacetPiece> {
    let mut done = Vec::with_capacity(pieces.len());
    let mut todo: Vec<(FacetPiece, u32)> = pieces.into_iter().rev().map(|p| (p, node)).collect();
    while let Some((mut piece, node)) = todo.pop() {
        let cut = match parts.cuts {
            Some(cuts) if node & LEAF == 0 => cuts.cuts[node as usize],
            _ => {
                let is_outside = parts.first_cell == NONE;
                piece.cells[side] = if is_outside {
                    NONE
                } else {
                    parts.first_cell + (node & !LEAF)
                };
                done.push(piece);
                continue;
            }
        };
        let by = local.plane(cut.plane, &[]);
        // No cut contains a facet of the part that it cuts, so the plane differs from the plane of the piece.
        if let Split::Parts(front, back) = split(local, piece.polygon, by) {
            for (child, polygon) in cut.children.into_iter().zip([front, back]).rev() {
                if let Some(polygon) = polygon {
                    let (cells, triangles) = (piece.cells, piece.triangles.clone());
                    todo.push((
                        FacetPiece {
                            polygon,
                            cells,
                            triangles,
                        },
                        child,
                    ));
                }
            }
        }
    }
    done
}

/// Divides pieces along the edges of a triangle in their plane, and records the triangle in the pieces that
/// it covers.
///
/// A piece that the triangle does not overlap remains whole.
fn cover(
    local: &mut LocalGeometry<'_>,
    cutter: &Cutter,
    pieces: Vec<FacetPiece>,
) -> Vec<FacetPiece> {
    let edges = cutter.sides(local);
    let mut done = Vec::with_capacity(pieces.len());
    for piece in pieces {
        let mut covered = Some(piece.polygon.clone());
        for (edge, side) in edges {
            covered = covered.and_then(|p| part(local, p, edge, side));
        }
        if covered.is_none() {
            done.push(piece);
            continue;
        }
        let FacetPiece {
            mut polygon,
            cells,
            mut triangles,
        } = piece;
        for (edge, side) in edges {
            // The plane of an edge always differs from the plane of the triangle.
            let Split::Parts(front, back) = split(local, polygon.clone(), edge) else {
                continue;
            };
            let (inside, outside) = if side > 0 {
                (front, back)
            } else {
                (back, front)
            };
            done.extend(outside.map(|polygon| FacetPiece {
                polygon,
                cells,
                triangles: triangles.clone(),
            }));
            if let Some(inside) = inside {
                polygon = inside;
            }
        }
        if let Err(at) = triangles.binary_search(&cutter.id) {
            triangles.insert(at, cutter.id);
        }
        done.push(FacetPiece {
            polygon,
            cells,
            triangles,
        });
    }
    done
}

/// Adds the pieces to `out` as faces.
fn push(local: &mut LocalGeometry<'_>, pieces: Vec<FacetPiece>, out: &mut Faces) {
    for piece in pieces {
        for (v, _) in &piece.polygon.loops {
            let at = *v as usize;
            if out.index_of.len() <= at {
                out.index_of.resize(at + 1, NONE);
            }
            if out.index_of[at] == NONE {
                out.index_of[at] = out.keys.len() as u32;
                out.keys.push(local.key(*v));
                out.rounded.push(local.rounded(*v));
            }
            out.loops.push(out.index_of[at]);
        }
        out.triangles.extend(&piece.triangles);
        out.faces.push(Face {
            plane: local.number(piece.polygon.plane),
            cells: piece.cells,
            loop_end: out.loops.len() as u32,
            triangles_end: out.triangles.len() as u32,
        });
    }
}
