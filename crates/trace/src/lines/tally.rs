//! The attempts at the candidates of a cell in a round, by the decade of their fraction of the sphere.
//!
//! The sums are integers, so they do not depend on the order of the items.

/// The number of decades. Smaller candidates are in the last decade.
pub const DECADES: usize = 8;
/// A fraction of the sphere in the middle of each decade.
pub const PARTS: [f64; DECADES] = [0.3, 0.03, 3e-3, 3e-4, 3e-5, 3e-6, 3e-7, 3e-8];
/// The unit of counted gains, as a fraction of [`PARTS`].
pub const GAIN_UNIT: f64 = 1.0 / (1u64 << 30) as f64;
/// The unit of counted attempts.
pub const ATTEMPT_UNIT: f64 = 1.0 / 256.0;
/// The attempts at candidates of a decade.
#[derive(Clone, Copy, Default)]
pub struct Counts {
    /// The number of attempts.
    pub tries: u64,
    /// The expected gain of the attempts in seen fractions of the sphere, in [`GAIN_UNIT`].
    pub gain: u64,
    /// The sum over the attempts of the number of attempts before each, in [`ATTEMPT_UNIT`].
    pub before: u64,
}

/// The attempts at the candidates of a cell in a round.
#[derive(Clone, Default)]
pub struct Tally(pub [Counts; DECADES]);

impl Tally {
    /// The number of values of [`Self::numbers`].
    pub const NUMBERS: usize = 3 * DECADES;

    /// Creates the tally from counts of a device. Each decade has the attempts, the gains as fractions of the
    /// decade's middle in units of `gain_unit`, and the earlier attempts in 256ths.
    pub fn of_device(decades: [[u64; 3]; DECADES], gain_unit: f64) -> Self {
        // Both units are powers of two, so the number is exact while it fits.
        let gain = |g: u64| g.wrapping_mul((gain_unit / GAIN_UNIT) as u64);
        Self(decades.map(|[tries, g, before]| Counts {
            tries,
            gain: gain(g),
            before,
        }))
    }

    /// Returns the sum of both tallies.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let (mut all, more) = (self.numbers(), other.numbers());
        all.iter_mut()
            .zip(more)
            .for_each(|(n, m)| *n = n.wrapping_add(m));
        Self::from_numbers(all)
    }

    /// Returns all counts, in a fixed order.
    pub fn numbers(&self) -> [u64; Self::NUMBERS] {
        let mut all = [0; Self::NUMBERS];
        for (n, c) in self.0.iter().enumerate() {
            all[3 * n..3 * n + 3].copy_from_slice(&[c.tries, c.gain, c.before]);
        }
        all
    }

    /// Creates the tally from the result of [`Self::numbers`].
    pub fn from_numbers(numbers: [u64; Self::NUMBERS]) -> Self {
        Self(std::array::from_fn(|n| {
            let [tries, gain, before] = [0, 1, 2].map(|k| numbers[3 * n + k]);
            Counts {
                tries,
                gain,
                before,
            }
        }))
    }
}
