//! Faults of cells that the checker reports.

/// The first fault that the checker found.
///
/// Faulty cells were altered or built by a faulty program; build the cells again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The list of points is not the list of the surfaces' points followed by the corners of a box around
    /// these points.
    #[error(
        "the points are not the points of the scene, followed by the corners of a box around these points"
    )]
    Points,
    /// A list ends too early, or an index is not below the length of its list.
    #[error("entry {index} of the list of {list} refers to a missing item or is out of order")]
    Number {
        /// The name of the list.
        list: &'static str,
        /// The index of the entry.
        index: usize,
    },
    /// The three points of a plane are collinear, so the plane has no normal.
    #[error("the three points of plane {0} lie on one line")]
    Plane(usize),
    /// The planes of a vertex do not meet in one point.
    #[error("the planes of vertex {0} do not meet in one point")]
    Vertex(u32),
    /// The position of a vertex in doubles is too far from the exact vertex.
    #[error("the position of vertex {0} in doubles is too far from the intersection of its planes")]
    Place(u32),
    /// A vertex of a face is off the face's plane.
    #[error("vertex {vertex} of face {face} is not in the face's plane")]
    OffPlane {
        /// The index of the face.
        face: u32,
        /// The number of the vertex.
        vertex: u32,
    },
    /// A face is not convex, has no area, or its vertices run clockwise around the normal of its plane.
    #[error("face {0} of the cells is not convex, or its vertices do not run counter-clockwise")]
    NotConvex(u32),
    /// A cell does not list one of its faces exactly once, or lists it on the wrong side.
    #[error("face {0} is not listed exactly once by each of its cells")]
    Sides(u32),
    /// The difference of the numbers of solids around the two cells of a face is not the number of solids
    /// that begin or end in the face.
    #[error(
        "the numbers of solids around the two cells of face {0} do not match the triangles of the face"
    )]
    Solids(u32),
    /// A face without a second cell is not on the border of the box.
    #[error("face {0} has only one cell but is not on the border of the box")]
    Border(u32),
    /// A vertex of a cell is beyond the plane of one of the cell's faces.
    #[error("vertex {vertex} of cell {cell} is beyond the plane of the cell's face {face}")]
    Beyond {
        /// The index of the cell.
        cell: u32,
        /// The index of the face.
        face: u32,
        /// The number of the vertex.
        vertex: u32,
    },
    /// All vertices of a cell lie in one plane.
    #[error("cell {0} has no volume")]
    Flat(u32),
    /// The faces of a cell leave a hole.
    #[error("the faces of cell {0} leave a hole")]
    Open(u32),
    /// The volumes of the cells do not add up to the volume of the box.
    #[error("the volumes of the cells do not add up to the volume of the box")]
    Volume,
    /// A face lists a triangle but does not lie in the triangle.
    #[error("face {face} lists triangle {triangle} but is not a part of the triangle")]
    NotOf {
        /// The index of the face.
        face: u32,
        /// The id of the triangle.
        triangle: u32,
    },
    /// The faces of cells on a triangle do not cover the triangle.
    #[error("the areas of the faces on triangle {0} do not add up to the area of the triangle")]
    NotCovered(u32),
}
