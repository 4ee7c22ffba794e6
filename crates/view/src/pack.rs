//! The blocks of data in a page: compressed with gzip and encoded in base64.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use sightline_scene::{Scene, TriangleId};

use crate::{View, ViewError};

/// Compresses `bytes` with gzip and encodes the result in base64.
pub fn block(bytes: &[u8]) -> Result<String, ViewError> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes)?;
    Ok(STANDARD.encode(out.finish()?))
}

/// Returns the triangles of a scene as 37 bytes per triangle.
///
/// For each of the 4 bytes of an `f32`, and for each of the 9 coordinates of a triangle, the result contains
/// the bytes of all triangles, because similar bytes are then adjacent. One byte per triangle follows: bit 0
/// if the triangle blocks, bit 1 if the triangle shows.
pub fn triangles(scene: &Scene) -> Vec<u8> {
    let count = scene.triangles().len();
    let mut out = vec![0; 37 * count];
    for (i, triangle) in scene.triangles().iter().enumerate() {
        for (c, x) in triangle.v.iter().flat_map(|v| v.to_array()).enumerate() {
            for (b, byte) in x.to_le_bytes().into_iter().enumerate() {
                out[(b * 9 + c) * count + i] = byte;
            }
        }
        let kind = scene.kinds().kind(TriangleId(i as u32));
        out[36 * count + i] = u8::from(kind.blocks()) | u8::from(kind.shows()) << 1;
    }
    out
}

/// Returns the numbers of the heat maps as little-endian `f32`, map by map, then three coordinates of a
/// viewpoint per cell.
pub fn values(view: &View<'_>) -> Vec<u8> {
    let maps = view.maps.iter().flat_map(|map| &map.values);
    maps.chain(view.places.iter().flatten())
        .flat_map(|x| x.to_le_bytes())
        .collect()
}
