//! Tests of outputs that were computed from distrusted tiles, and arrive during the reopening of these tiles
//! or later. None of them may stay. The job has two tiles, and the tests do not depend on the dependency
//! between them.

use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use sightline_records::TileState;
use sightline_records::ids::{JobId, Lease, TileIndex};
use sightline_scheduler::{Event, Grant, Introduction, OpenJob, Output};
use sightline_store::TileFilter;

use crate::clock::ManualClock;
use crate::config::Leases;
use crate::coordinator::Coordinator;
use crate::jobs::invalidate;
use crate::jobs::stored_spec;
use crate::outputs::commit::ResultError;
use crate::records::{JobChanges, OutputCommit, OutputRemoval};
use crate::tests::life::{coordinator, granted, join, output, put, two_tiles};
use crate::tests::trust::alone;
use crate::workers::sessions;

/// A time that is long enough for a thread without waits.
const SOON: Duration = Duration::from_millis(200);

/// Creates a job whose tile 1 is done and whose tile 0 is granted to a worker. Returns the coordinator, the
/// job, and the grant.
fn half_done() -> (Arc<Coordinator>, JobId, Grant) {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (_, mut commands) = join(&c, "ada");
    let [first, second] = [granted(&mut commands), granted(&mut commands)];
    put(&c, &second, &output(&second, &[0])).unwrap();
    (c, id, first)
}

/// Invalidates tile 1 like `sightline invalidate`.
fn invalidate(c: &Arc<Coordinator>, job: JobId) {
    let tiles = [TileIndex(1)].into();
    let filter = TileFilter {
        job: Some(job),
        tiles,
        to_ms: u64::MAX,
        ..TileFilter::default()
    };
    let mut changes = JobChanges::begin(c);
    let opened = invalidate::invalidate(&mut changes, &filter).unwrap();
    assert_eq!(opened.get(&job), Some(&1));
    changes.finish().run(c);
}

/// Returns true if a tile is done. Asserts that the store and the scheduler agree.
fn is_done(c: &Coordinator, job: JobId, tile: TileIndex) -> bool {
    let stored = matches!(
        c.records.tile(job, tile).unwrap().state,
        TileState::Done { .. }
    );
    let scheduled = c
        .dispatcher
        .read(|scheduler| scheduler.job(job).unwrap().tiles[tile.at()].output);
    assert_eq!(
        stored,
        scheduled != Output::Open,
        "the store and the scheduler differ about tile {tile}"
    );
    stored
}

#[test]
fn tiles_are_not_reopened_during_commit() {
    let (c, id, grant) = half_done();
    // The state between the record of an output and the moment at which the scheduler receives it.
    let (committing, _) = OutputCommit::begin(&c, grant.lease).ok().unwrap();
    let (done, is_over) = channel();
    let thread = std::thread::spawn({
        let c = Arc::clone(&c);
        move || {
            invalidate(&c, id);
            done.send(()).unwrap();
        }
    });
    assert!(
        is_over.recv_timeout(SOON).is_err(),
        "the tile was opened in the middle of a commit"
    );
    assert!(is_done(&c, id, TileIndex(1)));
    drop(committing);
    thread.join().unwrap();
    assert!(!is_done(&c, id, TileIndex(1)));
}

#[test]
fn output_admitted_before_reopening_is_rejected() {
    let (c, id, grant) = half_done();
    let mut changes = JobChanges::begin(&c);
    let opening = OutputRemoval::begin(&c);
    let thread = std::thread::spawn({
        let (c, bytes) = (Arc::clone(&c), output(&grant, &[]));
        move || put(&c, &grant, &bytes)
    });
    // The output is being checked and waits.
    std::thread::sleep(SOON);
    assert!(!thread.is_finished());
    changes
        .invalidate_tiles(&opening, id, &[TileIndex(1)])
        .unwrap();
    let record = c.records.job(id).unwrap().unwrap();
    let planned = stored_spec::whole(&*c.blobs, &record.spec).unwrap();
    let job = OpenJob::new(record, Arc::new(planned), c.records.tiles(id).unwrap()).unwrap();
    changes.tell(Event::TakenUp(Box::new(job)));
    drop(opening);
    let follow_ups = changes.finish();
    let answer = thread.join().unwrap();
    assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    follow_ups.run(&c);
    assert_eq!(
        [0, 1].map(|tile| is_done(&c, id, TileIndex(tile))),
        [false, false]
    );
}

#[test]
fn late_output_does_not_conflict_with_recomputed_output() {
    let (c, id, late) = half_done();
    invalidate(&c, id);
    let (_, mut commands) = join(&c, "bob");
    let again = granted(&mut commands);
    assert_eq!(again.lease.tile, late.lease.tile);
    put(&c, &again, &output(&again, &[0])).unwrap();
    let answer = put(&c, &late, &output(&late, &[]));
    assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    assert_eq!(c.records.tile(id, late.lease.tile).unwrap().conflicts, 0);
}

/// Restarts the coordinator on the same store.
fn restarted(c: Arc<Coordinator>) -> Arc<Coordinator> {
    let Coordinator { records, blobs, .. } = alone(c);
    Coordinator::new(
        Leases::default(),
        records.into_store(),
        blobs,
        Box::new(Arc::new(ManualClock::default())),
    )
    .unwrap()
}

/// Returns the leases that a returning worker may continue.
fn kept(c: &Arc<Coordinator>, held: Vec<Lease>) -> Vec<Lease> {
    let (out, _commands) = tokio::sync::mpsc::channel(8);
    let profiles = vec!["cpu/test".to_owned()];
    let intro = Introduction {
        name: "ada".to_owned(),
        signature: "ada".to_owned(),
        version: String::new(),
        instance: 0,
        profiles,
        held,
        helps: false,
    };
    let (joined, follow_ups) = sessions::join(c, intro, Box::new(out)).unwrap();
    follow_ups.run(c);
    joined.kept
}

#[test]
fn lease_survives_restart_unless_tiles_were_reopened() {
    for reopens in [false, true] {
        let (c, id, grant) = half_done();
        if reopens {
            invalidate(&c, id);
        }
        let c = restarted(c);
        let held = vec![grant.lease];
        assert_eq!(
            kept(&c, held.clone()),
            if reopens { Vec::new() } else { held }
        );
        let answer = put(&c, &grant, &output(&grant, &[]));
        if !reopens {
            answer.unwrap();
            continue;
        }
        assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
        assert!(!is_done(&c, id, TileIndex(0)));
        // The next start of the coordinator rejects the lease, too.
        let c = restarted(c);
        let answer = put(&c, &grant, &output(&grant, &[]));
        assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    }
}
