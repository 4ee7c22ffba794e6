//! The error type of the decoder of tile outputs.

/// An error of bytes that are not a tile's output; the text is the reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "a tile's output cannot be read: {0}; the bytes are damaged, or another version wrote them"
)]
pub struct CodecError(pub(super) &'static str);

/// The reason for an output that unpacks to more bytes than the caller allowed.
pub(super) const TOO_LARGE: &str = "the unpacked size exceeds the tile's limit";

impl CodecError {
    /// Returns true if the bytes unpack to more than the caller allowed.
    pub fn is_too_large(&self) -> bool {
        self.0 == TOO_LARGE
    }
}
