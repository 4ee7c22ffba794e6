//! The outputs of tiles: sets, samples and pairs of cells, their statistics, and their encoding.

pub mod bound;
pub mod codec;
pub mod pairs;
mod sets;
pub mod statistics;

pub use sets::*;
