//! The seeds of schedules. Some run in every test run, any number on demand, and each seed that has ever
//! failed.

use sightline_store::failing::Counts as DiskCounts;

use super::run::{run, run_on_disk};

/// Runs schedules from `first` on, each with `run`, and returns the outcomes. Panics with the seed of the
/// first failing schedule.
fn all<T: Send>(first: u64, count: u64, run: impl Fn(u64) -> Result<T, String> + Sync) -> Vec<T> {
    let threads = 2;
    let each = |thread: u64| -> Vec<T> {
        let seeds = (first..first + count).filter(|s| s % threads == thread);
        let one = |seed| {
            let ran = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(seed)));
            ran.unwrap_or_else(|_| Err("a panic, see above".to_owned()))
                .unwrap_or_else(|what| panic!("schedule {seed}: {what}"))
        };
        seeds.map(one).collect()
    };
    std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|t| scope.spawn(move || each(t))).collect();
        running
            .into_iter()
            .flat_map(|r| r.join().unwrap())
            .collect()
    })
}

fn schedules(first: u64, count: u64) {
    all(first, count, run);
}

/// Runs schedules on disks that fail, with spot checks.
fn schedules_on_disk(first: u64, count: u64) {
    let mut faults = DiskCounts::default();
    all(first, count, run_on_disk)
        .iter()
        .for_each(|counts| faults.add(counts));
    println!("{faults:?}");
    // Schedules without faults would test too little.
    if count >= 100 {
        assert!(
            faults.power_failures > 0
                && faults.lost > 0
                && faults.full > 0
                && faults.misdirected > 0
        );
        assert!(faults.failed_reads > 0 && faults.failed_writes > 0 && faults.failed_syncs > 0);
    }
}

#[test]
fn thousand_schedules_on_failing_disks() {
    schedules_on_disk(0, 1000);
}

#[test]
#[ignore = "takes as long as it is told to by SIGHTLINE_SCHEDULES; scripts/nightly.sh runs it"]
fn many_schedules_on_failing_disks() {
    let number = |name: &str, default| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    schedules_on_disk(
        number("SIGHTLINE_FIRST", 1 << 32),
        number("SIGHTLINE_SCHEDULES", 100_000),
    );
}

#[test]
fn ten_thousand_schedules() {
    schedules(0, 10_000);
}

#[test]
#[ignore = "takes as long as it is told to by SIGHTLINE_SCHEDULES"]
fn many_schedules() {
    let number = |name: &str, default| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    schedules(
        number("SIGHTLINE_FIRST", 1 << 32),
        number("SIGHTLINE_SCHEDULES", 1_000_000),
    );
}

/// Runs the seeds that showed errors of the scheduler or of the rules.
#[test]
fn schedules_that_failed() {
    // A paused and resumed job was queued, and a worker that returned for a lease gave it leases without
    // running.
    schedules(2048, 1);
    schedules(3861, 1);
    // A waiting tile that its worker had claimed after a restart went to an idle worker within the grace.
    // That is allowed, because the holder is known and notified.
    schedules(30, 1);
    schedules(65, 1);
    // A job that was paused when only checks of its tiles were left did not run again after it was resumed.
    schedules_on_disk(42, 1);
    // A tile that was reopened and needed a tile that was set aside stayed open forever.
    schedules_on_disk(492, 1);
    // The write of a watermark failed after all its bytes were written; then the frame was removed.
    schedules_on_disk(201_179, 1);
    // Every worker was a suspect in a dispute, and an open tile prevented the helper from deciding it.
    schedules_on_disk(201_666, 1);
    // A worker that was considered silent was told to stop a tile that it did not have, and did not request
    // tiles again.
    schedules_on_disk(300_145, 1);
    // After a failed write of a watermark, a power failure left an earlier content of its slot.
    schedules_on_disk(435_855, 1);
    schedules_on_disk(469_700, 1);
    // A job that was paused while all workers were suspects did not run again, and no worker decided.
    schedules_on_disk(409_916, 1);
    // The store rejected the command to set aside a tile that needed a tile that was set aside.
    schedules_on_disk(303_920, 1);
}
