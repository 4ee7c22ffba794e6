//! Convex cells that conform to the triangles of a scene.
//!
//! The authors of "An Application of Tetrahedrisation to From-point Visibility" let surfaces cut tetrahedra
//! (section 4.1.1) and refine an octree for good shapes, which makes far too many (section 5.1). Here the
//! tetrahedra are any that fill a box face to face and whose corners are the scene's points, and each is cut
//! by the planes of the triangles that pass through its inside. That cannot fail, whatever the triangles do:
//! cross, overlap, end on one another. Every vertex is a point of the input or the meet of three planes of
//! the input, and every decision is the sign of a determinant, decided exactly. Nothing is rounded.

pub mod bsp;
pub mod build;
pub mod facets;
pub mod flood;
pub mod input;
pub mod local;
pub mod number;
pub mod planes;
pub mod polygon;
pub mod result;

pub use build::cells;
pub use input::{CellsError, Tetrahedra};
pub use planes::{NONE, Plane};
pub use result::{CellRecord, Cells, CellsView, Counts, FaceRecord};
