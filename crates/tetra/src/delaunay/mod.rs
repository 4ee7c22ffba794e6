//! Delaunay tetrahedra of points with exact decisions and consistent ties.
//!
//! The tetrahedra of Miszka, Ryan, Gain and Hultquist, "An Application of Tetrahedrisation to From-point
//! Visibility", 2004, section 2.1, are built from Delaunay tetrahedra.

mod build;
mod curve;
mod enclosure;
mod error;
mod mesh;
mod predicates;
mod ties;
mod walk;

pub use build::Delaunay;
pub use error::DelaunayError;
pub use mesh::NONE;
