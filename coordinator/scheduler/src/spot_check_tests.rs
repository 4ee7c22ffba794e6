//! Tests of spot checks: the choice of the checker, and the consequences of its answer.

use sightline_records::ids::{JobId, Lease, TileIndex, WorkerId};
use sightline_records::{JobPhase, JobState, TileStats};

use super::tests::{Bench, empty};
use super::*;

const RIGHT: [u8; 32] = [1; 32];
const WRONG: [u8; 32] = [2; 32];

/// Creates a job with one tile, in a scheduler that checks all tiles.
fn checked() -> (Bench, JobId) {
    let mut bench = empty(1);
    bench.scheduler.settings.spot_check = 1.0;
    let job = bench.add(1, "", 0, false);
    (bench, job)
}

impl Bench {
    /// Delivers the last tile that a worker was granted.
    fn deliver(&mut self, worker: WorkerId, name: &str, digest: [u8; 32]) {
        let lease = *self.grants(worker).last().unwrap();
        let right = self.scheduler.admit(&lease).unwrap().right;
        let checks = matches!(right, Right::Compare { .. });
        if checks {
            self.step(Event::Checked { lease, digest });
        } else {
            let stats = TileStats {
                worker: name.to_owned(),
                ..TileStats::default()
            };
            self.step(Event::Committed {
                lease,
                digest,
                stats,
            });
        }
        self.want(worker, 1);
    }

    fn arrive(&mut self, name: &str) -> WorkerId {
        let worker = self.join(name);
        self.want(worker, 1);
        worker
    }

    fn condemned(&self) -> Vec<String> {
        let names = |c: &StoreCommand| match c {
            StoreCommand::Quarantine { workers, .. } => workers.clone(),
            _ => Vec::new(),
        };
        self.ran.iter().flat_map(names).collect()
    }
}

#[test]
fn another_worker_checks_tile_before_its_job_ends() {
    let (mut b, job) = checked();
    let ada = b.arrive("ada");
    b.deliver(ada, "ada", RIGHT);
    b.wait(1);
    assert_eq!(
        (b.grants(ada).len(), b.assembled.len()),
        (1, 0),
        "the same worker does not check itself"
    );
    let bob = b.arrive("bob");
    b.wait(1);
    assert_eq!(b.grants(bob).len(), 1);
    b.deliver(bob, "bob", RIGHT);
    assert_eq!(b.assembled, [job]);
    assert!(
        matches!(&b.ran[..], [StoreCommand::Confirm { worker, .. }] if worker == "bob"),
        "{:?}",
        b.ran
    );
}

#[test]
fn open_tiles_are_leased_before_checks() {
    let mut b = empty(1);
    b.scheduler.settings.spot_check = 1.0;
    b.add(3, "", 0, false);
    let ada = b.arrive("ada");
    b.deliver(ada, "ada", RIGHT);
    let bob = b.arrive("bob");
    assert_eq!(b.grants(bob)[0].tile, TileIndex(2));
    // Without an open tile, bob checks.
    b.deliver(bob, "bob", RIGHT);
    b.deliver(ada, "ada", RIGHT);
    b.wait(1);
    let lease = *b.grants(bob).last().unwrap();
    assert!(matches!(
        b.scheduler.admit(&lease).unwrap().right,
        Right::Compare { .. }
    ));
}

#[test]
fn job_that_was_paused_with_checks_left_ends_after_it_was_resumed() {
    let (mut b, job) = checked();
    let ada = b.arrive("ada");
    b.deliver(ada, "ada", RIGHT);
    b.set(job, &[JobPhase::Running], JobState::Paused);
    let bob = b.arrive("bob");
    b.wait(1);
    assert!(b.grants(bob).is_empty(), "a paused job is not checked");
    b.set(job, &[JobPhase::Paused], JobState::Queued);
    b.wait(2);
    assert_eq!(b.grants(bob).len(), 1);
    b.deliver(bob, "bob", RIGHT);
    assert_eq!(b.assembled, [job]);
}

#[test]
fn third_worker_decides_and_faulty_worker_is_quarantined() {
    for liar_first in [true, false] {
        let (mut b, _) = checked();
        let (one, two) = if liar_first {
            (WRONG, RIGHT)
        } else {
            (RIGHT, WRONG)
        };
        let ada = b.arrive("ada");
        b.deliver(ada, "ada", one);
        let bob = b.arrive("bob");
        b.wait(1);
        b.deliver(bob, "bob", two);
        // It is unknown which answer is right: neither worker gets a tile, and the job waits for a third
        // worker.
        b.add(1, "", 5, false);
        b.wait(30);
        assert_eq!(
            (b.grants(ada).len(), b.grants(bob).len(), b.assembled.len()),
            (1, 1, 0)
        );
        assert!(
            b.notes
                .iter()
                .any(|note| matches!(note, Note::NeedsThird(..)))
        );
        let cy = b.arrive("cy");
        b.wait(1);
        // A check that waits for a third worker comes before other tiles of any priority.
        let admission = b.scheduler.admit(b.grants(cy).last().unwrap()).unwrap();
        assert!(matches!(admission.right, Right::Compare { .. }));
        b.deliver(cy, "cy", RIGHT);
        let liar = if liar_first { "ada" } else { "bob" };
        assert_eq!(b.condemned(), [liar]);
        // The leases of the faulty worker do not count, and the tile that it computed keeps its job open.
        assert!(b.scheduler.quarantined().contains(liar));
        assert_eq!(b.assembled.is_empty(), liar_first);
        b.wait(1);
        let (honest, other) = if liar_first { (bob, ada) } else { (ada, bob) };
        assert_eq!(b.grants(other).len(), 1, "a liar gets nothing");
        assert_eq!(
            b.grants(honest).len() + b.grants(cy).len(),
            3,
            "those who were right go on"
        );
    }
}

