//! Tests of the validity of leases, of claims after a restart, and of the consequences of failures.

use sightline_records::TileStats;
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_store::Queries as _;

use super::tests::two_tiles;
use super::tests::with_grace;
use super::worker_totals::WorkerTotals;
use super::*;

#[test]
fn only_given_leases_count() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    assert!(b.scheduler.admit(&lease).unwrap().counts());
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
    let why = |l: Lease| b.scheduler.admit(&l).map(|a| a.counts());
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
    // A late output counts.
    b.leave(one);
    b.wait(5);
    assert_eq!(b.holders(), [None, None]);
    assert!(b.scheduler.admit(&lease).unwrap().counts());
}

#[test]
fn restart_delays_leases_until_workers_can_return() {
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
fn bake_in_one_process_has_no_grace() {
    let mut b = with_grace(true);
    b.step(Event::Restricted(JobId(1)));
    let one = b.join("a");
    b.want(one, 1);
    assert_eq!(b.holders(), [Some(one), None]);
}

#[test]
fn faults_delay_tile_longer_and_count_from_twelfth_on() {
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
fn tile_that_fails_on_three_workers_is_set_aside() {
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
fn silent_worker_gets_no_tile_before_it_requests_again() {
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
    // The silent worker is the only worker without a tile, and requests one.
    assert_eq!(b.grants(stands), [lost]);
    assert_eq!(b.scheduler.ineligible(JobId(1))[0].names, ["stands"]);
    b.want(stands, 1);
    assert_eq!(b.grants(stands).last().unwrap().tile, lost.tile);
    assert_eq!(b.scheduler.ineligible(JobId(1)), []);
}

#[test]
fn lease_of_connected_worker_is_not_claimed_by_another() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    assert!(b.try_join("b", 0, vec![lease]).unwrap().kept.is_empty());
    assert!(b.holders().contains(&Some(one)));
}

#[test]
fn tile_in_preparation_has_threefold_limit() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    let prepare = |b: &mut super::tests::Bench, seconds: u64| {
        for _ in 0..seconds / 5 {
            b.step(Event::Progressed(Progress {
                lease,
                cells: 0,
                samples: 0,
            }));
            b.wait(5);
        }
    };
    prepare(&mut b, 1800);
    assert!(b.scheduler.is_leased(&lease));
    prepare(&mut b, 5);
    assert!(!b.scheduler.is_leased(&lease));
}

#[test]
fn earlier_clock_reading_does_not_shorten_lease() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    let mut report = |ms: u64, cells: u64| {
        b.ms = ms;
        b.step(Event::Progressed(Progress {
            lease,
            cells,
            samples: 1,
        }));
    };
    report(9000, 1);
    // Another thread has read its clock earlier, and gets the lock later.
    report(0, 2);
    b.ms = 12_000;
    b.step(Event::Tick);
    assert!(b.scheduler.is_leased(&lease));
}

#[test]
fn roster_has_name_and_totals_of_worker() {
    let mut b = two_tiles();
    let one = b.join("a");
    assert_eq!(b.scheduler.name_of(one), Some("a"));
    for n in 0..2 {
        b.want(one, 1);
        let lease = b.grants(one)[n];
        let stats = TileStats {
            worker: "a".to_owned(),
            cells: 3,
            samples: 5,
            millis: 7,
            ..TileStats::default()
        };
        b.step(Event::Committed {
            lease,
            digest: [1; 32],
            stats,
        });
    }
    let now = Now {
        ms: b.ms,
        unix_ms: b.ms,
    };
    let WorkerTotals {
        tiles,
        cells,
        samples,
        millis,
    } = b.scheduler.roster(now)[0].done;
    assert_eq!([tiles, cells, samples, millis], [2, 6, 10, 14]);
}
