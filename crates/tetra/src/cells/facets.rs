//! The faces between cells: facets of cuts and of tetrahedra, divided until each has one cell on either side
//! and is covered wholly or not at all by each triangle.

use super::bsp::{Cuts, Cutter, LEAF};
use super::local::{Key, Local};
use super::planes::NONE;
use super::polygon::{Corners, Polygon, Split, part, section, split};

/// The cells of a tetrahedron: its cuts, and the number of its first cell.
#[derive(Clone, Copy)]
pub struct Parts<'a> {
    /// Its cuts; `None` where it has none.
    pub cuts: Option<&'a Cuts>,
    /// Its first cell; `NONE` outside of the box.
    pub first_cell: u32,
}

/// Faces with vertices of their own numbering.
#[derive(Debug, Default)]
pub struct Faces {
    /// The vertices' keys.
    pub keys: Vec<Key>,
    /// The vertices in doubles.
    pub rounded: Vec<[f64; 3]>,
    /// The faces.
    pub faces: Vec<Face>,
    /// The loops of the faces, one after another, as indices into the keys.
    pub loops: Vec<u32>,
    /// The triangles of the faces, one after another.
    pub triangles: Vec<u32>,
    /// The index of each local vertex, `NONE` where it has none yet.
    index_of: Vec<u32>,
}

/// A face.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// The number of its plane.
    pub plane: u32,
    /// The cells in front and behind.
    pub cells: [u32; 2],
    /// The end of its loop, which turns counter-clockwise as seen from the front.
    pub loop_end: u32,
    /// The end of its triangles, which ascend.
    pub triangles_end: u32,
}

impl Faces {
    /// Adds a face of a tetrahedron between cells that are not cut. Its plane is left open: it is that of the
    /// first three vertices of its loop.
    pub fn plain(&mut self, corners: [u32; 3], sides: [Parts<'_>; 2], whole: &[(u32, u32)]) {
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

/// A piece of a facet on its way: the polygon, the cells found so far and the triangles that cover it.
struct FacetPiece {
    polygon: Polygon,
    cells: [u32; 2],
    triangles: Vec<u32>,
}

/// Adds the faces in the cuts of a tetrahedron, in the order of the cuts. False where a cut has no section,
/// which exact decisions exclude.
pub fn of_cuts(
    local: &mut Local<'_>,
    corners: Corners,
    parts: Parts<'_>,
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

/// Adds the faces in a face of a tetrahedron, given counter-clockwise as seen from in front of its plane.
pub fn of_face(
    local: &mut Local<'_>,
    polygon: Polygon,
    sides: [Parts<'_>; 2],
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

/// Divides pieces by the cuts below a node, and notes the cell that each is at on one side.
fn down(
    local: &mut Local<'_>,
    parts: Parts<'_>,
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
        // No cut passes along the border of what it cuts, so the plane is another than the piece's.
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

/// Divides pieces along the edges of a triangle in their plane, where the triangle covers a part of them, and
/// notes what it covers.
fn cover(local: &mut Local<'_>, cutter: &Cutter, pieces: Vec<FacetPiece>) -> Vec<FacetPiece> {
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
            // An edge's plane is never the triangle's own.
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

/// Adds the pieces as faces.
fn push(local: &mut Local<'_>, pieces: Vec<FacetPiece>, out: &mut Faces) {
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
