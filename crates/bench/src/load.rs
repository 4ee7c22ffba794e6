//! How busy other processes keep the machine, from Linux's /proc.
//!
//! `/proc/stat` counts the time of all cores in ticks, busy and idle; `/proc/self/stat` counts what this
//! process and the children that it has waited for took of it. What is busy and not ours is taken by others:
//! other processes on the machine (outside a container, too), and other virtual machines ("steal"). Both
//! files count in the same unit, so shares need no length of a tick. Other systems do not tell.

use std::ops::AddAssign;
use std::time::Duration;

use serde::Serialize;

/// Others that take more than this share of all cores lengthen what is timed.
const BUSY: f64 = 0.1;
/// Fewer ticks than this are noise: both files are rounded to ticks.
const LEAST_TICKS: u64 = 10;

/// Ticks since the machine started.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    all: u64,
    busy: u64,
    own: u64,
}

/// Ticks between two moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Load {
    /// Of all cores, busy or idle.
    all: u64,
    /// That others took.
    others: u64,
}

impl Ticks {
    /// Until now; `None` where the system does not tell.
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
        // The time of guests, after these, is part of the user's.
        let [user, nice, system, idle, waiting, interrupts, soft, stolen] = *ticks.first_chunk()?;
        let busy = user + nice + system + interrupts + soft + stolen;
        // The name of the process stands in parentheses and may contain anything.
        let (_, fields) = own.rsplit_once(')')?;
        let fields: Vec<&str> = fields.split_whitespace().collect();
        // utime, stime, cutime and cstime, fields 14 to 17 of proc(5); the state, field 3, comes first here.
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

    /// From `earlier` until this moment.
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
    /// Watches the machine for a time in which this process does nothing.
    pub fn watch(time: Duration) -> Option<Self> {
        let before = Ticks::now()?;
        std::thread::sleep(time);
        Some(Ticks::now()?.since(before))
    }

    /// The share of the time of all cores that others took; `None` when too little time passed to tell.
    pub fn share(self) -> Option<f64> {
        (self.all >= LEAST_TICKS).then(|| self.others as f64 / self.all as f64)
    }

    /// Whether times are not to be trusted.
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
    fn guests_are_not_counted_twice_and_names_may_have_parentheses() {
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
    fn what_is_busy_and_not_ours_is_taken_by_others() {
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
        // Ours alone; rounding may count more of it than of the machine.
        let load = Ticks {
            all: 1200,
            busy: 648,
            own: 250,
        }
        .since(before);
        assert_eq!((load.share(), load.is_busy()), (Some(0.0), false));
    }

    #[test]
    fn a_few_ticks_are_noise() {
        assert!(!Load { all: 20, others: 9 }.is_busy());
        assert_eq!(Load { all: 9, others: 9 }.share(), None);
        let mut sum = Load { all: 20, others: 9 };
        sum += Load { all: 20, others: 9 };
        assert!(sum.is_busy());
    }

    #[test]
    fn what_is_cut_short_tells_nothing() {
        assert_eq!(Ticks::read("cpu  1 2 3\n", OWN), None);
        assert_eq!(Ticks::read("", OWN), None);
        assert_eq!(
            Ticks::read("cpu  1 2 3 4 5 6 7 8 0 0\n", "77 (a) S 1 2"),
            None
        );
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_tells_and_our_own_work_is_not_others() {
        let before = Ticks::now().unwrap();
        let start = std::time::Instant::now();
        // However little of the machine others leave.
        let mut after = before;
        while after.own <= before.own + 5 && start.elapsed() < Duration::from_secs(60) {
            after = Ticks::now().unwrap();
        }
        assert!(after.own > before.own + 5, "{before:?} {after:?}");
        assert!(after.all > before.all);
    }
}
