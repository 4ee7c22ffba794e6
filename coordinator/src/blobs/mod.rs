//! The stored blobs: their references from records, and their owners.

pub mod ownership;
pub mod references;
