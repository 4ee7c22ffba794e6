//! The placement of rectangles in one image, with gaps between them.
//!
//! Rectangles are placed in rows, the highest first. This leaves more of the image empty than packing by
//! shape, but is very fast even for a hundred thousand charts.

use crate::TexelsError;
use crate::error::MOST_SIDE;
use crate::settings::TextureSize;

/// The numbers of empty texels around each rectangle that `pack` tries, in this order, until all rectangles
/// fit. Two rectangles are at least twice as far apart.
const GAPS: [u32; 3] = [4, 2, 1];

/// The positions of the packed rectangles, the scale and the size of the image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Packed {
    /// The upper left corner of each rectangle, in texels.
    pub at: Vec<[u32; 2]>,
    /// The number of texels per unit of the scene.
    pub per_unit: f64,
    /// The size of the image in texels.
    pub size: [u32; 2],
    /// The number of empty texels around each rectangle.
    pub gap: u32,
}

/// Places rectangles in one image. `sizes` contains their widths and heights in units of the scene, `size`
/// determines the scale, and `file` is the name of the file in errors.
pub(crate) fn pack(
    file: &str,
    sizes: &[[f64; 2]],
    size: TextureSize,
) -> Result<Packed, TexelsError> {
    let found = |gap: &u32| match size {
        TextureSize::Texel(texel) => by_texel(sizes, texel, *gap),
        TextureSize::Resolution(side) => by_side(sizes, side, *gap),
    };
    GAPS.iter().find_map(found).ok_or_else(|| match size {
        TextureSize::Texel(texel) => {
            let texels = sizes.iter().map(|s| s[0] * s[1] / (texel * texel)).sum();
            TexelsError::TooManyTexels {
                file: file.to_owned(),
                texels,
            }
        }
        TextureSize::Resolution(side) => TexelsError::TooManyCharts {
            file: file.to_owned(),
            charts: sizes.len() as u32,
            side,
        },
    })
}

/// Converts a width or height from units of the scene to whole texels, at least 1.
fn texels(units: f64, per_unit: f64) -> u32 {
    // The cast saturates at `u32::MAX`.
    ((units * per_unit).ceil() as u32).max(1)
}

/// Packs rectangles into an image that is as small as possible and not higher than wide. `texel` is the side
/// of a texel in units of the scene. Returns `None` if the image would be wider than [`MOST_SIDE`].
fn by_texel(sizes: &[[f64; 2]], texel: f64, gap: u32) -> Option<Packed> {
    let rectangles: Vec<[u32; 2]> = sizes
        .iter()
        .map(|s| s.map(|units| texels(units, 1.0 / texel)))
        .collect();
    let with_gaps = |n: u32| f64::from(n) + f64::from(2 * gap);
    let total: f64 = rectangles
        .iter()
        .map(|r| with_gaps(r[0]) * with_gaps(r[1]))
        .sum();
    let widest = rectangles
        .iter()
        .map(|r| with_gaps(r[0]))
        .fold(1.0, f64::max);
    let mut width = total.sqrt().ceil().max(widest);
    while width <= f64::from(MOST_SIDE) {
        let (at, height) = rows(&rectangles, width as u32, gap);
        if f64::from(height) <= width {
            return Some(Packed {
                at,
                per_unit: 1.0 / texel,
                size: [width as u32, height],
                gap,
            });
        }
        width = (width * 1.02).ceil();
    }
    None
}

/// Packs rectangles into a square image with a side of `side` texels, with as many texels per unit of the
/// scene as possible. Returns `None` if the rectangles do not fit even with one texel each.
fn by_side(sizes: &[[f64; 2]], side: u32, gap: u32) -> Option<Packed> {
    let fits = |per_unit: f64| {
        let rectangles: Vec<[u32; 2]> = sizes
            .iter()
            .map(|s| s.map(|units| texels(units, per_unit)))
            .collect();
        let narrow = rectangles
            .iter()
            .all(|r| r[0].saturating_add(2 * gap) <= side);
        let (at, height) = narrow.then(|| rows(&rectangles, side, gap))?;
        (height <= side).then_some(Packed {
            at,
            per_unit,
            size: [side; 2],
            gap,
        })
    };
    let largest = sizes
        .iter()
        .flatten()
        .copied()
        .fold(f64::MIN_POSITIVE, f64::max);
    let (mut low, mut high) = (0.0, f64::from(side) / largest);
    // At this scale every rectangle is one texel.
    let mut best = fits(low)?;
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        match fits(middle) {
            Some(found) => (best, low) = (found, middle),
            None => high = middle,
        }
    }
    Some(best)
}

/// Places rectangles in rows of `width` texels. Returns the upper left corner of each rectangle and the total
/// height of the rows, in texels.
fn rows(rectangles: &[[u32; 2]], width: u32, gap: u32) -> (Vec<[u32; 2]>, u32) {
    let mut order: Vec<usize> = (0..rectangles.len()).collect();
    order.sort_by_key(|i| {
        (
            std::cmp::Reverse([rectangles[*i][1], rectangles[*i][0]]),
            *i,
        )
    });
    let mut places = vec![[0; 2]; rectangles.len()];
    let (mut at, mut row) = ([0u32; 2], 0u32);
    for i in order {
        let [across, down] = rectangles[i].map(|n| n.saturating_add(2 * gap));
        if at[0].saturating_add(across) > width {
            at = [0, at[1].saturating_add(row)];
            row = 0;
        }
        row = row.max(down);
        places[i] = at.map(|n| n.saturating_add(gap));
        at[0] = at[0].saturating_add(across);
    }
    (places, at[1].saturating_add(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_do_not_overlap() {
        let sizes: Vec<[f64; 2]> = (0..200)
            .map(|i| {
                [
                    f64::from(1 + i * 7 % 23) / 10.0,
                    f64::from(1 + i * 5 % 11) / 10.0,
                ]
            })
            .collect();
        for size in [
            TextureSize::Resolution(200),
            TextureSize::Resolution(100),
            TextureSize::Texel(0.05),
        ] {
            let packed = pack("test", &sizes, size).unwrap();
            let [width, height] = packed.size.map(|n| n as usize);
            let mut owner = vec![false; width * height];
            for (at, size) in packed.at.iter().zip(&sizes) {
                let end = [0, 1].map(|k| at[k] + texels(size[k], packed.per_unit) + packed.gap);
                for y in at[1] - packed.gap..end[1] {
                    for x in at[0] - packed.gap..end[0] {
                        assert!(!std::mem::replace(
                            &mut owner[y as usize * width + x as usize],
                            true
                        ));
                    }
                }
            }
            let used = owner.iter().filter(|u| **u).count();
            assert!(used * 4 > owner.len() * 3, "{used} of {}", owner.len());
        }
        assert!(pack("test", &sizes, TextureSize::Resolution(30)).is_err());
        assert!(pack("test", &sizes, TextureSize::Texel(1e-5)).is_err());
    }
}
