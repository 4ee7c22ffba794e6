//! The body of the fuzz target `tile`, which the tests also call.

use super::{MAX_UNPACKED, TileOutput, check, decode, encode, read};

/// The number of triangles of the scene to which the outputs belong.
const TRIANGLES: u32 = 1000;
/// Maximum unpacked size of an output in this target, in bytes. The limit is small, so that a run is fast.
const MOST: u64 = 4 << 20;

/// Decodes bytes as the output of a tile, first as given and then compressed with zstd. Returns true if the
/// compressed bytes are an output.
///
/// # Panics
/// Panics if an output changes when it is encoded and decoded again, or if [`check`] rejects it. No input may
/// cause a panic.
pub fn tile(raw: &[u8]) -> bool {
    let _ = read(raw, TRIANGLES, b"PC", MOST, &|_| true);
    let Ok(packed) = zstd::stream::encode_all(raw, 1) else {
        return false;
    };
    let Ok(output) = read(&packed, TRIANGLES, b"PC", MOST, &|_| true) else {
        return false;
    };
    let is_pack = matches!(output, TileOutput::Pack(_));
    assert!(check(&packed, TRIANGLES, is_pack, MAX_UNPACKED).is_ok());
    assert!(check(&packed, TRIANGLES, !is_pack, MAX_UNPACKED).is_err());
    let again = encode(&output).map(|bytes| decode(&bytes, TRIANGLES));
    assert!(again.is_ok_and(|again| again == Ok(output)));
    true
}
