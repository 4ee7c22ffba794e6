//! The cells in flat arrays.

use super::local::Decisions;
use super::planes::{NONE, Plane};

/// Convex cells that fill a box, between faces that triangles cover wholly or not at all.
///
/// A vertex is a number: below the number of points it is a point of the input, else one of `meets`, counted
/// from the number of points on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cells {
    /// The points of the surfaces, then the eight corners of the box.
    pub points: Vec<[f32; 3]>,
    /// Planes of the input.
    pub planes: Vec<Plane>,
    /// Vertices that are the meets of three planes, by their numbers, ascending.
    pub meets: Vec<[u32; 3]>,
    /// The meets in doubles, off by at most 2⁻⁴⁴ of the power of two above the box's greatest side and one
    /// unit in the last place. No decision was made with them.
    pub rounded: Vec<[f64; 3]>,
    /// The faces. The list ends with one more, whose starts are the ends of the last.
    pub faces: Vec<FaceRecord>,
    /// The vertices of the faces' loops.
    pub loops: Vec<u32>,
    /// The triangles that cover the faces, ascending in each.
    pub triangles: Vec<u32>,
    /// The cells. The list ends with one more, whose start is the end of the last.
    pub cells: Vec<CellRecord>,
    /// The faces of the cells, ascending in each: a face times two, and one more where the cell is behind it.
    pub cell_faces: Vec<u32>,
}

/// A convex face.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FaceRecord {
    /// Its plane.
    pub plane: u32,
    /// The start of its loop in `loops`. It turns counter-clockwise as seen from in front of the plane.
    pub loop_start: u32,
    /// The start of its triangles in `triangles`.
    pub triangles_start: u32,
    /// The cells in front of the plane and behind; `NONE` outside of the box.
    pub cells: [u32; 2],
}

/// A convex cell.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct CellRecord {
    /// The tetrahedron that it is a part of.
    pub tetrahedron: u32,
    /// The start of its faces in `cell_faces`.
    pub faces_start: u32,
}

/// How cells came about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Signs of determinants, and those that took integers.
    pub decisions: Decisions,
    /// Triangles that were faces of tetrahedra.
    pub whole: u32,
    /// Pairs of a tetrahedron and a triangle that passes through its inside, or nearly.
    pub meetings: u64,
    /// Tetrahedra that were cut.
    pub cut: u32,
}

/// The lists of [`Cells`], wherever they are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellsView<'a> {
    /// As [`Cells::points`].
    pub points: &'a [[f32; 3]],
    /// As [`Cells::planes`].
    pub planes: &'a [Plane],
    /// As [`Cells::meets`].
    pub meets: &'a [[u32; 3]],
    /// As [`Cells::rounded`].
    pub rounded: &'a [[f64; 3]],
    /// As [`Cells::faces`].
    pub faces: &'a [FaceRecord],
    /// As [`Cells::loops`].
    pub loops: &'a [u32],
    /// As [`Cells::triangles`].
    pub triangles: &'a [u32],
    /// As [`Cells::cells`].
    pub cells: &'a [CellRecord],
    /// As [`Cells::cell_faces`].
    pub cell_faces: &'a [u32],
}

impl<'a> CellsView<'a> {
    /// The number of faces.
    pub fn face_count(&self) -> usize {
        self.faces.len().saturating_sub(1)
    }

    /// The number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len().saturating_sub(1)
    }

    /// The vertices of a face, which must be below [`Self::face_count`].
    pub fn face_loop(&self, face: usize) -> &'a [u32] {
        &self.loops[self.faces[face].loop_start as usize..self.faces[face + 1].loop_start as usize]
    }

    /// The triangles that cover a face, which must be below [`Self::face_count`].
    pub fn face_triangles(&self, face: usize) -> &'a [u32] {
        let range = self.faces[face].triangles_start as usize
            ..self.faces[face + 1].triangles_start as usize;
        &self.triangles[range]
    }

    /// The faces of a cell, which must be below [`Self::cell_count`]: face times two, plus one where the cell
    /// is behind.
    pub fn faces_of(&self, cell: usize) -> &'a [u32] {
        let range =
            self.cells[cell].faces_start as usize..self.cells[cell + 1].faces_start as usize;
        &self.cell_faces[range]
    }

    /// A vertex in doubles; see `rounded`.
    pub fn place(&self, vertex: u32) -> [f64; 3] {
        match self.points.get(vertex as usize) {
            Some(point) => point.map(f64::from),
            None => self.rounded[vertex as usize - self.points.len()],
        }
    }
}

impl Cells {
    /// The lists.
    pub fn view(&self) -> CellsView<'_> {
        CellsView {
            points: &self.points,
            planes: &self.planes,
            meets: &self.meets,
            rounded: &self.rounded,
            faces: &self.faces,
            loops: &self.loops,
            triangles: &self.triangles,
            cells: &self.cells,
            cell_faces: &self.cell_faces,
        }
    }

    /// Ends the lists and gathers the faces of the cells; `tetrahedra` are those of the cells in order.
    pub(crate) fn finish(&mut self, tetrahedra: impl Iterator<Item = u32>) {
        self.cells = tetrahedra
            .map(|tetrahedron| CellRecord {
                tetrahedron,
                faces_start: 0,
            })
            .collect();
        self.cells.push(CellRecord {
            tetrahedron: NONE,
            faces_start: 0,
        });
        let sides = self
            .faces
            .iter()
            .flat_map(|f| f.cells)
            .filter(|c| *c != NONE);
        sides.for_each(|cell| self.cells[cell as usize + 1].faces_start += 1);
        let mut at = 0;
        for cell in &mut self.cells {
            at += cell.faces_start;
            cell.faces_start = at;
        }
        let mut next: Vec<u32> = self.cells.iter().map(|c| c.faces_start).collect();
        self.cell_faces = vec![0; at as usize];
        for (n, face) in (0u32..).zip(&self.faces) {
            for (side, cell) in (0..).zip(face.cells) {
                if let Some(at) = next.get_mut(cell as usize).filter(|_| cell != NONE) {
                    self.cell_faces[*at as usize] = n * 2 + side;
                    *at += 1;
                }
            }
        }
        self.faces.push(FaceRecord {
            plane: NONE,
            loop_start: self.loops.len() as u32,
            triangles_start: self.triangles.len() as u32,
            cells: [NONE; 2],
        });
    }
}
