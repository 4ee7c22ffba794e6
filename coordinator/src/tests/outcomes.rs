//! Tests of the removal of stored outcomes: no outcome stays after its tile is done.

use std::path::Path;
use std::sync::Arc;

use sightline_numbers::ids::PhaseIndex;
use sightline_records::ids::{JobId, TileIndex};

use crate::config::Config;
use crate::coordinator::Coordinator;
use crate::jobs::control;
use crate::tests::life::{granted, join, output, put, triangle, two_tiles};
use crate::workers::late_outcomes;

/// Opens a coordinator on a directory.
fn open(directory: &Path) -> Arc<Coordinator> {
    Coordinator::open(Config::new(directory.to_owned())).unwrap()
}

/// Stores an outcome of the first phase of a tile.
fn store(c: &Coordinator, job: JobId, tile: TileIndex) {
    let outcomes = &c.workers.crews.outcomes;
    assert!(outcomes.push((job, tile), PhaseIndex(0), b"an outcome"));
}

/// Returns the number of stored outcomes of each of two tiles.
fn stored(c: &Coordinator, job: JobId) -> [u32; 2] {
    [0, 1].map(|tile| c.workers.crews.outcomes.count((job, TileIndex(tile))))
}

#[test]
fn late_outcome_is_removed_and_early_one_stays() {
    let directory = tempfile::tempdir().unwrap();
    let c = open(directory.path());
    let scene = c.take_scene(&triangle()).unwrap();
    let job = two_tiles(&c, scene);
    let (_, mut commands) = join(&c, "ada");
    let grant = granted(&mut commands);
    let (done, other) = (grant.lease.tile, TileIndex(1 - grant.lease.tile.0));
    store(&c, job, done);
    store(&c, job, other);
    assert!(!late_outcomes::remove_if_closed(&c, job, done).unwrap());
    put(&c, &grant, &output(&grant, &[])).unwrap();
    assert_eq!(stored(&c, job)[done.at()], 0);
    // The commit has removed the outcomes, and another one arrives.
    store(&c, job, done);
    assert!(late_outcomes::remove_if_closed(&c, job, done).unwrap());
    assert!(!late_outcomes::remove_if_closed(&c, job, other).unwrap());
    assert_eq!(stored(&c, job)[done.at()], 0);
    assert_eq!(stored(&c, job)[other.at()], 1);

    control::cancel(&c, job).unwrap();
    store(&c, job, other);
    assert!(late_outcomes::remove_if_closed(&c, job, other).unwrap());
    store(&c, JobId(99), TileIndex(0));
    assert!(late_outcomes::remove_if_closed(&c, JobId(99), TileIndex(0)).unwrap());
}

#[test]
fn start_removes_outcomes_of_done_tiles() {
    let directory = tempfile::tempdir().unwrap();
    let c = open(directory.path());
    let scene = c.take_scene(&triangle()).unwrap();
    let job = two_tiles(&c, scene);
    let (_, mut commands) = join(&c, "ada");
    let grant = granted(&mut commands);
    put(&c, &grant, &output(&grant, &[])).unwrap();
    // A coordinator that ends after the record of the commit leaves the outcomes.
    store(&c, job, grant.lease.tile);
    store(&c, job, TileIndex(1 - grant.lease.tile.0));
    drop(c);
    let c = open(directory.path());
    let expected = if grant.lease.tile == TileIndex(0) {
        [0, 1]
    } else {
        [1, 0]
    };
    assert_eq!(stored(&c, job), expected);
}
