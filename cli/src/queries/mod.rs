//! Exact queries, as JSON Lines.

pub mod sightlines;
pub mod stab;
