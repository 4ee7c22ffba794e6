//! Closed surfaces: which triangles they hide from a view cell without a query.

mod closed;
mod crossing_order;
mod patches;
mod piercing;

pub use closed::{Hides, Surfaces};