#[test]
fn job_of_only_worker_continues_unchecked_with_note() {
    let (mut b, job) = checked();
    let ada = b.arrive("ada");
    b.deliver(ada, "ada", RIGHT);
    b.wait(9);
    assert!(b.assembled.is_empty());
    b.wait(5);
    assert_eq!(b.assembled, [job]);
    assert!(
        b.notes
            .iter()
            .any(|note| matches!(note, Note::Unchecked(..)))
    );
}

#[test]
fn late_output_of_quarantined_worker_does_not_count() {
    let mut b = empty(1);
    let job = b.add(2, "", 0, false);
    let ada = b.arrive("ada");
    let lease = b.grants(ada)[0];
    assert!(b.scheduler.admit(&lease).unwrap().counts());
    b.step(Event::Quarantined("ada".to_owned()));
    assert!(!b.scheduler.admit(&lease).unwrap().counts());
    b.want(ada, 1);
    assert_eq!(b.grants(ada).len(), 1);
    // The holders of leases of an earlier epoch are unknown.
    let id = sightline_records::ids::LeaseId {
        epoch: sightline_records::ids::Epoch(0),
        number: 1,
    };
    let earlier = Lease {
        job,
        tile: TileIndex(1),
        id,
    };
    assert!(!b.scheduler.admit(&earlier).unwrap().counts());
    b.step(Event::Released("ada".to_owned()));
    assert!(
        b.scheduler.admit(&lease).unwrap().counts()
            && b.scheduler.admit(&earlier).unwrap().counts()
    );
    assert_eq!(b.grants(ada).len(), 2);
}

#[test]
fn failing_check_is_retried_and_dropped() {
    let (mut b, job) = checked();
    let ada = b.arrive("ada");
    b.deliver(ada, "ada", RIGHT);
    let bob = b.arrive("bob");
    for _ in 0..3 {
        // Longer than the wait after a failure, shorter than a lease.
        b.wait(6);
        let lease = *b.grants(bob).last().unwrap();
        b.fail(bob, lease, true);
        b.want(bob, 1);
    }
    assert_eq!((b.grants(bob).len(), b.assembled.clone()), (3, vec![job]));
    assert!(b.condemned().is_empty());
}

#[test]
fn share_of_checked_tiles_matches_setting() {
    let mut b = empty(1);
    b.scheduler.settings.spot_check = 0.25;
    b.add(400, "", 0, false);
    let ada = b.arrive("ada");
    for _ in 0..400 {
        b.deliver(ada, "ada", RIGHT);
    }
    let drawn = b.scheduler.trust.spotted.len();
    assert!((60..140).contains(&drawn), "{drawn}");
}

/// Creates a job with one tile that ada has led and bob has helped with.
fn by_two() -> (Bench, WorkerId, WorkerId) {
    let (mut b, _) = checked();
    let ada = b.arrive("ada");
    let lease = b.grants(ada)[0];
    b.step(Event::CrewOpened(lease));
    let bob = b.arrive("bob");
    assert!(
        b.told[&bob]
            .iter()
            .any(|command| matches!(command, WorkerCommand::Help(_)))
    );
    b.step(Event::CrewClosed(lease));
    b.step(Event::Helped(bob, lease));
    (b, ada, bob)
}

#[test]
fn helper_checks_only_without_other_workers() {
    let (mut b, ada, bob) = by_two();
    b.deliver(ada, "ada", RIGHT);
    b.wait(5);
    assert!(b.grants(bob).is_empty());
    b.wait(8);
    assert_eq!(b.grants(bob).len(), 1);
    b.deliver(bob, "bob", RIGHT);
    assert_eq!(b.assembled.len(), 1);
    // If a third worker exists, it checks the tile.
    let (mut b, ada, bob) = by_two();
    b.deliver(ada, "ada", RIGHT);
    let cy = b.arrive("cy");
    b.wait(1);
    assert_eq!((b.grants(bob).len(), b.grants(cy).len()), (0, 1));
}

#[test]
fn helper_of_right_output_is_guilty_of_own_wrong_output() {
    for (first, second, guilty) in [(RIGHT, WRONG, "bob"), (WRONG, RIGHT, "ada")] {
        let (mut b, ada, bob) = by_two();
        b.deliver(ada, "ada", first);
        b.wait(13);
        b.deliver(bob, "bob", second);
        let cy = b.arrive("cy");
        b.wait(1);
        b.deliver(cy, "cy", RIGHT);
        assert_eq!(b.condemned(), [guilty]);
    }
}

#[test]
fn job_continues_unchecked_without_requesting_worker() {
    let (mut b, job) = checked();
    let ada = b.arrive("ada");
    let lease = *b.grants(ada).last().unwrap();
    let stats = TileStats {
        worker: "ada".to_owned(),
        ..TileStats::default()
    };
    b.step(Event::Committed {
        lease,
        digest: RIGHT,
        stats,
    });
    b.wait(15);
    assert_eq!(b.assembled, [job]);
}
