//! The times of a point with several runs: medians, their spread, and the load by other processes during the
//! runs.

use serde::Serialize;

use crate::load::Load;

/// The cost of one run.
#[derive(Clone, Copy, Debug)]
pub struct RunCost {
    /// The number of seconds from start to exit.
    pub wall: f64,
    /// The CPU seconds of all threads, user and system; `None` if the system does not report them.
    pub cpu: Option<f64>,
    /// The load of the machine during the run; `None` if the system does not report it.
    pub load: Option<Load>,
}

/// The median, minimum and maximum of some numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The median; the mean of the two middle values for an even count.
    pub median: f64,
    /// The minimum.
    pub min: f64,
    /// The maximum.
    pub max: f64,
}

impl Spread {
    /// Computes the spread of `values`, or returns `None` if `values` is empty.
    pub fn from_values(values: &[f64]) -> Option<Self> {
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

/// The times of a point. The medians of wall time and CPU time may belong to different runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Times {
    /// The number of runs.
    pub repeats: usize,
    /// The seconds from start to exit of the median run.
    pub seconds: f64,
    /// The seconds of the fastest run.
    pub seconds_min: f64,
    /// The seconds of the slowest run.
    pub seconds_max: f64,
    /// The CPU seconds of all threads, user and system, of the median run; `None` if the system does not
    /// report them.
    pub cpu_seconds: Option<f64>,
    /// The CPU seconds of the run with the fewest.
    pub cpu_seconds_min: Option<f64>,
    /// The CPU seconds of the run with the most.
    pub cpu_seconds_max: Option<f64>,
    /// The share of all cores' time that other processes used, over all runs.
    pub others_share: Option<f64>,
    /// The ticks from which `others_share` is computed, for sums over points.
    #[serde(skip)]
    pub load: Load,
}

impl Times {
    /// Computes the times of one point from its runs.
    pub fn from_runs(runs: &[RunCost]) -> Self {
        let wall = Spread::from_values(&runs.iter().map(|r| r.wall).collect::<Vec<_>>());
        // Use the CPU times of all runs or of none: a median of some would belong to other runs than the wall
        // time.
        let cpu = runs.iter().map(|r| r.cpu).collect::<Option<Vec<_>>>();
        let cpu = cpu.and_then(|all| Spread::from_values(&all));
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

    /// Returns the difference of the slowest and the fastest run as a fraction of the median, or `None` for
    /// one run.
    pub fn spread(&self) -> Option<f64> {
        let known = self.repeats > 1 && self.seconds > 0.0;
        known.then(|| (self.seconds_max - self.seconds_min) / self.seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_middle_value() {
        assert_eq!(Spread::from_values(&[]), None);
        assert_eq!(
            Spread::from_values(&[4.0]),
            Some(Spread {
                median: 4.0,
                min: 4.0,
                max: 4.0
            })
        );
        assert_eq!(
            Spread::from_values(&[9.0, 1.0, 2.0]),
            Some(Spread {
                median: 2.0,
                min: 1.0,
                max: 9.0
            })
        );
        assert_eq!(
            Spread::from_values(&[9.0, 1.0, 2.0, 4.0]),
            Some(Spread {
                median: 3.0,
                min: 1.0,
                max: 9.0
            })
        );
    }

    #[test]
    fn one_slow_run_does_not_move_the_times() {
        let run = |wall, cpu| RunCost {
            wall,
            cpu,
            load: None,
        };
        let times = Times::from_runs(&[
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
        let known = RunCost {
            wall: 1.0,
            cpu: Some(1.0),
            load: None,
        };
        assert_eq!(Times::from_runs(&[known]).spread(), None);
        assert_eq!(
            Times::from_runs(&[known, RunCost { cpu: None, ..known }]).cpu_seconds,
            None
        );
    }
}
