//! The cells of a scene in flat arrays.

use super::local::Decisions;
use super::planes::{NONE, Plane};

/// Convex cells that fill a box, between faces that each triangle covers completely or not at all.
///
/// A vertex is an index. An index below the length of `points` refers to an entry of `points`. A larger
/// index, minus the length of `points`, refers to an entry of `meets`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cells {
    /// The points of the surfaces, then the eight corners of the box.
    pub points: Vec<[f32; 3]>,
    /// The planes of the triangles and of the faces of tetrahedra.
    pub planes: Vec<Plane>,
    /// The vertices that are intersections of three planes: each as three indices into `planes`, ascending.
    pub meets: Vec<[u32; 3]>,
    /// The positions of the vertices in `meets`, in doubles.
    ///
    /// Each coordinate is off by at most 2⁻⁴⁴ times the power of two above the box's largest side, plus one
    /// unit in the last place. No decision uses these positions.
    pub rounded: Vec<[f64; 3]>,
    /// The faces, and one more entry whose starts are the ends of the last face.
    pub faces: Vec<FaceRecord>,
    /// The vertices of the faces' loops, one loop after another.
    pub loops: Vec<u32>,
    /// The ids of the triangles that cover the faces, one face after another, ascending in each face.
    pub triangles: Vec<u32>,
    /// The cells, and one more entry whose start is the end of the last cell.
    pub cells: Vec<CellRecord>,
    /// The faces of the cells, one cell after another, ascending in each cell.
    ///
    /// An entry is twice the index of the face, plus 1 if the cell is behind the face.
    pub cell_faces: Vec<u32>,
}

/// A convex face.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FaceRecord {
    /// The index of the face's plane in `planes`.
    pub plane: u32,
    /// The index of the first vertex of the face's loop in `loops`. The loop turns counter-clockwise as seen
    /// from in front of the plane.
    pub loop_start: u32,
    /// The index of the face's first entry in `triangles`.
    pub triangles_start: u32,
    /// The numbers of the cells in front of the plane and behind the plane; `NONE` outside of the box.
    pub cells: [u32; 2],
}

/// A convex cell.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct CellRecord {
    /// The number of the tetrahedron that contains the cell.
    pub tetrahedron: u32,
    /// The index of the cell's first entry in `cell_faces`.
    pub faces_start: u32,
}

/// Statistics about the construction of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// The number of all exact decisions, and the number of decisions that needed integers.
    pub decisions: Decisions,
    /// The number of triangles that equal faces of tetrahedra.
    pub whole: u32,
    /// The number of pairs of a tetrahedron and a triangle that may pass through the inside of the
    /// tetrahedron.
    pub meetings: u64,
    /// The number of tetrahedra that were cut.
    pub cut: u32,
}

/// Borrowed lists of [`Cells`], for example from a mapped file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellsView<'a> {
    /// The points of the surfaces, then the corners of the box ([`Cells::points`]).
    pub points: &'a [[f32; 3]],
    /// The planes of triangles and faces ([`Cells::planes`]).
    pub planes: &'a [Plane],
    /// The vertices that are intersections of three planes ([`Cells::meets`]).
    pub meets: &'a [[u32; 3]],
    /// The positions of the vertices in `meets` ([`Cells::rounded`]).
    pub rounded: &'a [[f64; 3]],
    /// The faces, and one more entry ([`Cells::faces`]).
    pub faces: &'a [FaceRecord],
    /// The vertices of the faces' loops ([`Cells::loops`]).
    pub loops: &'a [u32],
    /// The triangles that cover the faces ([`Cells::triangles`]).
    pub triangles: &'a [u32],
    /// The cells, and one more entry ([`Cells::cells`]).
    pub cells: &'a [CellRecord],
    /// The faces of the cells ([`Cells::cell_faces`]).
    pub cell_faces: &'a [u32],
}

impl<'a> CellsView<'a> {
    /// Returns the number of faces.
    pub fn face_count(&self) -> usize {
        self.faces.len().saturating_sub(1)
    }

    /// Returns the number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len().saturating_sub(1)
    }

    /// Returns the vertices of the face with this index, which must be below [`Self::face_count`].
    pub fn face_loop(&self, face: usize) -> &'a [u32] {
        &self.loops[self.faces[face].loop_start as usize..self.faces[face + 1].loop_start as usize]
    }

    /// Returns the ids of the triangles that cover the face with this index, which must be below
    /// [`Self::face_count`].
    pub fn face_triangles(&self, face: usize) -> &'a [u32] {
        let range = self.faces[face].triangles_start as usize
            ..self.faces[face + 1].triangles_start as usize;
        &self.triangles[range]
    }

    /// Returns the faces of the cell with this index, which must be below [`Self::cell_count`].
    ///
    /// An entry is twice the index of the face, plus 1 if the cell is behind the face.
    pub fn faces_of(&self, cell: usize) -> &'a [u32] {
        let range =
            self.cells[cell].faces_start as usize..self.cells[cell + 1].faces_start as usize;
        &self.cell_faces[range]
    }

    /// Returns the position of a vertex in doubles, with the error of [`Cells::rounded`].
    pub fn place(&self, vertex: u32) -> [f64; 3] {
        match self.points.get(vertex as usize) {
            Some(point) => point.map(f64::from),
            None => self.rounded[vertex as usize - self.points.len()],
        }
    }
}

impl Cells {
    /// Returns borrowed views of the lists.
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

    /// Adds the list of cells and the list of their faces, and ends the list of faces.
    ///
    /// `tetrahedra` contains the number of each cell's tetrahedron, in the order of cells.
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
