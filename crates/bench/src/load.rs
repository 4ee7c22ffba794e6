//! The load by other processes on the machine, from Linux's /proc.
//!
//! `/proc/stat` counts the time of all cores in ticks, busy and idle. `/proc/self/stat` counts the part of
//! this process and of the children that it has waited for. The other busy time is due to other processes on
//! the machine (also outside a container) and to other virtual machines ("steal"). Both files count in the
//! same unit, so shares do not depend on the length of a tick. Other systems do not report the load.

use std::ops::AddAssign;
use std::time::Duration;

use serde::Serialize;

/// The share of all cores above which other processes make timed bakes longer.
const BUSY: f64 = 0.1;
/// The number of ticks below which a count is noise: both files are rounded to ticks.
const LEAST_TICKS: u64 = 10;

/// The number of ticks since the machine started.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    all: u64,
    busy: u64,
    own: u64,
}

/// The number of ticks between two moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Load {
    /// The ticks of all cores, busy or idle.
    all: u64,
    /// The ticks that other processes used.
    others: u64,
}

impl Ticks {
    /// Reads the ticks until now, or returns `None` if the system does not report them.
    pub fn now() -> Option<Self> {
        let machine = std::fs::read_to_string("/proc/stat").ok()?;
        let own = std::fs::read_to_string("/proc/self/stat").ok()?;
        Self::read(&machine, &own)
    }

    fn read(machine: &str, own: &str) -> Option<Self> {
        let line = machine.lines().find_map(|l| l.strip_prefix("cpu "))?;
        let ticks: Vec<u64> = line
            .split_whitespace()
            .map_while(|n| n.parse().ok())
            .collect();
        // The time of guests, which follows, is part of the user's time.
        let [user, nice, system, idle, waiting, interrupts, soft, stolen] = *ticks.first_chunk()?;
        let busy = user + nice + system + interrupts + soft + stolen;
        // The name of the process is in parentheses and may contain any characters.
        let (_, fields) = own.rsplit_once(')')?;
        let fields: Vec<&str> = fields.split_whitespace().collect();
        // Sum up utime, stime, cutime and cstime, fields 14 to 17 of proc(5). The state, field 3, is the
        // first field here.
        let own = fields
            .get(11..15)?
            .iter()
            .map(|n| n.parse::<u64>().ok())
            .sum::<Option<u64>>()?;
        Some(Self {
            all: busy + idle + waiting,
            busy,
            own,
        })
    }

    /// Returns the load from `earlier` until this moment.
    pub fn since(self, earlier: Self) -> Load {
        let busy = self.busy.saturating_sub(earlier.busy);
        let own = self.own.saturating_sub(earlier.own);
        Load {
            all: self.all.saturating_sub(earlier.all),
            others: busy.saturating_sub(own),
        }
    }
}

impl Load {
    /// Measures the load during a time in which this process sleeps.
    pub fn watch(time: Duration) -> Option<Self> {
        let before = Ticks::now()?;
        std::thread::sleep(time);
        Some(Ticks::now()?.since(before))
    }

    /// Returns the share of the time of all cores that others used, or `None` if too little time passed.
    pub fn share(self) -> Option<f64> {
        (self.all >= LEAST_TICKS).then(|| self.others as f64 / self.all as f64)
    }

    /// Returns true if other processes use so much time that measured times are not reliable.
    pub fn is_busy(self) -> bool {
        self.others >= LEAST_TICKS && self.share().is_some_and(|s| s > BUSY)
    }
}

impl AddAssign for Load {
    fn add_assign(&mut self, other: Self) {
        self.all += other.all;
        self.others += other.others;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: &str =
        "77 (a) b) S 1 77 77 0 -1 4194304 90 0 0 0 20 5 300 75 20 0 3 0 99 1000 20 184 0 0";

    fn ticks(machine: &str) -> Ticks {
        Ticks::read(machine, OWN).unwrap()
    }

    #[test]
    fn ignores_guests_and_parentheses_in_names() {
        let read = ticks("cpu  1000 10 200 5000 40 3 7 30 500 0\ncpu0 1 1 1 1 1 1 1 1 0 0\n");
        assert_eq!(
            read,
            Ticks {
                all: 6290,
                busy: 1250,
                own: 400
            }
        );
    }

    #[test]
    fn busy_time_of_others_excludes_own_time() {
        let before = Ticks {
            all: 1000,
            busy: 500,
            own: 100,
        };
        let load = Ticks {
            all: 1200,
            busy: 650,
            own: 150,
        }
        .since(before);
        assert_eq!(
            load,
            Load {
                all: 200,
                others: 100
            }
        );
        assert_eq!(load.share(), Some(0.5));
        assert!(load.is_busy());
        // All work is of this process. Due to rounding, its ticks may exceed the busy ticks of the machine.
        let load = Ticks {
            all: 1200,
            busy: 648,
            own: 250,
        }
        .since(before);
        assert_eq!((load.share(), load.is_busy()), (Some(0.0), false));
    }

    #[test]
    fn few_ticks_are_noise() {
        assert!(!Load { all: 20, others: 9 }.is_busy());
        assert_eq!(Load { all: 9, others: 9 }.share(), None);
        let mut sum = Load { all: 20, others: 9 };
        sum += Load { all: 20, others: 9 };
        assert!(sum.is_busy());
    }

    #[test]
    fn read_rejects_truncated_files() {
        assert_eq!(Ticks::read("cpu  1 2 3\n", OWN), None);
        assert_eq!(Ticks::read("", OWN), None);
        assert_eq!(
            Ticks::read("cpu  1 2 3 4 5 6 7 8 0 0\n", "77 (a) S 1 2"),
            None
        );
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn reads_ticks_of_this_machine() {
        let before = Ticks::now().unwrap();
        let start = std::time::Instant::now();
        // Continue until this process has some ticks, even if other processes use most of the machine.
        let mut after = before;
        while after.own <= before.own + 5 && start.elapsed() < Duration::from_secs(60) {
            after = Ticks::now().unwrap();
        }
        assert!(after.own > before.own + 5, "{before:?} {after:?}");
        assert!(after.all > before.all);
    }
}
