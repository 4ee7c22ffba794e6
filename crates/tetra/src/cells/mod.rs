//! Convex cells that conform to the triangles of a scene.
//!
//! The authors of "An Application of Tetrahedrisation to From-point Visibility" let surfaces cut tetrahedra
//! (section 4.1.1). The authors refine an octree for good shapes, which creates far too many tetrahedra
//! (section 5.1). This module accepts any tetrahedra that fill a box face to face and whose corners are the
//! scene's points and the eight corners of the box. Each tetrahedron is cut by the planes of the triangles
//! that pass through its inside. The cuts cannot fail, even if triangles cross, overlap or end on one
//! another. Every vertex of a cell is a point of the input or the intersection of three planes of the input.
//! Every decision is the exact sign of a determinant. No decision uses a rounded number.

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
pub use result::{CellCounts, CellRecord, Cells, CellsView, FaceRecord};
