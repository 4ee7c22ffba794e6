//! Line space: Plücker vectors, convex cones of them, and the quadric of real lines (the Klein quadric).

pub(crate) mod cone;
pub(crate) mod forms;
pub(crate) mod klein;
pub(crate) mod polar;
pub(crate) mod space;
pub(crate) mod stabbing_polyhedron;

pub use space::Decisions;
