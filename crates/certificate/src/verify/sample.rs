//! A random sample of the pairs of cell and triangle.

use std::collections::{BTreeMap, BTreeSet};

/// Which pairs of cell and triangle to check: drawn uniformly, with repetition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The number of draws. A pair drawn twice is checked once.
    pub pairs: u64,
    /// The seed. Equal seeds draw equal pairs.
    pub seed: u64,
}

/// The drawn triangles by cell.
pub(super) type Drawn = BTreeMap<u32, BTreeSet<u32>>;

impl Sample {
    /// Draws the pairs of a result.
    pub(super) fn draw(self, cells: u32, triangles: u32) -> Drawn {
        // A linear congruential generator (Knuth's MMIX); its upper half is the random number.
        let mut state = self.seed;
        let mut next = |below: u32| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // The upper half of the product of 32 random bits and the bound.
            ((u64::from((state >> 32) as u32) * u64::from(below)) >> 32) as u32
        };
        let mut out = Drawn::new();
        for _ in 0..self.pairs {
            let cell = next(cells);
            out.entry(cell).or_default().insert(next(triangles));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_always_draws_the_same_pairs() {
        let drawn = Sample { pairs: 6, seed: 5 }.draw(3, 100);
        let expected = Drawn::from([
            (0, BTreeSet::from([20, 21])),
            (1, BTreeSet::from([25, 90])),
            (2, BTreeSet::from([14, 30])),
        ]);
        assert_eq!(drawn, expected);
    }
}
