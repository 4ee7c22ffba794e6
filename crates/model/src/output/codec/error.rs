//! The error of bytes that are not a tile's output.

/// The bytes are not a tile's output.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a tile's output cannot be read: {0}; it was damaged or written by another version")]
pub struct CodecError(pub(super) &'static str);

/// The reason of an output that unpacks to more than was allowed.
pub(super) const TOO_LARGE: &str = "it unpacks to more than its tile can have";

impl CodecError {
    /// Returns true if the bytes unpack to more than was allowed.
    pub fn is_too_large(&self) -> bool {
        self.0 == TOO_LARGE
    }
}
