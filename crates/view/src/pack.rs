//! The blocks of data in a page: gzipped, in base64.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use sightline_scene::Scene;

use crate::{View, ViewError};

/// Bytes as a block.
pub fn block(bytes: &[u8]) -> Result<String, ViewError> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes)?;
    Ok(STANDARD.encode(out.finish()?))
}

/// The triangles of a scene: for each of the 4 bytes and 9 coordinates of a triangle's corners the bytes of
/// all triangles, because equal ones stand together then; and a byte a triangle: bit 0 blocks, bit 1 shows.
pub fn triangles(scene: &Scene) -> Vec<u8> {
    let count = scene.triangles().len();
    let mut out = vec![0; 37 * count];
    for (i, triangle) in scene.triangles().iter().enumerate() {
        for (c, x) in triangle.v.iter().flat_map(|v| v.to_array()).enumerate() {
            for (b, byte) in x.to_le_bytes().into_iter().enumerate() {
                out[(b * 9 + c) * count + i] = byte;
            }
        }
        let kind = scene.kinds().kind(i as u32);
        out[36 * count + i] = u8::from(kind.blocks()) | u8::from(kind.shows()) << 1;
    }
    out
}

/// The numbers of the heat maps, each for all cells, then three coordinates of a viewpoint for each cell.
pub fn values(view: &View<'_>) -> Vec<u8> {
    let maps = view.maps.iter().flat_map(|map| &map.values);
    maps.chain(view.places.iter().flatten())
        .flat_map(|x| x.to_le_bytes())
        .collect()
}
