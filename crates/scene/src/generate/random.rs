//! The random numbers of the generators, and sines and cosines that are equal on every machine.

use glam::Vec3;
use sightline_numbers::random::{SplitMix64, mix};

/// A stream of random numbers for one part of a generated scene.
pub(super) struct Random(SplitMix64);

impl Random {
    /// Creates stream `index` of `seed`. Streams are independent, so a change of one part of a scene does not
    /// change other parts.
    pub(super) fn new(seed: u64, index: u64) -> Self {
        Self(SplitMix64::new(mix(
            seed ^ mix(index.wrapping_add(0x5157_4c49_4e45))
        )))
    }

    /// Returns a random integer in 0 … n−1, or 0 if n is 0.
    pub(super) fn below(&mut self, n: u32) -> u32 {
        (((self.0.bits() >> 32) * u64::from(n)) >> 32) as u32
    }

    /// Returns a random number in [lo, hi], in steps of (hi − lo)·2⁻²⁴.
    pub(super) fn range(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.0.unit_f32()
    }

    /// Returns a random direction of length 1, uniform on the sphere.
    pub(super) fn direction(&mut self) -> Vec3 {
        let y = self.range(-1.0, 1.0);
        let (c, s) = turn(self.range(0.0, 1.0));
        let r = (1.0 - y * y).max(0.0).sqrt();
        Vec3::new(r * c, y, r * s)
    }
}

/// Returns the cosine and sine of a fraction of a full turn.
pub(super) fn turn(fraction: f32) -> (f32, f32) {
    let (c, s) = crate::turn::of_quarters(f64::from(fraction) * 4.0);
    (c as f32, s as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_seed_are_equal_in_every_version() {
        let mut r = Random::new(1, 2);
        let expected = [
            0xbff0_3c8f_6f00_374e,
            0xae6a_3a82_2371_dad8,
            0xc544_66ba_2a8d_fc53,
            0x5495_4d27_e350_ed73,
        ];
        assert_eq!([0; 4].map(|_: u64| r.0.bits()), expected);
    }

    #[test]
    fn turns_are_cosine_and_sine() {
        for k in -50i16..150 {
            let f = f32::from(k) / 50.0;
            let angle = f64::from(f) * std::f64::consts::TAU;
            let (c, s) = turn(f);
            assert!(
                (f64::from(c) - angle.cos()).abs() < 1e-7
                    && (f64::from(s) - angle.sin()).abs() < 1e-7
            );
        }
    }

    #[test]
    fn random_numbers_are_in_range() {
        let mut r = Random::new(1, 2);
        for _ in 0..1000 {
            assert!(r.below(7) < 7 && (2.0..=3.0).contains(&r.range(2.0, 3.0)));
            assert!((r.direction().length() - 1.0).abs() < 1e-5);
        }
    }
}
