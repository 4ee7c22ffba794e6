//! The stored blobs: which of them records refer to, and whose they are.

pub mod ownership;
pub mod references;
