//! Tile outputs: their checks, their commits, and the direct access of workers to the blob store.

pub(crate) mod commit;
pub(crate) mod presigned;
pub(crate) mod staged_outputs;
