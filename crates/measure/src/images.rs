//! A frame as a picture: sky black, visible triangles of the set green, wrong triangles red.
//!
//! The picture has three faces by two: +x +y +z above −x −y −z. Each face is as a viewer sees it, with its up
//! vector upwards and its name in its upper left corner. Each triangle has a separate shade, so that shapes
//! can be distinguished.

use std::io::Write as _;
use std::path::Path;

use sightline_files::{Access, NewFile};
use sightline_trace::{CubeImage, SKY};

use crate::error::MeasureError;
use crate::pixel::is_wrong;

/// The colour of triangles in the set, before shading.
pub const SEEN: [u8; 3] = [60, 170, 80];
/// The colour of triangles that are missing from the set, before shading.
pub const WRONG: [u8; 3] = [210, 40, 40];

/// Writes a cube image as a PNG of 3n × 2n pixels. `visible` is the cell's set as bits.
pub(crate) fn write(path: &Path, image: &CubeImage, visible: &[u64]) -> Result<(), MeasureError> {
    let failed = |reason: String| MeasureError::Image {
        path: path.to_owned(),
        reason,
    };
    let mut file = NewFile::begin(path, Access::Shared).map_err(|e| failed(e.to_string()))?;
    let n = image.resolution;
    let mut encoder = png::Encoder::new(&mut file, 3 * n, 2 * n);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|e| failed(e.to_string()))?;
    // Write row by row: a whole picture of the largest cubes would need hundreds of megabytes.
    let mut stream = writer.stream_writer().map_err(|e| failed(e.to_string()))?;
    let mut line = Vec::with_capacity(n as usize * 9);
    for row in 0..2 * n {
        line.clear();
        for column in 0..3 {
            // Both faces of an axis have equal right and up vectors. Seen along the positive axis, the image
            // is a mirror image, which is reversed here.
            let (face, mirrored) = (column * 2 + row / n, row < n);
            let y = n - 1 - row % n;
            for x in 0..n {
                let is_label = is_label(face, x, row % n, n);
                let x = if mirrored { n - 1 - x } else { x };
                let seen = colour(image.ids[((face * n + y) * n + x) as usize], visible);
                line.extend(if is_label { [255; 3] } else { seen });
            }
        }
        stream.write_all(&line).map_err(|e| failed(e.to_string()))?;
    }
    stream.finish().map_err(|e| failed(e.to_string()))?;
    writer.finish().map_err(|e| failed(e.to_string()))?;
    file.commit().map_err(|e| failed(e.to_string()))
}

/// The glyphs of the faces' names, with five rows of five bits each.
const SIGNS: [[u8; 5]; 2] = [
    [0b00100, 0b00100, 0b11111, 0b00100, 0b00100],
    [0b00000, 0b00000, 0b11111, 0b00000, 0b00000],
];
const AXES: [[u8; 5]; 3] = [
    [0b10001, 0b01010, 0b00100, 0b01010, 0b10001],
    [0b10001, 0b01010, 0b00100, 0b00100, 0b00100],
    [0b11111, 0b00010, 0b00100, 0b01000, 0b11111],
];

/// Returns true if a pixel of a face, counted from its upper left corner, is part of the face's name. Faces
/// of fewer than 64 pixels per side have no room for a name.
fn is_label(face: u32, x: u32, y: u32, n: u32) -> bool {
    let dot = n / 64;
    let Some((column, row)) = x.checked_div(dot).zip(y.checked_div(dot)) else {
        return false;
    };
    let Some(row) = row.checked_sub(1).filter(|row| *row < 5) else {
        return false;
    };
    let glyph = match column {
        1..=5 => SIGNS[(face % 2) as usize],
        7..=11 => AXES[(face / 2) as usize],
        _ => return false,
    };
    let bit = 4 - (column - 1) % 6;
    glyph[row as usize] >> bit & 1 == 1
}

/// Returns the colour of a pixel that shows `id`.
pub(crate) fn colour(id: u32, visible: &[u64]) -> [u8; 3] {
    if id == SKY {
        return [0; 3];
    }
    // Multiplicative hashing by the golden ratio (Knuth) gives neighbouring ids distant shades, from 80 to
    // 120 percent.
    let shade = 80 + (id.wrapping_mul(0x9e37_79b9) >> 16) * 41 / 65536;
    let base = if is_wrong(visible, id) { WRONG } else { SEEN };
    base.map(|c| (u32::from(c) * shade / 100).min(255) as u8)
}
