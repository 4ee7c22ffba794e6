//! Tests of masks from valid and invalid PNG and JPEG files.

use super::*;

const HALF: Cutoff = Cutoff {
    factor: 1.0,
    least: 0.5,
};

/// Creates a PNG file from rows of raw samples.
fn png_file(
    [width, height]: [u32; 2],
    color: png::ColorType,
    depth: png::BitDepth,
    data: &[u8],
    change: impl Fn(&mut png::Encoder<'_, &mut Vec<u8>>),
) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    change(&mut encoder);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(data)
        .unwrap();
    out
}

/// Draws the texels of a mask: x for a blocking texel.
fn drawn(mask: &Mask) -> Vec<String> {
    let [width, height] = mask.size();
    let at = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n);
    let texel = |x, y| {
        if mask.blocks([at(x, width), at(y, height)]) {
            'x'
        } else {
            '.'
        }
    };
    (0..height)
        .map(|y| (0..width).map(|x| texel(x, y)).collect())
        .collect()
}

fn read(bytes: &[u8], cutoff: Cutoff) -> Result<Vec<String>, String> {
    mask(bytes, [WrapMode::Clamp; 2], cutoff, MOST_TEXELS).map(|m| drawn(&m))
}

/// Creates a grey JPEG of 8 × 8 texels with one coefficient.
fn jpeg_file([width, height]: [u16; 2]) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
    out.extend([1; 64]);
    let ([wh, wl], [hh, hl]) = (width.to_be_bytes(), height.to_be_bytes());
    out.extend([0xff, 0xc0, 0, 11, 8, hh, hl, wh, wl, 1, 1, 0x11, 0]);
    for class in [0x00, 0x10] {
        out.extend([0xff, 0xc4, 0, 20, class, 1]);
        out.extend([0; 16]);
    }
    out.extend([0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0, 0x3f, 0xff, 0xd9]);
    out
}

#[test]
fn texel_blocks_if_alpha_reaches_cutoff() {
    use png::{BitDepth, ColorType};
    // Alpha 0, 127, 128 and 255 of grey and of coloured texels. The other samples of a texel do not count.
    let alpha = [0u8, 127, 128, 255];
    let grey: Vec<u8> = alpha.into_iter().flat_map(|a| [255 - a, a]).collect();
    let color: Vec<u8> = alpha
        .into_iter()
        .flat_map(|a| [a, 255, 255 - a, a])
        .collect();
    let wide: Vec<u8> = alpha.into_iter().flat_map(|a| [9, 9, a, a]).collect();
    let plain = |_: &mut png::Encoder<'_, &mut Vec<u8>>| {};
    let files = [
        png_file(
            [4, 1],
            ColorType::GrayscaleAlpha,
            BitDepth::Eight,
            &grey,
            plain,
        ),
        png_file([4, 1], ColorType::Rgba, BitDepth::Eight, &color, plain),
        png_file(
            [4, 1],
            ColorType::GrayscaleAlpha,
            BitDepth::Sixteen,
            &wide,
            plain,
        ),
    ];
    for file in &files {
        assert_eq!(read(file, HALF).unwrap(), ["..xx"]);
        assert_eq!(
            read(
                file,
                Cutoff {
                    factor: 0.5,
                    least: 0.5
                }
            )
            .unwrap(),
            ["...x"],
            "equal blocks"
        );
        assert_eq!(
            read(
                file,
                Cutoff {
                    factor: 0.4,
                    least: 0.5
                }
            )
            .unwrap(),
            ["...."]
        );
        assert_eq!(
            read(
                file,
                Cutoff {
                    factor: 1.0,
                    least: 0.0
                }
            )
            .unwrap(),
            ["xxxx"]
        );
    }
    // A palette whose second colour is transparent, two texels per byte, and rows with an odd number of
    // texels.
    let palette = |e: &mut png::Encoder<'_, &mut Vec<u8>>| {
        e.set_palette(vec![1, 2, 3, 4, 5, 6, 7, 8, 9]);
        e.set_trns(vec![255, 0]);
    };
    let file = png_file(
        [3, 2],
        ColorType::Indexed,
        BitDepth::Four,
        &[0x01, 0x20, 0x10, 0x10],
        palette,
    );
    assert_eq!(read(&file, HALF).unwrap(), ["x.x", ".x."]);
    // Without an alpha channel all texels block. JPEG never has an alpha channel.
    let file = png_file([3, 1], ColorType::Rgb, BitDepth::Eight, &[0; 9], plain);
    assert_eq!(read(&file, HALF).unwrap(), ["xxx"]);
    assert_eq!(read(&jpeg_file([8, 8]), HALF).unwrap(), ["x"]);
    assert_eq!(
        read(
            &jpeg_file([8, 8]),
            Cutoff {
                factor: 0.2,
                least: 0.5
            }
        )
        .unwrap(),
        ["."]
    );
}

