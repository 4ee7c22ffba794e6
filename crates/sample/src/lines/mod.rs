//! The default sampler: sight lines that are shared by all cells they cross.
//!
//! A maximal free segment runs from one triangle to another (or to the sky) and shows both its ends to every
//! cell it crosses (Bittner et al. 2009, "Adaptive Global Visibility Sampling"). The cells of a block share
//! one table of the triangles seen from each ([`bits`](sightline_trace::lines::bits)). Lines are traced in
//! packets ([`sightline_trace::packet`]), coherent where their directions are alike, and walked through the
//! cells ([`grid`](sightline_trace::lines::grid)). Four kinds of lines ([`sightline_model::LineKind`]) find
//! missing triangles, in rounds ([`rounds`]), until a cell's own estimate of its missing part is small
//! enough; [`bound`] then computes a bound from held-out lines.
//!
//! A result does not depend on the number or timing of threads: every decision reads the state of the last
//! barrier or the triangles that its cell newly found.

mod adaptive;
pub mod block;
pub mod bound;
mod candidates;
mod each;
mod finds;
mod flood;
mod guided;
pub mod hits;
mod items;
pub mod joining;
pub mod ledger;
mod on_device;
mod on_device_state;
mod pace;
pub mod pairs;
mod phase;
pub mod rounds;
mod seeds;
mod tile;
mod uniform;
mod work;
mod yields;

pub use tile::run;
