//! The number of tries at a candidate in a round: as many as find more per unit of work than uniform rays.
//!
//! A triangle that is found by attempt number a, aimed or by chance, is visible along about 1/a of the lines
//! to it, so finding it adds about 1/a of its part of the sphere to the seen part. The mean of this gain over
//! all tries is the yield of a try. A uniform ray meets an unseen triangle with the probability M that the
//! next round counts, and a triangle that N rays have missed covers some part of 1/N ([`OF_ONE_IN`]): the
//! yield of a uniform ray is that part of M/N. Both yields fall with the square of the number of attempts,
//! which gives the number at which they are equal.
//!
//! Candidates are classed by the decade of their part of the sphere and counted over all cells of the block,
//! because one cell has too few. The sums are integers, so they do not depend on the order of the items.

use sightline_trace::lines::tally::{ATTEMPT_UNIT, Counts, DECADES, GAIN_UNIT, PARTS, Tally};

/// The part of the sphere that a find of the N-th uniform ray covers, in units of 1/N: less than one, because
/// lines of other cells have missed the triangle too. A larger value hardly ever repeats a try; with a
/// smaller one an indoor level loses time at medium errors.
const OF_ONE_IN: f64 = 0.5;
/// Most tries at a candidate in a round.
const MOST: f64 = 8.0;

/// The gains of aiming at candidates of a decade.
#[derive(Default)]
struct Decade {
    /// Since the last plan.
    counts: Counts,
    /// Tries at a candidate in all rounds before.
    so_far: f64,
    /// Tries at a candidate in this round; the fractional part is the probability of one more. 0 before the
    /// first round.
    times: f64,
}

/// The yields of a block's candidates.
pub(super) struct Yields {
    decades: [Decade; DECADES],
    /// Uniform rays a cell had cast, on average, when the round's tries were planned.
    rays: f64,
    /// Work of a try in uniform rays.
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

impl Yields {
    /// Yields before the first round. `work` is the work of a try in units of a uniform ray.
    pub(super) fn new(work: u64) -> Self {
        Self {
            decades: Default::default(),
            rays: 0.0,
            work: work as f64,
        }
    }

    /// Tries at a candidate that would cover `part` of the sphere, in this round.
    pub(super) fn times(&self, part: f32) -> f64 {
        self.decades[decade_of(part)].times
    }

    /// What a device needs to know of the round's tries: at a candidate in this round, and in all before, by
    /// decade.
    pub(super) fn plan_for_device(&self) -> [[f32; DECADES]; 2] {
        [
            std::array::from_fn(|d| self.decades[d].times as f32),
            std::array::from_fn(|d| self.decades[d].so_far as f32),
        ]
    }

    /// Counts in a cell's tally try number `time` of this round, from 0, at a candidate that would cover
    /// `part` of the sphere seen from a cell that has cast `rays` uniform rays.
    pub(super) fn count(
        &self,
        tally: &mut Tally,
        (part, time): (f32, u32),
        rays: u64,
        found: bool,
    ) {
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

    /// Adds the tries at the candidates of a cell.
    pub(super) fn add(&mut self, tally: &Tally) {
        for (decade, new) in self.decades.iter_mut().zip(&tally.0) {
            let counts = &mut decade.counts;
            counts.tries = counts.tries.wrapping_add(new.tries);
            counts.gain = counts.gain.wrapping_add(new.gain);
            counts.before = counts.before.wrapping_add(new.before);
        }
    }

    /// Plans the tries of a round after its uniform rays, from the gains of the last round's tries. Of the
    /// round's `cast` uniform rays, `misses` met an unseen triangle; the cells have cast `rays` uniform rays
    /// on average. In the first round every candidate is tried once.
    pub(super) fn plan(&mut self, misses: u64, cast: u64, rays: f64) {
        // After the last round, before this one's uniform rays.
        let uniform = OF_ONE_IN * misses as f64 / cast.max(1) as f64 / self.rays;
        let grown = rays / self.rays;
        for (decade, part) in self.decades.iter_mut().zip(PARTS) {
            let counts = std::mem::take(&mut decade.counts);
            let tries = counts.tries as f64;
            let gain = counts.gain as f64 * GAIN_UNIT * part;
            let before = counts.before as f64 * ATTEMPT_UNIT;
            let mut times = 1.0;
            if self.rays > 0.0 && tries > 0.0 && misses > 0 {
                // Attempts in the middle of the last round's tries, and after this round's uniform rays.
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

    /// A thousand first tries of decade 3 from cells of `rays` uniform rays.
    fn count(yields: &mut Yields, rays: u64, found: impl Fn(u32) -> bool) {
        let mut tally = Tally::default();
        (0..1000).for_each(|i| yields.count(&mut tally, (3e-4, 0), rays, found(i)));
        yields.add(&Tally::from_numbers(tally.numbers()));
    }

    /// The tries in a second round at candidates of decade 3, after a first one of a thousand tries of which
    /// `finds` found theirs, from cells of 1000 uniform rays, and another 1000 uniform rays of which `misses`
    /// met something unseen.
    fn second(finds: u32, misses: u64) -> f64 {
        let mut yields = Yields::new(6);
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
    fn what_brings_more_than_uniform_rays_is_tried_until_it_does_not() {
        let by_hand = |finds: f64, misses: f64| {
            // 0.3 attempts by uniform rays before the first try, as many since.
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
        // Not worth it: still once, as what is visible changes with what neighbours see.
        assert!(by_hand(100.0, 100.0) < 1.0);
        assert_eq!([second(100, 100), second(0, 2)], [1.0, 1.0]);
        // Worth any number: no more than so many. Nothing is known without a miss.
        assert!(by_hand(1000.0, 1e-3) > MOST);
        let mut yields = Yields::new(6);
        yields.plan(0, 0, 1000.0);
        count(&mut yields, 1000, |_| true);
        yields.plan(1, 1_000_000, 2000.0);
        assert_eq!(yields.times(3e-4), MOST);
        count(&mut yields, 2000, |_| true);
        yields.plan(0, 1_000_000, 4000.0);
        assert_eq!(yields.times(3e-4), 1.0);
    }

    #[test]
    fn decades_are_of_the_part_of_the_sphere() {
        for (decade, part) in PARTS.into_iter().enumerate() {
            assert_eq!(decade_of(part as f32), decade);
        }
        assert_eq!(
            [decade_of(1.0), decade_of(0.0), decade_of(1e-20)],
            [0, DECADES - 1, DECADES - 1]
        );
    }
}
