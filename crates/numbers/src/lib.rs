//! Number types and number streams that the other crates share.
//!
//! This crate knows nothing of triangles, cells or results.

pub mod integer;
