//! Blocks of view cells that share sight lines.
//!
//! The modules contain the grid of the cells, the table of the triangles seen from each cell, and the
//! interface of devices that cast whole rounds of lines.

pub mod bits;
pub mod device;
pub mod grid;
pub mod packet_walk;
pub mod pairs;
pub mod tally;

/// The maximum number of steps of a flood from a found triangle to its neighbours.
pub const FLOOD_STEPS: u32 = 4;
