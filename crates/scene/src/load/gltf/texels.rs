//! The texels of an image file, PNG or JPEG, as a mask: texels whose alpha reaches the cutoff block.
//!
//! The size in the file's header is checked before memory for the texels is allocated. The crate `png`
//! decodes PNG. JPEG has no alpha channel, so all its texels are equal: the crate `zune-jpeg` reads its
//! headers, and no texel is decoded.

use std::io::Cursor;

use png::{Decoder, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::masks::{Mask, WrapMode};

/// Maximum width and height of a texture in texels. No graphics API supports larger textures.
const MOST_SIDE: u32 = 1 << 15;
/// Maximum number of texels of a texture, equal to a square of 8192.
pub(super) const MOST_TEXELS: u64 = 1 << 26;
/// Maximum memory in bytes that the PNG decoder may allocate in addition to the texels.
const DECODER_BYTES: usize = 1 << 26;

/// The comparison that determines if a texel blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cutoff {
    /// The alpha of the material's base colour, which multiplies the alpha of the texel.
    pub(super) factor: f64,
    /// The minimum product of both alphas for which a texel blocks.
    pub(super) least: f64,
}

impl Cutoff {
    /// Returns true if a texel with this alpha (0 to 1) blocks.
    pub(super) fn closes(self, alpha: f64) -> bool {
        alpha * self.factor >= self.least
    }
}

/// The image formats that the loader recognises but does not read: the offset of the magic number in the
/// file, the magic number, and the name of the format.
const OTHERS: [(usize, &[u8], &str); 8] = [
    (0, b"\xabKTX 20\xbb", "KTX2 (KHR_texture_basisu)"),
    (0, b"\xabKTX 11\xbb", "KTX"),
    (8, b"WEBP", "WebP (EXT_texture_webp)"),
    (0, b"DDS ", "DDS (MSFT_texture_dds)"),
    (4, b"ftypavif", "AVIF (EXT_texture_avif)"),
    (0, b"GIF8", "GIF"),
    (0, b"BM", "BMP"),
    (0, b"sB", "Basis Universal"),
];

/// Creates the mask of the image file `bytes`, which may have at most `most` texels.
///
/// # Errors
/// A description of the fault.
pub(super) fn mask(
    bytes: &[u8],
    wrap: [WrapMode; 2],
    cutoff: Cutoff,
    most: u64,
) -> Result<Mask, String> {
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return png(bytes, wrap, cutoff, most).map_err(|why| format!("the PNG image {why}"));
    }
    if bytes.starts_with(b"\xff\xd8\xff") {
        return jpeg(bytes, wrap, cutoff, most).map_err(|why| format!("the JPEG image {why}"));
    }
    let known = OTHERS
        .iter()
        .find(|(at, magic, _)| bytes.get(*at..).is_some_and(|b| b.starts_with(magic)));
    Err(match known {
        Some((.., name)) => {
            format!("the image has the format {name}; supported formats are PNG and JPEG")
        }
        None if bytes.is_empty() => "the image is empty".to_owned(),
        None => "the image is neither PNG nor JPEG".to_owned(),
    })
}

/// Checks the size of an image before its texels are allocated.
fn check_size(size: [u32; 2], most: u64) -> Result<(), String> {
    let [width, height] = size;
    if width == 0 || height == 0 {
        return Err("has no texels".to_owned());
    }
    if width > MOST_SIDE || height > MOST_SIDE {
        return Err(format!(
            "is {width} x {height} texels large, but width and height may be at most {MOST_SIDE}"
        ));
    }
    if u64::from(width) * u64::from(height) > most {
        return Err(format!(
            "is {width} x {height} texels large, but a texture may have at most {MOST_TEXELS} texels, or \
             fewer if the scene has many textures"
        ));
    }
    Ok(())
}

fn png(bytes: &[u8], wrap: [WrapMode; 2], cutoff: Cutoff, most: u64) -> Result<Mask, String> {
    let unreadable = |e: png::DecodingError| format!("cannot be decoded: {e}");
    let limits = png::Limits {
        bytes: DECODER_BYTES,
    };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    // Palettes and colour keys become alpha channels, and samples have 8 or 16 bits.
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let header = decoder.read_header_info().map_err(unreadable)?;
    let size = [header.width, header.height];
    check_size(size, most)?;
    let mut reader = decoder.read_info().map_err(unreadable)?;
    let (color, depth) = reader.output_color_type();
    let (samples, alpha) = match color {
        png::ColorType::Grayscale => (1, false),
        png::ColorType::GrayscaleAlpha => (2, true),
        png::ColorType::Rgb => (3, false),
        png::ColorType::Rgba => (4, true),
        png::ColorType::Indexed => return Err("has a palette that was not expanded".to_owned()),
    };
    let wide = depth == png::BitDepth::Sixteen;
    let texel = samples * if wide { 2 } else { 1 };
    let mut mask = Mask::open(size, wrap);
    let mut at = 0;
    // Alpha is the last sample of a texel.
    let mut take = |row: &[u8]| {
        for texel in row.chunks_exact(texel).take(size[0] as usize) {
            let value = match *texel {
                _ if !alpha => 1.0,
                [.., high, low] if wide => f64::from(u16::from_be_bytes([high, low])) / 65535.0,
                [.., value] => f64::from(value) / 255.0,
                [] => 0.0,
            };
            if cutoff.closes(value) {
                mask.close(at);
            }
            at += 1;
        }
    };
    if reader.info().interlaced {
        // The buffer has at most eight bytes per accepted texel.
        let all = reader
            .output_buffer_size()
            .ok_or("does not fit in memory")?;
        let mut pixels = vec![0; all];
        reader.next_frame(&mut pixels).map_err(unreadable)?;
        pixels
            .chunks_exact(size[0] as usize * texel)
            .for_each(&mut take);
    } else {
        for _ in 0..size[1] {
            let row = reader
                .next_row()
                .map_err(unreadable)?
                .ok_or("ends before its last texel")?;
            take(row.data());
        }
    }
    // A file that ends early is damaged, even if all texels were read.
    reader.finish().map_err(unreadable)?;
    Ok(mask)
}

fn jpeg(bytes: &[u8], wrap: [WrapMode; 2], cutoff: Cutoff, most: u64) -> Result<Mask, String> {
    let side = usize::from(u16::MAX);
    let options = DecoderOptions::default()
        .set_max_width(side)
        .set_max_height(side);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder
        .decode_headers()
        .map_err(|e| format!("cannot be decoded: {e}"))?;
    let (width, height) = decoder.dimensions().ok_or("has no size")?;
    check_size(
        [width, height].map(|n| u32::try_from(n).unwrap_or(u32::MAX)),
        most,
    )?;
    // The end marker follows the marker of the last coded texels. Neither occurs within coded texels, and a
    // preview among the headers has both earlier.
    let last = |marker: u8| bytes.windows(2).rposition(|two| two == [0xff, marker]);
    if last(0xd9) < last(0xda) {
        return Err("has no end marker (truncated?)".to_owned());
    }
    let mut mask = Mask::open([1, 1], wrap);
    if cutoff.closes(1.0) {
        mask.close(0);
    }
    Ok(mask)
}

#[cfg(test)]
#[path = "texels_tests.rs"]
mod tests;
