//! The bytes of a certificate: variable-length integers and little-endian floats, compressed with zstd.
//!
//! `docs/formats/certificate.md` describes every byte. Equal certificates have equal bytes. The decoder
//! accepts only the bytes that the encoder writes (before compression), checks every count against the bytes
//! that are left before it allocates, and every triangle id against the scene.

mod read;
#[cfg(test)]
mod tests;
mod write;

pub use read::{decode, decode_raw};
pub use write::encode;

/// Compression level of zstd, its default. Higher levels cost more time than the space they save is worth.
const LEVEL: i32 = 3;
/// Most bytes that the certificate of one cell may have before compression, hundreds of times those of a
/// complex cell.
const MAX_BYTES: u64 = 256 << 20;
/// Most memory that a decoded certificate may take. A step of one byte takes over thirty bytes in memory.
const MAX_MEMORY: usize = 4 << 30;

/// Added to the first number of the tail when hidden boxes follow; numbers without them are smaller.
const APART: u64 = 1 << 33;

/// Bytes that are not a valid certificate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the cell's certificate cannot be read: {0}; it is damaged or was written by another version"
)]
pub struct CodecError(&'static str);

impl CodecError {
    /// The first rule of the format that the bytes break.
    pub fn reason(&self) -> &'static str {
        self.0
    }
}
