//! Outputs of tiles: their checks, their commits, and the direct way of workers to the blob store.

pub(crate) mod commit;
pub(crate) mod presigned;
pub(crate) mod staging;
