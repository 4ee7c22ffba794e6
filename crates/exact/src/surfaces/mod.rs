//! Closed surfaces: triangles that a surface hides from a view cell without a query.

mod closed;
mod crossing_order;
mod patches;
mod piercing;

pub use closed::{HiddenFrom, Surfaces};
