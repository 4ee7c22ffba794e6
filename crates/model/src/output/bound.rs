//! The statistical bound on missed sight lines: Clopper and Pearson's one-sided upper limit (1934).
//!
//! Of n independent sight lines from a cell, m met a triangle that is not in the cell's set. The fraction of
//! such lines is then at most [`upper_bound`] with confidence 1 − α. Look k of a cell spends α·2⁻ᵏ, so that
//! the probability that any of a cell's bounds is wrong stays below α.
//!
//! The project has its own code for this limit, because result files contain the bounds. The crate `statrs`
//! inverts the beta distribution to its own tolerance, so the files' bytes would change with its version.

use crate::statistics::CellStats;

/// One minus the confidence of a cell's bounds over all looks.
pub const ALPHA: f64 = 0.05;
/// Maximum number of misses for which a bound is computed. A bound over more misses is unusable.
const MOST_COUNTED: u64 = 1_000_000;

/// Returns the error probability α that a cell's look number `look` spends. The first look has number 1.
pub fn alpha_of(look: u32) -> f64 {
    ALPHA * 0.5f64.powi(look.min(1000) as i32)
}

/// Computes Clopper and Pearson's one-sided upper limit on the fraction of missed lines; 1 if `lines` is 0.
///
/// The limit is the largest fraction p for which the probability of at most `misses` misses among `lines`
/// lines is at least `alpha`.
pub fn upper_bound(misses: u64, lines: u64, alpha: f64) -> f64 {
    // A damaged or foreign file may contain counts that no look reaches.
    if misses >= lines || misses > MOST_COUNTED || lines > 1 << 53 {
        return 1.0;
    }
    let (n, m) = (lines as f64, misses as f64);
    let (mut low, mut high) = (m / n, 1.0);
    // The probability decreases with p. Sixty halvings determine the last bit.
    for _ in 0..60 {
        let p = 0.5 * (low + high);
        if at_most(misses, n, p) > alpha {
            low = p;
        } else {
            high = p;
        }
    }
    high
}

/// Computes the probability of at most `m` successes in `n` trials of probability `p`.
fn at_most(m: u64, n: f64, p: f64) -> f64 {
    // The sum starts at the largest term. Relative to it, only negligible terms underflow.
    let odds = p / (1.0 - p);
    let mut log_first = n * (-p).ln_1p();
    for k in 0..m {
        log_first += ((n - k as f64) / (k as f64 + 1.0) * odds).ln();
    }
    let (mut term, mut sum) = (1.0f64, 1.0f64);
    for k in (1..=m).rev() {
        term *= k as f64 / ((n - k as f64 + 1.0) * odds);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    (log_first + sum.ln()).exp().min(1.0)
}

impl CellStats {
    /// Returns the bound on the fraction of missed sight lines, with confidence 1 − [`ALPHA`], or `None` if
    /// the cell had no look.
    pub fn bound(&self) -> Option<f64> {
        (self.bound_lines > 0).then(|| {
            upper_bound(
                self.bound_misses,
                self.bound_lines,
                alpha_of(self.bound_look),
            )
        })
    }

    /// Returns the bound on the fraction of sight lines that cross a cell that is not a pair with this cell.
    ///
    /// The confidence is 1 − [`ALPHA`]. Returns `None` if the cell had no look.
    pub fn cell_bound(&self) -> Option<f64> {
        (self.bound_cell_lines > 0).then(|| {
            upper_bound(
                self.bound_cell_misses,
                self.bound_cell_lines,
                alpha_of(self.bound_cell_look),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bound_equals_clopper_pearson_limit() {
        // Without a miss in n, the bound is 1 − α^(1/n).
        for n in [1u64, 10, 300, 100_000] {
            let exact = 1.0 - ALPHA.powf(1.0 / n as f64);
            assert!((upper_bound(0, n, ALPHA) / exact - 1.0).abs() < 1e-9, "{n}");
        }
        // From tables: 1 in 10 at 95 % one-sided is 0.3942, 5 in 100 is 0.1023, 50 in 1000 is 0.06286.
        for (m, n, bound) in [(1, 10, 0.3942), (5, 100, 0.1023), (50, 1000, 0.06286)] {
            assert!((upper_bound(m, n, 0.05) - bound).abs() < 1e-4, "{m} in {n}");
        }
        assert!(upper_bound(0, 0, 0.05) == 1.0 && upper_bound(7, 7, 0.05) == 1.0);
    }

    proptest! {
        #[test]
        fn bound_grows_with_misses_and_confidence_and_falls_with_lines(
            m in 0u64..50,
            extra in 1u64..100_000,
            a in 1e-6f64..0.4,
        ) {
            let n = m + extra;
            let b = upper_bound(m, n, a);
            prop_assert!(b <= 1.0 && b >= m as f64 / n as f64);
            prop_assert!(upper_bound(m + 1, n, a) >= b);
            prop_assert!(upper_bound(m, n + 1, a) <= b + 1e-15);
            prop_assert!(upper_bound(m, n, a * 0.5) >= b);
        }
    }
}
