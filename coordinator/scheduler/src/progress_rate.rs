//! The progress rate of a job. The remaining time is the remaining work, divided by the rate of the last
//! minutes.

use std::collections::VecDeque;

/// Minimum time between two marks, in milliseconds.
const EVERY: u64 = 2000;
/// Maximum number of stored marks, which cover the last two minutes.
const MOST: usize = 60;
/// The age after which a mark is discarded if newer marks exist, in milliseconds.
const OLD: u64 = 120_000;

/// The marks of a job's progress over the last minutes. A mark is a time in milliseconds and the amount that
/// was finished at this time, in cells or tiles.
#[derive(Clone, Debug, Default)]
pub(super) struct ProgressRate(VecDeque<(u64, u64)>);

impl ProgressRate {
    /// Records the finished amount at a time in milliseconds.
    pub(super) fn mark(&mut self, ms: u64, done: u64) {
        if self.0.back().is_some_and(|(last, _)| ms < last + EVERY) {
            return;
        }
        // The finished amount decreases if a tile was revoked.
        if self.0.back().is_some_and(|(_, before)| done < *before) {
            self.0.clear();
        }
        self.0.push_back((ms, done));
        while self.0.len() > MOST || self.0.len() > 2 && self.0[0].0 + OLD < ms {
            self.0.pop_front();
        }
    }

    /// Returns the milliseconds until the amount `left` is finished at this rate, or `None` if unknown.
    pub(super) fn left(&self, ms: u64, done: u64, left: u64) -> Option<u64> {
        let (since, before) = *self.0.front()?;
        let (time, moved) = (ms.saturating_sub(since), done.saturating_sub(before));
        (moved > 0 && time >= EVERY).then(|| (time as f64 / moved as f64 * left as f64) as u64)
    }

    /// Removes all marks, because the job was paused.
    pub(super) fn forget(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_rate_predicts_remaining_time() {
        let mut pace = ProgressRate::default();
        assert_eq!(pace.left(0, 0, 100), None);
        for second in 0..300u64 {
            pace.mark(second * 1000, second * 5);
        }
        assert_eq!(pace.left(299_000, 299 * 5, 500), Some(100_000));
        // The rate was lower some minutes ago.
        for second in 300..600u64 {
            pace.mark(second * 1000, 1500 + (second - 300) * 50);
        }
        let left = pace.left(599_000, 1500 + 299 * 50, 5000).unwrap();
        assert!((99_000..101_000).contains(&left), "{left}");
        pace.mark(700_000, 3);
        assert_eq!(pace.left(700_000, 3, 10), None);
    }
}
