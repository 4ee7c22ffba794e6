//! The encoding of packs and cell sets: differences as variable-length integers, then zstd.
//!
//! Equal values have equal bytes, so the digest of the bytes identifies the content. The decoder checks every
//! count against the remaining bytes before it allocates memory for the counted values.

mod error;
#[doc(hidden)]
pub mod fuzzing;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::io::Read as _;

use sightline_numbers::memory::other_than_exhaustion;
use sightline_viewcells::{CellBox, LatticePoint};

use crate::output::{Pack, TileOutput};
use read::Reader;

pub use error::CodecError;
pub use write::encode;

/// Maximum unpacked size of a tile's output, in bytes: far above real tiles, and far below a machine's
/// memory.
pub const MAX_UNPACKED: u64 = 4 << 30;

/// Decodes a tile's output for a scene of `triangles` triangles.
///
/// # Errors
/// [`CodecError`] with the first fault of the bytes.
pub fn decode(bytes: &[u8], triangles: u32) -> Result<TileOutput, CodecError> {
    read(bytes, triangles, b"PC", MAX_UNPACKED, &|_| true)
}

/// Checks a tile's output without storing its samples: the returned pack is empty.
///
/// The first byte distinguishes samples from cells: the output must contain samples if `is_pack` is true, and
/// cells otherwise. Unpacking stops after `most` bytes, because a few kilobytes could unpack to gigabytes.
///
/// # Errors
/// [`CodecError`] with the first fault of the bytes.
pub fn check(
    bytes: &[u8],
    triangles: u32,
    is_pack: bool,
    most: u64,
) -> Result<TileOutput, CodecError> {
    let kind: &[u8] = if is_pack { b"P" } else { b"C" };
    read(bytes, triangles, kind, most.min(MAX_UNPACKED), &|_| false)
}

/// Decodes a pack and keeps only the samples in the closed box `within`. A leaf tile needs few of a face's
/// samples.
///
/// # Errors
/// [`CodecError`] if the bytes are not a pack. Samples outside the box are also checked.
pub fn decode_pack(bytes: &[u8], triangles: u32, within: &CellBox) -> Result<Pack, CodecError> {
    match read(bytes, triangles, b"P", MAX_UNPACKED, &|p| {
        within.contains(p)
    })? {
        TileOutput::Pack(pack) => Ok(pack),
        TileOutput::Cells(_) => Err(CodecError("the bytes contain cells in place of samples")),
    }
}

fn read(
    bytes: &[u8],
    triangles: u32,
    kinds: &[u8],
    most: u64,
    keep: &dyn Fn(LatticePoint) -> bool,
) -> Result<TileOutput, CodecError> {
    let bad = |e| {
        other_than_exhaustion(e);
        CodecError("the bytes are not zstd data")
    };
    let mut unpacked = zstd::stream::Decoder::new(bytes).map_err(bad)?;
    let mut raw = Vec::new();
    unpacked
        .by_ref()
        .take(1)
        .read_to_end(&mut raw)
        .map_err(bad)?;
    if !raw.iter().all(|kind| kinds.contains(kind)) {
        return Err(CodecError(
            "the first byte is not the P of samples or the C of cells that the tile requires",
        ));
    }
    unpacked.take(most).read_to_end(&mut raw).map_err(bad)?;
    if raw.len() as u64 > most {
        return Err(CodecError(error::TOO_LARGE));
    }
    let mut r = Reader {
        bytes: &raw,
        triangles,
        room: most,
    };
    let output = match r.byte()? {
        b'P' => TileOutput::Pack(r.pack(keep)?),
        b'C' => TileOutput::Cells(r.cells()?),
        _ => return Err(CodecError("the first byte is not the letter P or C")),
    };
    if r.bytes.is_empty() {
        Ok(output)
    } else {
        Err(CodecError("further bytes follow the end of the output"))
    }
}
