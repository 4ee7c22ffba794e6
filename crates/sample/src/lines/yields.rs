//! The number of attempts at a candidate in a round, such that attempts find more per work than uniform rays.
//!
//! A triangle that attempt number a finds, aimed or by chance, is visible along about 1/a of the lines to it.
//! Finding it therefore adds about 1/a of its fraction of the sphere to the seen part. The mean of this gain
//! over all attempts is the yield of an attempt.
//!
//! A uniform ray meets an unseen triangle with the probability M that the next round counts. A triangle that
//! N rays have missed covers a fraction of about [`OF_ONE_IN`]/N. The yield of a uniform ray is
//! [`OF_ONE_IN`]·M/N. Both yields fall with the square of the number of attempts, which determines the number
//! at which they are equal.
//!
//! Candidates are classified by the decade of their fraction of the sphere. They are counted over all cells
//! of the block, because one cell has too few. The sums are integers, so they do not depend on the order of
//! the items.

use sightline_trace::lines::tally::{ATTEMPT_UNIT, Counts, DECADES, GAIN_UNIT, PARTS, Tally};

/// The fraction of the sphere that a triangle found by the N-th uniform ray covers, in units of 1/N.
///
/// The value is less than 1, because lines of other cells have also missed the triangle. With a larger value,
/// attempts are almost never repeated. With a smaller value, an indoor level needs more time at medium
/// errors.
const OF_ONE_IN: f64 = 0.5;
/// Maximum number of attempts at a candidate in a round.
const MOST: f64 = 8.0;

/// The gains of aiming at candidates of a decade.
#[derive(Default)]
struct Decade {
    /// The counts since the last plan.
    counts: Counts,
    /// The number of attempts at a candidate in all previous rounds.
    so_far: f64,
    /// The number of attempts at a candidate in this round. The fractional part is the probability of one
    /// more attempt. 0 before the first round.
    times: f64,
}

/// The yields of attempts at a block's candidates, by decade of the candidate's fraction of the sphere.
pub(super) struct YieldTable {
    decades: [Decade; DECADES],
    /// The mean number of uniform rays per cell when the round's attempts were planned.
    rays: f64,
    /// The cost of one attempt at a candidate, in units of the cost of one uniform ray.
    work: f64,
}

fn decade_of(part: f32) -> usize {
    let mut least = 0.1;
    let mut decade = 0;
    while part < least && decade + 1 < DECADES {
        least *= 0.1;
        decade += 1;
    }
    decade
}

impl YieldTable {
    /// Creates the table of a block before its first round. `work` is the cost of one attempt at a candidate,
    /// in units of the cost of one uniform ray.
    pub(super) fn new(work: u64) -> Self {
        Self {
            decades: Default::default(),
            rays: 0.0,
            work: work as f64,
        }
    }

    /// Returns the number of attempts in this round at a candidate that would cover `part` of the sphere.
    pub(super) fn times(&self, part: f32) -> f64 {
        self.decades[decade_of(part)].times
    }

    /// Returns the numbers of attempts for a device: at a candidate in this round, and in all previous
    /// rounds, by decade.
    pub(super) fn plan_for_device(&self) -> [[f32; DECADES]; 2] {
        [
            std::array::from_fn(|d| self.decades[d].times as f32),
            std::array::from_fn(|d| self.decades[d].so_far as f32),
        ]
    }

    /// Counts an attempt in a cell's tally.
    ///
    /// The attempt is number `time` of this round, starting at 0, at a candidate that would cover `part` of
    /// the sphere. The cell has cast `rays` uniform rays.
    pub(super) fn count(&self, tally: &mut Tally, part: f32, time: u32, rays: u64, found: bool) {
        let number = decade_of(part);
        let (decade, counts) = (&self.decades[number], &mut tally.0[number]);
        let before = decade.so_far + f64::from(time) + rays as f64 * f64::from(part);
        counts.tries += 1;
        counts.before = counts.before.wrapping_add((before / ATTEMPT_UNIT) as u64);
        if found {
            let gain = f64::from(part) / PARTS[number] / (before + 1.0);
            counts.gain = counts.gain.wrapping_add((gain / GAIN_UNIT) as u64);
        }
    }

    /// Adds the attempts at the candidates of a cell.
    pub(super) fn add(&mut self, tally: &Tally) {
        for (decade, new) in self.decades.iter_mut().zip(&tally.0) {
            let counts = &mut decade.counts;
            counts.tries = counts.tries.wrapping_add(new.tries);
            counts.gain = counts.gain.wrapping_add(new.gain);
            counts.before = counts.before.wrapping_add(new.before);
        }
    }

