//! The generator's numbers: SplitMix64 and the unit circle, both the same on every machine.

use glam::Vec3;

use crate::mix;

/// SplitMix64 (Steele, Lea & Flood 2014, "Fast Splittable Pseudorandom Number Generators").
pub(super) struct Random {
    state: u64,
}

impl Random {
    /// The stream `index` of `seed`; streams do not depend on one another, so parts can change on their own.
    pub(super) fn new(seed: u64, index: u64) -> Self {
        Self { state: mix(seed ^ mix(index.wrapping_add(0x5157_4c49_4e45))) }
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// A number in 0 … n−1 (0 when n is 0).
    pub(super) fn below(&mut self, n: u32) -> u32 {
        (((self.next() >> 32) * u64::from(n)) >> 32) as u32
    }

    /// A number in [lo, hi], by steps of 2⁻²⁴ of their distance.
    pub(super) fn range(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * ((self.next() >> 40) as f32 / 16_777_216.0)
    }

    /// A direction of length 1, uniform on the sphere.
    pub(super) fn direction(&mut self) -> Vec3 {
        let y = self.range(-1.0, 1.0);
        let (c, s) = turn(self.range(0.0, 1.0));
        let r = (1.0 - y * y).max(0.0).sqrt();
        Vec3::new(r * c, y, r * s)
    }
}

/// Cosine and sine of a fraction of a full turn, by Taylor's series: platforms' own differ in the last bit.
pub(super) fn turn(fraction: f32) -> (f32, f32) {
    let quarters = f64::from(fraction) * 4.0;
    let nearest = (quarters + 0.5).floor();
    let x = (quarters - nearest) * std::f64::consts::FRAC_PI_2;
    let xx = x * x;
    // |x| ≤ π/4: the first term left out is below 1e-11, far less than an f32 shows.
    let sin = x * (1.0 - xx / 6.0 * (1.0 - xx / 20.0 * (1.0 - xx / 42.0 * (1.0 - xx / 72.0))));
    let cos = 1.0 - xx / 2.0 * (1.0 - xx / 12.0 * (1.0 - xx / 30.0 * (1.0 - xx / 56.0 * (1.0 - xx / 90.0))));
    let (c, s) = match (nearest as i64).rem_euclid(4) {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    };
    (c as f32, s as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stream_is_splitmix64() {
        // First outputs for state 0, as published with the reference code.
        let mut r = Random { state: 0 };
        assert_eq!([r.next(), r.next()], [0xe220_a839_7b1d_cdaf, 0x6e78_9e6a_a1b9_65f4]);
    }

    #[test]
    fn streams_of_a_seed_are_as_in_every_version() {
        let mut r = Random::new(1, 2);
        let expected =
            [0xbff0_3c8f_6f00_374e, 0xae6a_3a82_2371_dad8, 0xc544_66ba_2a8d_fc53, 0x5495_4d27_e350_ed73];
        assert_eq!([r.next(), r.next(), r.next(), r.next()], expected);
    }

    #[test]
    fn turns_are_cosine_and_sine() {
        for k in -50i16..150 {
            let f = f32::from(k) / 50.0;
            let angle = f64::from(f) * std::f64::consts::TAU;
            let (c, s) = turn(f);
            assert!((f64::from(c) - angle.cos()).abs() < 1e-7 && (f64::from(s) - angle.sin()).abs() < 1e-7);
        }
    }

    #[test]
    fn ranges_are_kept() {
        let mut r = Random::new(1, 2);
        for _ in 0..1000 {
            assert!(r.below(7) < 7 && (2.0..=3.0).contains(&r.range(2.0, 3.0)));
            assert!((r.direction().length() - 1.0).abs() < 1e-5);
        }
    }
}
