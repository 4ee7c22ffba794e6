//! A random sample of the pairs of cell and triangle.

use std::collections::{BTreeMap, BTreeSet};

/// The parameters of a sample of pairs of cell and triangle, drawn uniformly and with repetition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The number of draws. A pair drawn twice is checked once.
    pub pairs: u64,
    /// The seed of the draws. Equal seeds draw equal pairs.
    pub seed: u64,
}

/// The drawn triangles of each cell.
pub(super) type SampledTriangles = BTreeMap<u32, BTreeSet<u32>>;

impl Sample {
    /// Draws the pairs of a result.
    pub(super) fn draw(self, cells: u32, triangles: u32) -> SampledTriangles {
        // This is a linear congruential generator (Knuth's MMIX), whose upper half is the random number.
        let mut state = self.seed;
        let mut next = |below: u32| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // Return the upper half of the product of 32 random bits and the bound.
            ((u64::from((state >> 32) as u32) * u64::from(below)) >> 32) as u32
        };
        let mut out = SampledTriangles::new();
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
    fn equal_seeds_draw_equal_pairs() {
        let drawn = Sample { pairs: 6, seed: 5 }.draw(3, 100);
        let expected = SampledTriangles::from([
            (0, BTreeSet::from([20, 21])),
            (1, BTreeSet::from([25, 90])),
            (2, BTreeSet::from([14, 30])),
        ]);
        assert_eq!(drawn, expected);
    }
}