    /// Plans the attempts of a round after its uniform rays, from the gains of the last round's attempts.
    ///
    /// Of the round's `cast` uniform rays, `misses` met an unseen triangle. The cells have cast `rays`
    /// uniform rays on average. In the first round every candidate has one attempt.
    pub(super) fn plan(&mut self, misses: u64, cast: u64, rays: f64) {
        // The yield after the last round, before the uniform rays of this round.
        let uniform = OF_ONE_IN * misses as f64 / cast.max(1) as f64 / self.rays;
        let grown = rays / self.rays;
        for (decade, part) in self.decades.iter_mut().zip(PARTS) {
            let counts = std::mem::take(&mut decade.counts);
            let tries = counts.tries as f64;
            let gain = counts.gain as f64 * GAIN_UNIT * part;
            let before = counts.before as f64 * ATTEMPT_UNIT;
            let mut times = 1.0;
            if self.rays > 0.0 && tries > 0.0 && misses > 0 {
                // The number of attempts in the middle of the last round's attempts, and after this round's
                // uniform rays.
                let then = before / tries + 1.0;
                let now = before / tries + 0.5 * (decade.times + 1.0) + (rays - self.rays) * part;
                let ratio = gain / tries / (self.work * uniform);
                times = (then * ratio.sqrt() * grown - now).clamp(1.0, MOST);
            }
            decade.so_far += decade.times;
            decade.times = times;
        }
        self.rays = rays;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts a thousand first attempts of decade 3 from cells of `rays` uniform rays.
    fn count(yields: &mut YieldTable, rays: u64, found: impl Fn(u32) -> bool) {
        let mut tally = Tally::default();
        (0..1000).for_each(|i| yields.count(&mut tally, 3e-4, 0, rays, found(i)));
        yields.add(&Tally::from_numbers(tally.numbers()));
    }

    /// Returns the number of attempts in a second round at candidates of decade 3.
    ///
    /// In the first round, `finds` of a thousand attempts found their candidate, from cells of 1000 uniform
    /// rays. In the second round, `misses` of another 1000 uniform rays met an unseen triangle.
    fn second(finds: u32, misses: u64) -> f64 {
        let mut yields = YieldTable::new(6);
        yields.plan(0, 0, 1000.0);
        assert_eq!(yields.times(3e-4), 1.0);
        count(&mut yields, 1000, |i| i < finds);
        yields.plan(misses, 1000, 2000.0);
        assert!(
            [0.3, 3e-2, 3e-3, 3e-5, 1e-9]
                .iter()
                .all(|other| yields.times(*other) == 1.0)
        );
        yields.times(3e-4)
    }

    #[test]
    fn attempts_repeat_while_they_yield_more_than_uniform_rays() {
        let by_hand = |finds: f64, misses: f64| {
            // Uniform rays count as 0.3 attempts before the first attempt, and as many since.
            let a_try = finds / 1000.0 * 3e-4 / 1.3;
            let a_ray = OF_ONE_IN * misses / 1000.0 / 1000.0;
            1.3 * (a_try / (6.0 * a_ray)).sqrt() * 2.0 - 1.3 - 0.3
        };
        for (finds, misses) in [(300, 20), (500, 10), (500, 5)] {
            let (times, expected) = (
                second(finds, misses),
                by_hand(f64::from(finds), misses as f64),
            );
            assert!(
                (1.0..MOST).contains(&expected) && (times - expected).abs() < 0.02,
                "{times} for {expected}"
            );
        }
        // A second attempt does not pay. One attempt remains, because visibility changes with the neighbours'
        // sets.
        assert!(by_hand(100.0, 100.0) < 1.0);
        assert_eq!([second(100, 100), second(0, 2)], [1.0, 1.0]);
        // Any number of attempts pays, so the limit applies. Without a miss, the yields are unknown.
        assert!(by_hand(1000.0, 1e-3) > MOST);
        let mut yields = YieldTable::new(6);
        yields.plan(0, 0, 1000.0);
        count(&mut yields, 1000, |_| true);
        yields.plan(1, 1_000_000, 2000.0);
        assert_eq!(yields.times(3e-4), MOST);
        count(&mut yields, 2000, |_| true);
        yields.plan(0, 1_000_000, 4000.0);
        assert_eq!(yields.times(3e-4), 1.0);
    }

    #[test]
    fn decades_follow_part_of_sphere() {
        for (decade, part) in PARTS.into_iter().enumerate() {
            assert_eq!(decade_of(part as f32), decade);
        }
        assert_eq!(
            [decade_of(1.0), decade_of(0.0), decade_of(1e-20)],
            [0, DECADES - 1, DECADES - 1]
        );
    }
}
