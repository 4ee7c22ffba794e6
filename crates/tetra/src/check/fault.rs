//! What is wrong with cells.

/// The first fault that the checker found. Cells that are faulty were altered, or made by a faulty program:
/// make them again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The points are not those of the surfaces and the corners of a box around them.
    #[error("the points are not those of the scene and the corners of a box around them")]
    Points,
    /// A list ends too early, or a number is not below the length of its list.
    #[error("entry {index} of the list of {list} names nothing, or is out of order")]
    Number {
        /// The list.
        list: &'static str,
        /// Its entry.
        index: usize,
    },
    /// A plane has no normal.
    #[error("the points of plane {0} lie on a line")]
    Plane(usize),
    /// A vertex is not one point.
    #[error("the planes of vertex {0} do not meet in one point")]
    Vertex(u32),
    /// A vertex's place in doubles is too far from it.
    #[error("the place of vertex {0} in doubles is too far from where its planes meet")]
    Place(u32),
    /// A face's vertex is off its plane.
    #[error("vertex {vertex} of face {face} is not in the face's plane")]
    OffPlane {
        /// The face.
        face: u32,
        /// The vertex.
        vertex: u32,
    },
    /// A face is not convex, or turns the wrong way.
    #[error("face {0} is not convex and counter-clockwise")]
    NotConvex(u32),
    /// A face is not listed once in front of one cell and once behind another.
    #[error("face {0} is not listed once by each of its two cells")]
    Sides(u32),
    /// The solids around the cells of a face are not those that begin or end in it.
    #[error("the solids around the cells of face {0} do not agree with its triangles")]
    Solids(u32),
    /// A face without a second cell is not on the box.
    #[error("face {0} has one cell and is not on the box")]
    Border(u32),
    /// A vertex of a cell is beyond one of its faces.
    #[error("vertex {vertex} of cell {cell} is beyond its face {face}")]
    Beyond {
        /// The cell.
        cell: u32,
        /// The face.
        face: u32,
        /// The vertex.
        vertex: u32,
    },
    /// All of a cell lies in one plane.
    #[error("cell {0} has no inside")]
    Flat(u32),
    /// The faces of a cell leave a hole.
    #[error("the faces of cell {0} do not close")]
    Open(u32),
    /// The cells' volumes are not the box's.
    #[error("the volumes of the cells do not add up to the box's")]
    Volume,
    /// A face that names a triangle is not in it.
    #[error("face {face} is not a part of triangle {triangle}, which it names")]
    NotOf {
        /// The face.
        face: u32,
        /// The triangle.
        triangle: u32,
    },
    /// A triangle's faces do not cover it.
    #[error("the faces of triangle {0} do not add up to it")]
    NotCovered(u32),
}
