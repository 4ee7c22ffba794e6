//! Tests of tiles whose workers end without a message.

use sightline_records::TileState;
use sightline_records::ids::{JobId, TileIndex, WorkerId};
use sightline_store::{Queries as _, Store as _};

use super::tests::{Bench, empty, two_tiles};
use super::*;

const JOB: JobId = JobId(1);
const FIRST: TileIndex = TileIndex(0);

/// Joins a worker with this name and instance, which requests tiles.
fn start(b: &mut Bench, name: &str, instance: u64, tiles: u32) -> WorkerId {
    let worker = b.try_join(name, instance, Vec::new()).unwrap().worker;
    b.want(worker, tiles);
    worker
}

/// Returns the names of the workers on which the tile failed.
fn failed_on(b: &Bench, tile: TileIndex) -> Vec<String> {
    let tile = b.store.tile(JOB, tile).unwrap();
    tile.failures
        .into_iter()
        .map(|failure| failure.worker)
        .collect()
}

fn is_set_aside(b: &Bench, tile: TileIndex) -> bool {
    matches!(
        b.scheduler.job(JOB).unwrap().tiles[tile.at()].output,
        Output::SetAside(_)
    )
}

#[test]
fn tile_is_set_aside_after_deaths_of_three_workers() {
    let mut b = two_tiles();
    for (at, name) in (1..).zip(["a", "b", "c"]) {
        assert!(!is_set_aside(&b, TileIndex(0)), "before {name}");
        let worker = start(&mut b, name, at, 1);
        assert_eq!(b.holders()[0], Some(worker));
        b.leave(worker);
        b.wait(3);
    }
    assert!(is_set_aside(&b, TileIndex(0)));
    assert_eq!(failed_on(&b, TileIndex(0)), ["a", "b", "c"]);
    assert!(failed_on(&b, TileIndex(1)).is_empty());
}

#[test]
fn tile_is_set_aside_after_five_deaths_under_one_name() {
    let mut b = two_tiles();
    for life in 1..=5 {
        assert!(!is_set_aside(&b, TileIndex(0)), "before life {life}");
        let worker = start(&mut b, "a", life, 1);
        b.leave(worker);
    }
    // The fifth life is missing until another process joins under its name.
    assert!(!is_set_aside(&b, TileIndex(0)));
    start(&mut b, "a", 6, 1);
    assert!(is_set_aside(&b, TileIndex(0)));
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
}

#[test]
fn only_first_lease_of_dead_worker_is_blamed() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 2);
    assert_eq!(b.holders(), [Some(worker), Some(worker)]);
    b.leave(worker);
    start(&mut b, "a", 2, 2);
    assert_eq!(
        (
            failed_on(&b, TileIndex(0)).len(),
            failed_on(&b, TileIndex(1)).len()
        ),
        (1, 0)
    );
}

#[test]
fn drained_worker_is_not_dead() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 1);
    b.step(Event::Drains(worker));
    b.leave(worker);
    b.wait(5);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
    start(&mut b, "a", 2, 1);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
}

#[test]
fn worker_that_returns_in_time_is_not_dead() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 1);
    let lease = b.grants(worker)[0];
    b.leave(worker);
    b.wait(1);
    assert_eq!(b.try_join("a", 1, vec![lease]).unwrap().kept, [lease]);
    b.wait(5);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
    // A worker that has finished the tile in the meantime does not claim it.
    let worker = *b.scheduler.roster.workers.keys().next().unwrap();
    b.leave(worker);
    b.wait(1);
    b.try_join("a", 1, Vec::new()).unwrap();
    b.wait(5);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
}

#[test]
fn late_return_cancels_death() {
    let mut b = two_tiles();
    for (at, name) in (1..).zip(["a", "b", "c", "d", "e", "f"]) {
        let worker = start(&mut b, name, at, 1);
        b.leave(worker);
        b.wait(3);
        assert_eq!(failed_on(&b, TileIndex(0)), [name]);
        // The network was interrupted, but the process lives.
        let worker = b.try_join(name, at, Vec::new()).unwrap().worker;
        assert!(failed_on(&b, TileIndex(0)).is_empty());
        b.step(Event::Drains(worker));
        b.leave(worker);
    }
    assert!(!is_set_aside(&b, TileIndex(0)));
    assert!(b.scheduler.job(JOB).unwrap().tiles[0].deaths.is_empty());
}

