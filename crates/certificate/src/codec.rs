//! The bytes of a certificate: variable-length integers and little-endian floats, compressed with zstd.
//!
//! `docs/formats/certificate.md` describes every byte. Equal certificates have equal bytes. The decoder
//! accepts only bytes that the encoder writes (before compression). It checks every count against the
//! remaining bytes before it allocates memory, and every triangle id against the scene.

mod read;
#[cfg(test)]
mod tests;
mod write;

pub use read::{decode, decode_raw};
pub use write::encode;

/// The compression level of zstd, its default. Higher levels cost more time than their smaller files justify.
const LEVEL: i32 = 3;
/// The maximum uncompressed size of a cell's certificate in bytes, hundreds of times the size for a complex
/// cell.
const MAX_BYTES: u64 = 256 << 20;
/// The maximum memory of a decoded certificate, in bytes. A step of one byte needs more than thirty bytes of
/// memory.
const MAX_MEMORY: usize = 4 << 30;

/// The number that the encoder adds to the first number after the hidden groups if hidden boxes follow.
/// Without hidden boxes, that first number is smaller.
const APART: u64 = 1 << 33;

/// The error that bytes are not a valid certificate, with the first broken rule of the format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the cell's certificate cannot be read: {0}; the bytes are damaged or from another version of the program"
)]
pub struct CodecError(&'static str);

impl CodecError {
    /// Returns the first rule of the format that the bytes break.
    pub fn reason(&self) -> &'static str {
        self.0
    }
}
