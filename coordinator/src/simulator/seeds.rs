//! The schedules that run: some in every test run, any number on demand, and each that has ever failed.

use super::run::run;

/// Runs schedules from `first` on; panics with the seed of the first that fails.
fn schedules(first: u64, count: u64) {
    let threads = 2;
    let each = |thread: u64| {
        for seed in (first..first + count).filter(|s| s % threads == thread) {
            if let Err(what) = std::panic::catch_unwind(|| run(seed))
                .unwrap_or_else(|_| Err("a panic, see above".to_owned()))
            {
                panic!("schedule {seed}: {what}");
            }
        }
    };
    std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|t| scope.spawn(move || each(t))).collect();
        running.into_iter().for_each(|r| r.join().unwrap());
    });
}

#[test]
fn ten_thousand_schedules() {
    schedules(0, 10_000);
}

#[test]
#[ignore = "takes as long as it is told to by SIGHTLINE_SCHEDULES"]
fn many_schedules() {
    let number = |name: &str, default| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    schedules(number("SIGHTLINE_FIRST", 1 << 32), number("SIGHTLINE_SCHEDULES", 1_000_000));
}

/// What the machine or the rules got wrong before, each under the number of the schedule that showed it.
#[test]
fn schedules_that_failed() {
    // A job that was paused and resumed was queued, and a worker that came back for a lease made it have
    // leases without running.
    schedules(2048, 1);
    schedules(3861, 1);
    // A waiting tile that its worker had claimed after a restart went to an idle worker within the grace.
    // That is fine, since its holder is known and told.
    schedules(30, 1);
    schedules(65, 1);
}
