//! The body of the fuzz target `tile`, which the tests call too.

use super::{MAX_UNPACKED, TileOutput, check, decode, encode, read};

/// Triangles of the scene that the outputs belong to.
const TRIANGLES: u32 = 1000;
/// Maximum number of bytes that an output may unpack to here, so that a run is fast.
const MOST: u64 = 4 << 20;

/// Decodes bytes as the output of a tile, once as they are and once after compression. Returns true if the
/// compressed bytes are an output.
///
/// # Panics
/// Panics if an output changes when it is encoded and decoded again, or if [`check`] rejects it. No bytes
/// may cause that.
pub fn tile(raw: &[u8]) -> bool {
    let _ = read(raw, TRIANGLES, (b"PC", MOST), &|_| true);
    let Ok(packed) = zstd::stream::encode_all(raw, 1) else {
        return false;
    };
    let Ok(output) = read(&packed, TRIANGLES, (b"PC", MOST), &|_| true) else {
        return false;
    };
    let is_pack = matches!(output, TileOutput::Pack(_));
    assert!(check(&packed, TRIANGLES, is_pack, MAX_UNPACKED).is_ok());
    assert!(check(&packed, TRIANGLES, !is_pack, MAX_UNPACKED).is_err());
    let again = encode(&output).map(|bytes| decode(&bytes, TRIANGLES));
    assert!(again.is_ok_and(|again| again == Ok(output)));
    true
}
