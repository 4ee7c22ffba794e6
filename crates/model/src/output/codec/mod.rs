//! Bytes for packs and cell sets: differences as variable-length integers, then zstd.
//!
//! Equal values give equal bytes, so the digest of the bytes identifies the content. Decoding trusts nothing:
//! every count is checked against the remaining bytes before anything is allocated for it.

mod error;
#[doc(hidden)]
pub mod fuzzing;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::io::Read as _;

use sightline_viewcells::{CellBox, LatticePoint};

use crate::output::{Pack, TileOutput};
use read::Reader;

pub use error::CodecError;
pub use write::encode;

/// Most bytes one tile's output may unpack to: far above any real tile, far below a machine's memory.
pub const MAX_UNPACKED: u64 = 4 << 30;

/// Decodes a tile's output for a scene of `triangles` triangles.
///
/// # Errors
/// [`CodecError`] saying what is wrong.
pub fn decode(bytes: &[u8], triangles: u32) -> Result<TileOutput, CodecError> {
    read(bytes, triangles, (b"PC", MAX_UNPACKED), &|_| true)
}

/// Checks a tile's output without keeping its samples: a pack comes back empty. Samples in place of cells,
/// or the other way round, are refused by their first byte, and what unpacks to more than `most` bytes is
/// not unpacked further: a few kilobytes could be made to take gigabytes.
///
/// # Errors
/// [`CodecError`] saying what is wrong.
pub fn check(
    bytes: &[u8],
    triangles: u32,
    is_pack: bool,
    most: u64,
) -> Result<TileOutput, CodecError> {
    let kind: &[u8] = if is_pack { b"P" } else { b"C" };
    read(bytes, triangles, (kind, most.min(MAX_UNPACKED)), &|_| false)
}

/// Decodes a pack, keeping only the samples in the closed box `within`: a leaf tile needs few of a face's
/// samples.
///
/// # Errors
/// [`CodecError`] when the bytes are no pack; also those parts that are not kept are checked.
pub fn decode_pack(bytes: &[u8], triangles: u32, within: &CellBox) -> Result<Pack, CodecError> {
    match read(bytes, triangles, (b"P", MAX_UNPACKED), &|p| {
        within.contains(p)
    })? {
        TileOutput::Pack(pack) => Ok(pack),
        TileOutput::Cells(_) => Err(CodecError("it holds cells and not samples")),
    }
}

fn read(
    bytes: &[u8],
    triangles: u32,
    (kinds, most): (&[u8], u64),
    keep: &dyn Fn(LatticePoint) -> bool,
) -> Result<TileOutput, CodecError> {
    let bad = |_| CodecError("it is not zstd data");
    let mut unpacked = zstd::stream::Decoder::new(bytes).map_err(bad)?;
    let mut raw = Vec::new();
    unpacked
        .by_ref()
        .take(1)
        .read_to_end(&mut raw)
        .map_err(bad)?;
    if !raw.iter().all(|kind| kinds.contains(kind)) {
        return Err(CodecError("its kind is unknown, or not that of its tile"));
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
        _ => return Err(CodecError("its kind is unknown")),
    };
    if r.bytes.is_empty() {
        Ok(output)
    } else {
        Err(CodecError("there is more than it announces"))
    }
}
