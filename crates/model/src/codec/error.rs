//! The error of bytes that are not a tile's output.

/// The bytes are not a tile's output.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a tile's output cannot be read: {0}; it was damaged or written by another version")]
pub struct CodecError(pub(super) &'static str);
