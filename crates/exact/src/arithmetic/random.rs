//! Random numbers from a seed and a stream number, identical on every machine.

use sightline_numbers::random::{GAMMA, SplitMix64};

/// A stream of random numbers.
pub struct Random(SplitMix64);

impl Random {
    /// Creates the generator of one stream.
    ///
    /// Different pairs of a seed and a stream give unrelated numbers.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(SplitMix64::new(
            SplitMix64::new(seed).bits() ^ stream.wrapping_mul(GAMMA),
        ))
    }

    /// Returns the next number in [0, 1), a multiple of 2⁻⁵³.
    pub fn unit(&mut self) -> f64 {
        self.0.unit_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_have_known_answers() {
        let mut random = Random::new(5, 7);
        let expected = [
            4_418_864_944_222_949u64,
            1_842_781_580_995_719,
            2_757_006_518_642_704,
        ];
        for bits in expected {
            assert_eq!(random.unit(), bits as f64 / (1u64 << 53) as f64);
        }
    }
}
