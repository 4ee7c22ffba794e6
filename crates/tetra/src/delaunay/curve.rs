//! Orders along a Hilbert curve: of the insertion of points, and of the finished tetrahedra.

use sightline_numbers::random::mix;

/// Number of bits of a coordinate on the curve.
const BITS: u32 = 21;

/// A Hilbert curve through a cube.
pub(super) struct Curve {
    lower: [f64; 3],
    scale: f64,
}

impl Curve {
    /// Creates the curve through the smallest cube that starts at `lower` and contains `upper`.
    ///
    /// At least one coordinate of `upper` must exceed the same coordinate of `lower`.
    pub(super) fn new(lower: [f32; 3], upper: [f32; 3]) -> Self {
        let extent = (0..3)
            .map(|k| f64::from(upper[k]) - f64::from(lower[k]))
            .fold(0.0, f64::max);
        Self {
            lower: lower.map(f64::from),
            scale: f64::from(1 << BITS) / extent,
        }
    }

    /// Returns the position along the curve, from 0 to 2⁶³ − 1, of a point of the cube.
    ///
    /// The algorithm is from Skilling, "Programming the Hilbert curve", 2004. The algorithm converts the
    /// coordinates bit by bit into the transposed index, whose bits are then interleaved.
    pub(super) fn place(&self, x: [f64; 3]) -> u64 {
        let most = (1u32 << BITS) - 1;
        // The conversion saturates, so rounding cannot produce a cell outside of the cube.
        let mut c: [u32; 3] =
            std::array::from_fn(|k| (((x[k] - self.lower[k]) * self.scale) as u32).min(most));
        let mut bit = 1 << (BITS - 1);
        while bit > 1 {
            let below = bit - 1;
            for k in 0..3 {
                if c[k] & bit != 0 {
                    c[0] ^= below;
                } else {
                    let swap = (c[0] ^ c[k]) & below;
                    c[0] ^= swap;
                    c[k] ^= swap;
                }
            }
            bit >>= 1;
        }
        c[1] ^= c[0];
        c[2] ^= c[1];
        let mut flip = 0;
        let mut bit = 1 << (BITS - 1);
        while bit > 1 {
            if c[2] & bit != 0 {
                flip ^= bit - 1;
            }
            bit >>= 1;
        }
        let c = c.map(|c| spread(c ^ flip));
        c[0] << 2 | c[1] << 1 | c[2]
    }
}

/// Spreads the bits of a 21-bit number to every third bit.
fn spread(c: u32) -> u64 {
    let mut x = u64::from(c);
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Returns the point numbers in insertion order: rounds of about doubling size, each along the curve.
///
/// The method is from Amenta, Choi and Rote, "Incremental Constructions con BRIO", 2003. A point is in the
/// last round with probability 1/2, in the previous round with probability 1/4, and so on. So the expected
/// work equals the expected work of a random order, and the curve makes walks from point to point short.
/// `seed` determines the rounds.
pub(super) fn insertion_order(points: &[[f32; 3]], curve: &Curve, seed: u64) -> Vec<u32> {
    let mut keyed: Vec<(u8, u64, u32)> = (0..)
        .zip(points)
        .map(|(index, p)| {
            let round = mix(seed ^ mix(u64::from(index))).trailing_zeros() as u8;
            (u8::MAX - round, curve.place(p.map(f64::from)), index)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, _, index)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_visits_adjacent_cells_in_turn() {
        let curve = Curve::new([0.0; 3], [8.0; 3]);
        let mut cells: Vec<(u64, [i32; 3])> = (0..512)
            .map(|i| [i & 7, i >> 3 & 7, i >> 6])
            .map(|c| (curve.place(c.map(|c| f64::from(c) + 0.5)), c))
            .collect();
        cells.sort_unstable();
        for pair in cells.windows(2) {
            let steps: i32 = (0..3).map(|k| (pair[0].1[k] - pair[1].1[k]).abs()).sum();
            assert_eq!(steps, 1, "{pair:?}");
        }
    }

    #[test]
    fn insertion_rounds_double() {
        let points: Vec<[f32; 3]> = (0..4096).map(|i| [i as f32, 0.0, 0.0]).collect();
        let curve = Curve::new([-1.0; 3], [4096.0; 3]);
        let order = insertion_order(&points, &curve, 0);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..4096));
        // Within a round positions ascend, so the last descent is the start of the last round.
        let place = |k: u32| curve.place(points[k as usize].map(f64::from));
        let last = order
            .windows(2)
            .rposition(|w| place(w[0]) > place(w[1]))
            .unwrap();
        assert!(
            (1900..2200).contains(&last),
            "the last round starts at {last}"
        );
    }
}
