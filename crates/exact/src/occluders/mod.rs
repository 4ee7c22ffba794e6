//! Occluders: convex sets of coplanar triangles, their boundary edges, and segments among them.

pub(crate) mod boundary_edges;
mod merge;
mod occluder;
pub(crate) mod segment;
mod set;

pub use occluder::{Occluder, OccluderId, OrientedOccluder};
pub use set::Occluders;
