//! Tests of several components together, on a coordinator in memory.

mod ambient;
pub(crate) mod life;
mod load;
mod outcomes;
mod presigned;
mod reopening;
mod retention;
mod trust;
