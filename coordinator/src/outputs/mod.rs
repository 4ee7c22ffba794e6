//! Outputs of tiles: their checks and commits, and those that workers write to the blob store.

pub(crate) mod commit;
pub(crate) mod presigned;
pub(crate) mod staging;
