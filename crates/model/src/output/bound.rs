//! The statistical bound on missed sight lines: Clopper and Pearson's one-sided upper limit (1934).
//!
//! Of n independent sight lines from a cell, m met a triangle that is not in the cell's set. The fraction of
//! such lines is then at most [`upper_bound`] with confidence 1 − α. Check k of a cell spends α·2⁻ᵏ, so that
//! the chance that any of a cell's bounds is wrong stays below α.
//!
//! The limit stays our own code: the crate `statrs` inverts the beta distribution to its own tolerance,
//! and result files contain these bounds, so their bytes would change with its version.

use crate::statistics::CellStats;

/// One minus the confidence of a bound over all looks.
pub const ALPHA: f64 = 0.05;
/// Misses beyond which no bound is computed: with as many, it is of no use.
const MOST_COUNTED: u64 = 1_000_000;

/// α of look `look`, from 1.
pub fn alpha_of(look: u32) -> f64 {
    ALPHA * 0.5f64.powi(look.min(1000) as i32)
}

/// The largest rate p at which `misses` or fewer in `lines` have a probability of at least `alpha`
/// (Clopper–Pearson's one-sided upper limit); 1 without lines.
pub fn upper_bound(misses: u64, lines: u64, alpha: f64) -> f64 {
    // Counts that no look ever comes to may stand in a damaged or foreign file.
    if misses >= lines || misses > MOST_COUNTED || lines > 1 << 53 {
        return 1.0;
    }
    let (n, m) = (lines as f64, misses as f64);
    let (mut low, mut high) = (m / n, 1.0);
    // The probability falls with p; sixty halvings reach the last bit.
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

/// Probability of at most `m` successes in `n` trials of probability `p`.
fn at_most(m: u64, n: f64, p: f64) -> f64 {
    // From the largest term down: relative to it no term underflows that matters.
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
    /// The bound on the fraction of missed sight lines, with confidence 1 − [`ALPHA`]; `None` when there was
    /// no look.
    pub fn bound(&self) -> Option<f64> {
        (self.bound_lines > 0).then(|| {
            upper_bound(
                self.bound_misses,
                self.bound_lines,
                alpha_of(self.bound_look),
            )
        })
    }

    /// The bound on the fraction of sight lines that cross a cell which is no pair with this one, with the
    /// same confidence; `None` when there was no look.
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
    fn the_bound_is_clopper_and_pearsons() {
        // No miss in n: 1 − α^(1/n).
        for n in [1u64, 10, 300, 100_000] {
            let exact = 1.0 - ALPHA.powf(1.0 / n as f64);
            assert!((upper_bound(0, n, ALPHA) / exact - 1.0).abs() < 1e-9, "{n}");
        }
        // Tables: 1 in 10 at 95 % one-sided 0.3942, 5 in 100 0.1023, 50 in 1000 0.06286.
        for (m, n, bound) in [(1, 10, 0.3942), (5, 100, 0.1023), (50, 1000, 0.06286)] {
            assert!((upper_bound(m, n, 0.05) - bound).abs() < 1e-4, "{m} in {n}");
        }
        assert!(upper_bound(0, 0, 0.05) == 1.0 && upper_bound(7, 7, 0.05) == 1.0);
    }

    proptest! {
        #[test]
        fn more_misses_or_confidence_raise_it_and_more_lines_lower_it(
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
