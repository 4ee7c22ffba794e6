//! The default sampler: sight lines that all crossed cells share.
//!
//! A maximal free segment runs from one triangle to another (or to the sky) and shows both its ends to every
//! cell that it crosses (Bittner et al. 2009, "Adaptive Global Visibility Sampling"). The cells of a block
//! share one table of the triangles seen from each cell ([`bits`](sightline_trace::lines::bits)). Lines are
//! traced in packets ([`sightline_trace::packet`]), coherent if their directions are similar. The lines are
//! then traced through the cells ([`grid`](sightline_trace::lines::grid)). Four kinds of lines
//! ([`sightline_model::LineKind`]) find missing triangles, in rounds ([`rounds`]), until a cell's estimated
//! missed fraction is small enough. [`bound`] then computes a bound from held-out lines.
//!
//! A result does not depend on the number or timing of threads. Every decision reads the state of the last
//! barrier or the triangles that its cell newly found.

mod adaptive;
pub mod block;
pub mod bound;
mod candidates;
pub mod cell_joins;
mod cell_pieces;
mod cell_table;
mod completion;
mod finds;
mod flood;
mod frontier;
mod guided;
mod guided_shared;
pub mod hits;
mod items;
pub mod likely_items;
pub mod observer;
mod on_device;
mod on_device_state;
mod pacing;
pub mod pairs;
mod phase;
pub mod rounds;
mod seeds;
mod tile;
mod tile_sampling;
mod uniform;
mod yields;

pub use tile::run;
