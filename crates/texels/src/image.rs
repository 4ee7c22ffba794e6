//! The image: texels as means of their receivers, then without holes, and as PNG.

use crate::TexelsError;
use crate::settings::Bits;

/// What is known of a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum State {
    /// No part of the surface is in it.
    #[default]
    Empty,
    /// All of its receivers are inside of closed solids.
    Inside,
    /// It has a value of its own.
    Own,
    /// It has a value that comes from others.
    Filled,
}

/// The values of texels, row by row from the upper left corner.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    /// Texels across and down.
    pub size: [usize; 2],
    /// The values; 0 where there is none.
    pub values: Vec<f64>,
    /// What is known of each.
    pub states: Vec<State>,
}

impl Image {
    /// The means of weighted values: texel, weight, value, and whether the value counts for nothing.
    pub(crate) fn of(size: [u32; 2], values: impl Iterator<Item = (u32, f64, f64, bool)>) -> Self {
        let size = size.map(|n| n as usize);
        let mut sums = vec![0.0; size[0] * size[1]];
        let mut weights = vec![0.0; sums.len()];
        let mut states = vec![State::Empty; sums.len()];
        for (texel, weight, value, inside) in values {
            let at = texel as usize;
            if inside {
                if states[at] == State::Empty {
                    states[at] = State::Inside;
                }
                continue;
            }
            states[at] = State::Own;
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

    /// How many texels are in a state.
    pub(crate) fn count(&self, state: State) -> usize {
        self.states.iter().filter(|s| **s == state).count()
    }

    /// The four texels around a place, and their weights in bilinear filtering.
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

    /// A PNG of grey values.
    pub(crate) fn png(&self, bits: Bits) -> Result<Vec<u8>, TexelsError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size[0] as u32, self.size[1] as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(match bits {
            Bits::Eight => png::BitDepth::Eight,
            Bits::Sixteen => png::BitDepth::Sixteen,
        });
        let mut writer = encoder.write_header()?;
        let numbers = self
            .values
            .iter()
            .map(|v| (v.clamp(0.0, 1.0) * bits.largest()).round());
        let data: Vec<u8> = match bits {
            Bits::Eight => numbers.map(|n| n as u8).collect(),
            Bits::Sixteen => numbers.flat_map(|n| (n as u16).to_be_bytes()).collect(),
        };
        writer.write_image_data(&data)?;
        writer.finish()?;
        Ok(bytes)
    }
}
