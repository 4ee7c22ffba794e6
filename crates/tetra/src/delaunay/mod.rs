//! The Delaunay tetrahedra of points: every decision exact, every tie broken in one consistent way.
//!
//! The tetrahedra of Miszka, Ryan, Gain and Hultquist, "An Application of Tetrahedrisation to
//! From-point Visibility", 2004, section 2.1, start from these.

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