/// The file of the test below with Adam7 interlacing, which the encoder cannot write.
const INTERLACED: [u8; 76] = [
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52,
    0x00, 0x00, 0x00, 0x05, 0x00, 0x00, 0x00, 0x03, 0x08, 0x04, 0x00, 0x00, 0x01, 0x86, 0x38, 0x3d,
    0xe5, 0x00, 0x00, 0x00, 0x13, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x60, 0xf8, 0xcf, 0x00,
    0x47, 0x20, 0x88, 0x02, 0xfe, 0x43, 0x30, 0x00, 0xb1, 0x73, 0x07, 0xf9, 0x23, 0x58, 0x8f, 0x9a,
    0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
];

#[test]
fn interlaced_image_has_same_texels() {
    // 5 × 3 texels, grey with alpha. The texels with an even x + y are opaque.
    let plain = {
        let at = |i: u32| {
            if (i % 5 + i / 5).is_multiple_of(2) {
                [0, 255]
            } else {
                [0, 0]
            }
        };
        let data: Vec<u8> = (0..15).flat_map(at).collect();
        png_file(
            [5, 3],
            png::ColorType::GrayscaleAlpha,
            png::BitDepth::Eight,
            &data,
            |_| {},
        )
    };
    let expected = ["x.x.x", ".x.x.", "x.x.x"];
    assert_eq!(read(&plain, HALF).unwrap(), expected);
    assert_eq!(read(&INTERLACED, HALF).unwrap(), expected);
}

#[test]
fn rejects_bad_images_before_texel_allocation() {
    let plain = |_: &mut png::Encoder<'_, &mut Vec<u8>>| {};
    let file = |size: [u32; 2]| {
        // The header announces a larger image than the file contains.
        let mut file = png_file(
            [1, 1],
            png::ColorType::Rgba,
            png::BitDepth::Eight,
            &[0; 4],
            plain,
        );
        file[16..20].copy_from_slice(&size[0].to_be_bytes());
        file[20..24].copy_from_slice(&size[1].to_be_bytes());
        let sum = crc32(&file[12..29]);
        file[29..33].copy_from_slice(&sum.to_be_bytes());
        file
    };
    let noise: Vec<u8> = (0..64u32 * 64 * 4)
        .map(|i| (i * i / 7 * 31) as u8)
        .collect();
    let large = png_file(
        [64, 64],
        png::ColorType::Rgba,
        png::BitDepth::Eight,
        &noise,
        plain,
    );
    assert!(read(&large, HALF).is_ok());
    let jpeg = jpeg_file([8, 8]);
    let bad: [(&[u8], &str); 14] = [
        (
            &file([100_000, 1]),
            "100000 x 1 texels large, but width and height may be at most 32768",
        ),
        (
            &file([30_000, 30_000]),
            "30000 x 30000 texels large, but a texture may have at most 67108864 texels",
        ),
        (&file([0, 4]), "PNG image"),
        (&file([5, 5]), "cannot be decoded"),
        (&large[..large.len() / 2], "cannot be decoded"),
        (&large[..20], "cannot be decoded"),
        (&jpeg_file([60_000, 8]), "60000 x 8 texels large"),
        (&jpeg[..jpeg.len() - 2], "has no end marker (truncated?)"),
        (&jpeg[..40], "JPEG image cannot be decoded"),
        (b"", "the image is empty"),
        (
            b"\xabKTX 20\xbb\r\n\x1a\n",
            "the image has the format KTX2 (KHR_texture_basisu)",
        ),
        (b"RIFF\x04\0\0\0WEBPVP8 ", "the image has the format WebP"),
        (b"DDS |\0\0\0", "the image has the format DDS"),
        (b"hello", "the image is neither PNG nor JPEG"),
    ];
    for (bytes, said) in bad {
        let why = read(bytes, HALF).unwrap_err();
        assert!(why.contains(said), "{why:?} does not say {said:?}");
    }
    // The limit is lower if the scene has many textures.
    assert!(mask(&large, [WrapMode::Clamp; 2], HALF, 64 * 64 - 1).is_err());
    // A changed byte results in an image or an error, never in a panic.
    for at in (0..large.len()).step_by(97).chain(0..64) {
        let mut changed = large.clone();
        changed[at] ^= 0x41;
        let _ = read(&changed, HALF);
    }
    for at in 0..jpeg.len() {
        let mut changed = jpeg.clone();
        changed[at] ^= 0x41;
        let _ = read(&changed, HALF);
    }
}

/// Computes the checksum of a PNG chunk.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |sum: u32, byte: &u8| {
        (0..8).fold(sum ^ u32::from(*byte), |s, _| {
            if s & 1 == 1 {
                s >> 1 ^ 0xedb8_8320
            } else {
                s >> 1
            }
        })
    };
    !bytes.iter().fold(u32::MAX, step)
}
