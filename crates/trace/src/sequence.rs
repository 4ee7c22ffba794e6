//! Low-discrepancy and hashed numbers: functions of a seed and an index with the same values on every
//! machine.

use glam::Vec3;
use sightline_numbers::random::SplitMix64;

/// A stream of hashed numbers.
#[derive(Clone, Copy, Debug)]
pub struct Hashed(SplitMix64);

impl Hashed {
    /// Creates the stream that a list of numbers names.
    pub fn new(names: &[u64]) -> Self {
        Self(SplitMix64::named(names))
    }

    /// Returns the next sixty-four bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns the next number in [0, 1), with 24 bits.
    pub fn unit(&mut self) -> f32 {
        self.0.unit_f32()
    }

    /// Returns the next point in the unit cube.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }
}

/// Returns the `i`-th point of the three-dimensional Kronecker sequence of the generalised golden ratio
/// (Roberts 2018), shifted by `shift`. The point is in [0, 1)³.
pub fn spread3(i: u64, shift: [f32; 3]) -> [f32; 3] {
    /// Fractions of 2³² whose multiples are distributed most evenly in three dimensions.
    const STEP: [u32; 3] = [3_518_319_155, 2_882_110_345, 2_360_945_575];
    [0, 1, 2].map(|a| {
        let t = (i as u32)
            .wrapping_mul(STEP[a])
            .wrapping_add((f64::from(shift[a]) * 4_294_967_296.0) as u32);
        (t >> 8) as f32 / (1u32 << 24) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashed_streams_never_change() {
        let mut none = Hashed::new(&[]);
        assert_eq!(
            [none.bits(), none.bits()],
            [0x6e78_9e6a_a1b9_65f4, 0x06c4_5d18_8009_454f]
        );
        let mut three = Hashed::new(&[1, 2, 3]);
        let expected = [
            0x5bc5_81b0_4a97_c4df,
            0x9c4d_6541_405d_32d6,
            0x4433_34da_c5d2_f022,
        ];
        assert_eq!([three.bits(), three.bits(), three.bits()], expected);
        assert_eq!(
            Hashed::new(&[1, 2, 3]).unit(),
            0x005b_c581 as f32 / 16_777_216.0
        );
    }
}
