//! The image: texels as means of their receivers, filled texels, and the PNG encoding.

use crate::TexelsError;
use crate::settings::BitDepth;

/// The origin of a texel's value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum TexelState {
    /// A texel that no triangle touches.
    #[default]
    Empty,
    /// A texel whose receivers are all inside closed solids.
    Inside,
    /// A texel with a value from its own receivers.
    Own,
    /// A texel with a value from other texels.
    Filled,
}

/// The values of texels, row by row from the upper left corner.
#[derive(Clone, Debug)]
pub(crate) struct TexelImage {
    /// The width and height in texels.
    pub size: [usize; 2],
    /// The values, or 0 for texels without a value.
    pub values: Vec<f64>,
    /// The state of each texel.
    pub states: Vec<TexelState>,
}

impl TexelImage {
    /// Computes the weighted mean of the samples of each texel. A sample consists of the texel's index, a
    /// weight, a value, and a flag. If the flag is true, the sample is inside a closed solid and its value is
    /// ignored.
    pub(crate) fn from_samples(
        size: [u32; 2],
        values: impl Iterator<Item = (u32, f64, f64, bool)>,
    ) -> Self {
        let size = size.map(|n| n as usize);
        let mut sums = vec![0.0; size[0] * size[1]];
        let mut weights = vec![0.0; sums.len()];
        let mut states = vec![TexelState::Empty; sums.len()];
        for (texel, weight, value, inside) in values {
            let at = texel as usize;
            if inside {
                if states[at] == TexelState::Empty {
                    states[at] = TexelState::Inside;
                }
                continue;
            }
            states[at] = TexelState::Own;
            sums[at] += weight * value;
            weights[at] += weight;
        }
        for (sum, weight) in sums.iter_mut().zip(&weights) {
            if *weight > 0.0 {
                *sum /= weight;
            }
        }
        Self {
            size,
            values: sums,
            states,
        }
    }

    /// Returns the number of texels in a state.
    pub(crate) fn count(&self, state: TexelState) -> usize {
        self.states.iter().filter(|s| **s == state).count()
    }

    /// Returns the indices of the four texels around a position in texels, and their weights in bilinear
    /// filtering.
    pub(crate) fn around(&self, place: [f64; 2]) -> [(u32, f64); 4] {
        let [(x, right), (y, down)] = [0, 1].map(|k| {
            let at = (place[k] - 0.5).clamp(0.0, (self.size[k] - 1) as f64);
            let first = (at.floor() as usize).min(self.size[k].saturating_sub(2));
            (first, at - first as f64)
        });
        let next = |k: usize, at: usize| (at + 1).min(self.size[k] - 1);
        let texel = |x: usize, y: usize| (y * self.size[0] + x) as u32;
        [
            (texel(x, y), (1.0 - right) * (1.0 - down)),
            (texel(next(0, x), y), right * (1.0 - down)),
            (texel(x, next(1, y)), (1.0 - right) * down),
            (texel(next(0, x), next(1, y)), right * down),
        ]
    }

    /// Encodes the values as a greyscale PNG, from black for 0 to white for 1.
    pub(crate) fn png(&self, bits: BitDepth) -> Result<Vec<u8>, TexelsError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size[0] as u32, self.size[1] as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(match bits {
            BitDepth::Eight => png::BitDepth::Eight,
            BitDepth::Sixteen => png::BitDepth::Sixteen,
        });
        let mut writer = encoder.write_header()?;
        let numbers = self
            .values
            .iter()
            .map(|v| (v.clamp(0.0, 1.0) * bits.largest()).round());
        let data: Vec<u8> = match bits {
            BitDepth::Eight => numbers.map(|n| n as u8).collect(),
            BitDepth::Sixteen => numbers.flat_map(|n| (n as u16).to_be_bytes()).collect(),
        };
        writer.write_image_data(&data)?;
        writer.finish()?;
        Ok(bytes)
    }
}