#[test]
fn other_failure_of_returning_worker_stays() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 1);
    let lease = b.grants(worker)[0];
    b.fail(worker, lease, false);
    b.want(worker, 1);
    b.leave(worker);
    b.wait(3);
    let worker = b.try_join("a", 1, Vec::new()).unwrap().worker;
    // The return cancels the death, but the earlier failure stays.
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
    b.want(worker, 1);
    let lease = *b.grants(worker).last().unwrap();
    assert_eq!(lease.tile, FIRST);
    b.fail(worker, lease, false);
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
    b.leave(worker);
    start(&mut b, "a", 2, 1);
    b.wait(3);
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
}

#[test]
fn death_of_another_process_with_same_name_stays() {
    for returning in [1, 2] {
        let mut b = two_tiles();
        for instance in [1, 2] {
            let worker = start(&mut b, "a", instance, 1);
            b.leave(worker);
            b.wait(3);
        }
        assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
        let worker = b.try_join("a", returning, Vec::new()).unwrap().worker;
        assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
        // After both processes have returned, no death stays.
        b.step(Event::Drains(worker));
        b.leave(worker);
        b.try_join("a", 3 - returning, Vec::new()).unwrap();
        assert!(failed_on(&b, TileIndex(0)).is_empty());
    }
}

#[test]
fn host_that_falls_silent_and_is_lost_later_counts() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 1);
    // The worker's lease expires while its connection looks intact.
    b.wait(12);
    assert_eq!(b.holders()[0], None);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
    b.leave(worker);
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
    // A worker that was only slow sends a message before it leaves.
    let worker = start(&mut b, "b", 2, 1);
    b.wait(12);
    b.want(worker, 0);
    b.leave(worker);
    assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
}

#[test]
fn late_output_of_lost_worker_counts_as_no_death() {
    let mut b = two_tiles();
    let worker = start(&mut b, "a", 1, 1);
    let lease = b.grants(worker)[0];
    b.leave(worker);
    let stats = Default::default();
    b.step(Event::Committed {
        lease,
        digest: [3; 32],
        stats,
    });
    b.wait(5);
    start(&mut b, "a", 2, 1);
    assert!(failed_on(&b, TileIndex(0)).is_empty());
}

#[test]
fn deaths_stay_on_record_over_restart_of_coordinator() {
    let mut b = empty(1);
    b.add(2, "", 0, false);
    for (at, name) in (1..).zip(["a", "b"]) {
        let worker = start(&mut b, name, at, 1);
        b.leave(worker);
        b.wait(3);
    }
    // Another start on the same store.
    let store = std::mem::take(&mut b.store);
    let mut b = empty(2);
    b.store = store;
    b.reopen(JOB);
    b.wait(4);
    let worker = start(&mut b, "c", 3, 1);
    assert_eq!(b.holders()[0], Some(worker));
    b.leave(worker);
    b.wait(3);
    assert!(is_set_aside(&b, TileIndex(0)));
    assert!(
        matches!(b.store.tile(JOB, FIRST).unwrap().state, TileState::Open),
        "the bench stores no placeholder"
    );
}

#[test]
fn death_that_is_recorded_after_its_cancellation_does_not_stay() {
    for reopens in [false, true] {
        let mut b = two_tiles();
        b.holds_deaths = true;
        let worker = start(&mut b, "a", 1, 1);
        b.leave(worker);
        b.wait(3);
        b.try_join("a", 1, Vec::new()).unwrap();
        let Some(StoreCommand::CountDeath {
            job,
            tile,
            worker,
            reason,
        }) = b.ran.pop()
        else {
            panic!("no death")
        };
        if reopens {
            b.reopen(JOB);
        }
        let on = b.store.count_death(job, tile, &worker, &reason).unwrap();
        assert_eq!(failed_on(&b, TileIndex(0)), ["a"]);
        b.step(Event::FailureRecorded {
            job,
            tile,
            on,
            reason,
            dead: Some(worker),
        });
        assert!(failed_on(&b, TileIndex(0)).is_empty());
        assert!(b.scheduler.deaths.recording.is_empty());
        if !reopens {
            // No pending decision holds the tile back.
            let next = start(&mut b, "b", 2, 1);
            assert_eq!(b.holders()[0], Some(next));
        }
    }
}
