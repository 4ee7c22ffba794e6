//! Outputs that were computed from what is not believed any more, and come while it is opened again or later:
//! none of them may stay. A job of two tiles; which of them needs which does not matter to this.

use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use sightline_records::TileState;
use sightline_records::ids::{JobId, Lease, TileIndex};
use sightline_scheduler::{Event, Grant, Introduction, Job, Output};
use sightline_store::TileFilter;

use crate::clock::ManualClock;
use crate::jobs::invalidate;
use crate::jobs::stored_spec;
use crate::outputs::commit::ResultError;
use crate::records::{JobChanges, OutputCommit, OutputRemoval};
use crate::state::{Coordinator, Leases};
use crate::tests::life::{coordinator, granted, join, output, put, two_tiles};
use crate::tests::trust::alone;
use crate::workers::sessions;

/// Long enough for a thread that waits for nothing.
const SOON: Duration = Duration::from_millis(200);

/// A job whose tile 1 is done, and the grant of its tile 0, which a worker has.
fn half_done() -> (Arc<Coordinator>, JobId, Grant) {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (_, mut orders) = join(&c, "ada");
    let [first, second] = [granted(&mut orders), granted(&mut orders)];
    put(&c, &second, &output(&second, &[0])).unwrap();
    (c, id, first)
}

/// Does what `sightline invalidate` does about tile 1.
fn invalidate(c: &Arc<Coordinator>, job: JobId) {
    let tiles = [TileIndex(1)].into();
    let which = TileFilter {
        job: Some(job),
        tiles,
        to_ms: u64::MAX,
        ..TileFilter::default()
    };
    let mut changes = JobChanges::begin(c);
    let opened = invalidate::invalidate(&mut changes, &which).unwrap();
    assert_eq!(opened.get(&job), Some(&1));
    changes.finish().run(c);
}

/// What the store and the scheduler have of a tile, which is the same.
fn is_done(c: &Coordinator, job: JobId, tile: u32) -> bool {
    let stored = matches!(
        c.store.tile(job, TileIndex(tile)).unwrap().state,
        TileState::Done { .. }
    );
    let scheduled = c.lock().scheduler.job(job).unwrap().tiles[tile as usize].output;
    assert_eq!(
        stored,
        scheduled != Output::Open,
        "the store and the scheduler differ about tile {tile}"
    );
    stored
}

#[test]
fn no_tile_is_opened_again_while_an_output_is_committed() {
    let (c, id, grant) = half_done();
    // As between the record of an output and the moment at which the scheduler hears of it.
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
    assert!(is_done(&c, id, 1));
    drop(committing);
    thread.join().unwrap();
    assert!(!is_done(&c, id, 1));
}

#[test]
fn an_output_that_was_admitted_before_tiles_are_opened_again_is_refused() {
    let (c, id, grant) = half_done();
    let mut changes = JobChanges::begin(&c);
    let opening = OutputRemoval::begin(&c);
    let thread = std::thread::spawn({
        let (c, bytes) = (Arc::clone(&c), output(&grant, &[]));
        move || put(&c, &grant, &bytes)
    });
    // It is checked meanwhile, and waits.
    std::thread::sleep(SOON);
    assert!(!thread.is_finished());
    changes
        .invalidate_tiles(&opening, id, &[TileIndex(1)])
        .unwrap();
    let record = c.store.job(id).unwrap().unwrap();
    let work = stored_spec::whole(&*c.blobs, &record.spec).unwrap();
    let job = Job::new(record, Arc::new(work), c.store.tiles(id).unwrap()).unwrap();
    changes.tell(Event::TakenUp(Box::new(job)));
    drop(opening);
    let follow_ups = changes.finish();
    let answer = thread.join().unwrap();
    assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    follow_ups.run(&c);
    assert_eq!([0, 1].map(|tile| is_done(&c, id, tile)), [false, false]);
}

#[test]
fn a_late_output_is_no_conflict_with_the_one_that_was_computed_again() {
    let (c, id, late) = half_done();
    invalidate(&c, id);
    let (_, mut orders) = join(&c, "bob");
    let again = granted(&mut orders);
    assert_eq!(again.lease.tile, late.lease.tile);
    put(&c, &again, &output(&again, &[0])).unwrap();
    let answer = put(&c, &late, &output(&late, &[]));
    assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    assert_eq!(c.store.tile(id, late.lease.tile).unwrap().conflicts, 0);
}

/// The coordinator after a restart on the same store.
fn restarted(c: Arc<Coordinator>) -> Arc<Coordinator> {
    let Coordinator { store, blobs, .. } = alone(c);
    Coordinator::new(
        Leases::default(),
        store.into_store(),
        blobs,
        Box::new(Arc::new(ManualClock::default())),
    )
    .unwrap()
}

/// Which of these leases a worker that comes back may go on with.
fn kept(c: &Arc<Coordinator>, held: Vec<Lease>) -> Vec<Lease> {
    let (out, _orders) = tokio::sync::mpsc::channel(8);
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
fn after_a_restart_a_lease_counts_unless_tiles_were_opened_again_since() {
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
        assert!(!is_done(&c, id, 0));
        // The next start knows it, too.
        let c = restarted(c);
        let answer = put(&c, &grant, &output(&grant, &[]));
        assert!(matches!(answer, Err(ResultError::NoLease(_))), "{answer:?}");
    }
}
