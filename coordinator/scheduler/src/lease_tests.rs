//! Which leases count, what a restart leaves to earlier workers, and what failures lead to.

use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_store::Queries as _;

use super::tests::two_tiles;
use super::tests::with_grace;
use super::*;

#[test]
fn only_a_lease_that_was_given_counts() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    assert!(b.scheduler.admit(&lease).unwrap().counts);
    let other = |tile, number| {
        let id = LeaseId {
            epoch: Epoch(1),
            number,
        };
        Lease {
            job: lease.job,
            tile: TileIndex(tile),
            id,
        }
    };
    let why = |l: Lease| b.scheduler.admit(&l).map(|a| a.counts);
    assert_eq!(why(other(1, lease.id.number)), Ok(false), "another tile");
    assert_eq!(
        why(other(0, lease.id.number + 1)),
        Ok(false),
        "another number"
    );
    assert_eq!(why(other(2, lease.id.number)), Err(NoTile::NoTile));
    assert_eq!(
        why(Lease {
            job: JobId(9),
            ..lease
        }),
        Err(NoTile::NoJob(JobId(9)))
    );
    let future = Lease {
        id: LeaseId {
            epoch: Epoch(2),
            ..lease.id
        },
        ..lease
    };
    assert_eq!(why(future), Ok(false));
    assert!(
        b.try_join("b", 0, vec![other(1, 7), future])
            .unwrap()
            .kept
            .is_empty()
    );
    // A late one counts.
    b.leave(one);
    b.wait(5);
    assert_eq!(b.holders(), [None, None]);
    assert!(b.scheduler.admit(&lease).unwrap().counts);
}

#[test]
fn after_a_restart_tiles_are_leased_when_their_workers_had_time_to_come_back() {
    let mut b = with_grace(true);
    let lease = |number| {
        let id = LeaseId {
            epoch: Epoch(1),
            number,
        };
        Lease {
            job: JobId(1),
            tile: TileIndex(1),
            id,
        }
    };
    let new = b.join("new");
    b.want(new, 2);
    assert_eq!(b.holders(), [None, None]);
    let old = b.try_join("old", 5, vec![lease(3)]).unwrap();
    assert_eq!(old.kept, [lease(3)]);
    let wrong = b.try_join("wrong", 6, vec![lease(4)]).unwrap();
    assert!(wrong.kept.is_empty(), "the first claim of a tile counts");
    for _ in 0..11 {
        b.step(Event::Progressed(Progress {
            lease: lease(3),
            cells: 0,
            samples: 0,
        }));
        b.wait(1);
    }
    assert_eq!(b.holders(), [Some(new), Some(old.worker)]);
    assert!(
        b.try_join("late", 7, vec![lease(9)])
            .unwrap()
            .kept
            .is_empty(),
        "the grace is over"
    );
}

#[test]
fn a_bake_in_one_process_waits_for_nobody() {
    let mut b = with_grace(true);
    b.step(Event::Restricted(JobId(1)));
    let one = b.join("a");
    b.want(one, 1);
    assert_eq!(b.holders(), [Some(one), None]);
}

#[test]
fn faults_wait_longer_each_time_and_count_from_the_twelfth_on() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 2);
    let first = TileIndex(0);
    for fault in 1..12 {
        let lease = *b.grants(one).iter().rfind(|l| l.tile == first).unwrap();
        b.fail(one, lease, true);
        b.want(one, 1);
        assert_eq!(b.holders()[0], None);
        let shortest = (1u64 << (fault - 1).min(6)) * 3 / 4;
        b.wait(shortest.saturating_sub(1).min(5));
        if shortest > 2 {
            assert_eq!(b.holders()[0], None, "after fault {fault}");
        }
        for _ in 0..90 {
            let second = b.grants(one)[1];
            b.step(Event::Progressed(Progress {
                lease: second,
                cells: 0,
                samples: 0,
            }));
            b.wait(1);
            if b.holders()[0].is_some() {
                break;
            }
        }
        assert_eq!(b.holders()[0], Some(one), "after fault {fault}");
    }
    let lease = *b.grants(one).iter().rfind(|l| l.tile == first).unwrap();
    b.fail(one, lease, true);
    assert_eq!(b.store.tile(JobId(1), first).unwrap().failures.len(), 1);
}

#[test]
fn a_tile_that_fails_on_three_workers_is_set_aside() {
    let mut b = two_tiles();
    for name in ["a", "b", "c"] {
        let worker = b.join(name);
        b.want(worker, 1);
        let lease = b.grants(worker)[0];
        assert_eq!(lease.tile, TileIndex(0));
        b.fail(worker, lease, false);
        b.step(Event::Drains(worker));
        b.leave(worker);
    }
    let job = b.scheduler.job(JobId(1)).unwrap();
    assert_eq!((job.set_aside, job.open()), (1, 1));
}

#[test]
fn a_worker_that_fell_silent_gets_no_tile_before_it_asks_again() {
    let mut b = two_tiles();
    let (stands, goes) = (b.join("stands"), b.join("goes"));
    b.want(stands, 2);
    b.want(goes, 1);
    let [lost, kept] = [b.grants(stands)[0], b.grants(goes)[0]];
    for samples in 0..11 {
        b.step(Event::Progressed(Progress {
            lease: kept,
            cells: 0,
            samples,
        }));
        b.wait(1);
    }
    // The silent worker is the only one without a tile, and wants one.
    assert_eq!(b.grants(stands), [lost]);
    assert_eq!(b.scheduler.unable(JobId(1))[0].names, ["stands"]);
    b.want(stands, 1);
    assert_eq!(b.grants(stands).last().unwrap().tile, lost.tile);
    assert_eq!(b.scheduler.unable(JobId(1)), []);
}
