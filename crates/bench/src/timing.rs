//! The times of one point that was run several times: medians, how far they spread, and what others took of
//! the machine meanwhile.

use serde::Serialize;

use crate::load::Load;

/// What one run took.
#[derive(Clone, Copy, Debug)]
pub struct Took {
    /// Seconds from start to exit.
    pub wall: f64,
    /// CPU seconds of all its threads, user and system; `None` where the system does not tell.
    pub cpu: Option<f64>,
    /// The machine meanwhile.
    pub load: Option<Load>,
}

/// The middle of some numbers and their ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The middle one; the mean of the two in the middle of an even number.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Of any numbers but none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        let half = sorted.len() / 2;
        let median = match sorted.len() % 2 {
            0 => f64::midpoint(sorted[half - 1], sorted[half]),
            _ => sorted[half],
        };
        Some(Self { median, min, max })
    }
}

/// The times of a point. The medians of wall and CPU time may be those of different runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Times {
    /// Runs.
    pub repeats: usize,
    /// Seconds from start to exit: the median run.
    pub seconds: f64,
    /// The fastest run.
    pub seconds_min: f64,
    /// The slowest run.
    pub seconds_max: f64,
    /// CPU seconds of all threads, user and system: the median run. `None` where the system does not tell.
    pub cpu_seconds: Option<f64>,
    /// The run with the fewest.
    pub cpu_seconds_min: Option<f64>,
    /// The run with the most.
    pub cpu_seconds_max: Option<f64>,
    /// The share of all cores' time that others took, over all runs.
    pub others_share: Option<f64>,
    /// That share in ticks, to be added up.
    #[serde(skip)]
    pub load: Load,
}

impl Times {
    /// Of the runs of one point.
    pub fn of(runs: &[Took]) -> Self {
        let wall = Spread::of(&runs.iter().map(|r| r.wall).collect::<Vec<_>>());
        // All of them, or none: a median of some would be of other runs than the wall time.
        let cpu = runs.iter().map(|r| r.cpu).collect::<Option<Vec<_>>>();
        let cpu = cpu.and_then(|all| Spread::of(&all));
        let mut load = Load::default();
        for part in runs.iter().filter_map(|r| r.load) {
            load += part;
        }
        let wall = wall.unwrap_or(Spread {
            median: 0.0,
            min: 0.0,
            max: 0.0,
        });
        Self {
            repeats: runs.len(),
            seconds: wall.median,
            seconds_min: wall.min,
            seconds_max: wall.max,
            cpu_seconds: cpu.map(|c| c.median),
            cpu_seconds_min: cpu.map(|c| c.min),
            cpu_seconds_max: cpu.map(|c| c.max),
            others_share: load.share(),
            load,
        }
    }

    /// How far apart the slowest and the fastest run are, as a fraction of the median; `None` of one run.
    pub fn spread(&self) -> Option<f64> {
        let known = self.repeats > 1 && self.seconds > 0.0;
        known.then(|| (self.seconds_max - self.seconds_min) / self.seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(Spread::of(&[]), None);
        assert_eq!(
            Spread::of(&[4.0]),
            Some(Spread {
                median: 4.0,
                min: 4.0,
                max: 4.0
            })
        );
        assert_eq!(
            Spread::of(&[9.0, 1.0, 2.0]),
            Some(Spread {
                median: 2.0,
                min: 1.0,
                max: 9.0
            })
        );
        assert_eq!(
            Spread::of(&[9.0, 1.0, 2.0, 4.0]),
            Some(Spread {
                median: 3.0,
                min: 1.0,
                max: 9.0
            })
        );
    }

    #[test]
    fn one_slow_run_does_not_move_the_times() {
        let run = |wall, cpu| Took {
            wall,
            cpu,
            load: None,
        };
        let times = Times::of(&[
            run(1.0, Some(1.5)),
            run(30.0, Some(1.6)),
            run(1.2, Some(1.7)),
        ]);
        assert_eq!(
            (times.repeats, times.seconds, times.cpu_seconds),
            (3, 1.2, Some(1.6))
        );
        assert_eq!((times.seconds_min, times.seconds_max), (1.0, 30.0));
        assert_eq!(times.spread(), Some(29.0 / 1.2));
        assert_eq!(
            (times.cpu_seconds_min, times.cpu_seconds_max),
            (Some(1.5), Some(1.7))
        );
        assert_eq!(times.others_share, None);
    }

    #[test]
    fn one_run_has_no_spread_and_unknown_cpu_time_stays_unknown() {
        let known = Took {
            wall: 1.0,
            cpu: Some(1.0),
            load: None,
        };
        assert_eq!(Times::of(&[known]).spread(), None);
        assert_eq!(
            Times::of(&[known, Took { cpu: None, ..known }]).cpu_seconds,
            None
        );
    }
}
