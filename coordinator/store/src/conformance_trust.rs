//! Tests of the commands for untrusted results and for moving a store, on every store.

use sightline_records::ids::{JobId, TileIndex};
use sightline_records::*;

use super::*;

const JOB: JobId = JobId(1);

fn scene(n: u8) -> SceneRecord {
    SceneRecord {
        digest: [n; 32],
        bytes: 1,
        triangles: 1,
        objects: 1,
        owners: Default::default(),
    }
}

fn job(tiles: u32) -> NewJob {
    NewJob {
        key: [9; 32],
        request_id: String::new(),
        name: "a job".to_owned(),
        owner: String::new(),
        user: String::new(),
        priority: 0,
        scene: [1; 32],
        spec: Vec::new(),
        tiles,
        submitted_at_ms: 1,
    }
}

fn result(n: u8) -> TileResult {
    let worker = "w".repeat(MAX_SIGNATURE_BYTES);
    let helpers = vec!["h".repeat(MAX_SIGNATURE_BYTES); MAX_HELPERS];
    let stats = TileStats {
        worker,
        helpers,
        unnamed: u32::MAX,
        at_ms: u64::MAX,
        ..TileStats::default()
    };
    TileResult {
        digest: [n; 32],
        bytes: u64::MAX,
        stats,
    }
}

fn check(at_ms: u64) -> TileCheck {
    TileCheck {
        worker: "c".repeat(MAX_SIGNATURE_BYTES),
        at_ms,
    }
}

/// Runs the commands on an empty store.
pub(super) fn trust(store: &dyn Store) {
    store.record_scene(scene(1)).unwrap();
    store.record_scene(scene(2)).unwrap();
    assert_eq!(store.submit_job(job(2)).unwrap().id, JOB);
    // The longest possible record.
    for n in 0..MAX_FAILURES {
        let worker = format!("{n:0>64}");
        store
            .fail_tile(JOB, TileIndex(0), &worker, &"é".repeat(MAX_REASON_BYTES))
            .unwrap();
    }
    // A second death of the same worker does not count.
    let deaths = ["a", "b", "a"].map(|worker| {
        store
            .count_death(JOB, TileIndex(1), worker, "died")
            .unwrap()
    });
    assert_eq!(deaths, [1, 2, 2]);
    store.commit_tile(JOB, TileIndex(0), result(7)).unwrap();
    store
        .confirm_tile(JOB, TileIndex(0), [8; 32], check(1))
        .unwrap();
    assert_eq!(store.tile(JOB, TileIndex(0)).unwrap().check, None);
    store
        .confirm_tile(JOB, TileIndex(0), [7; 32], check(u64::MAX))
        .unwrap();
    let done = store.tile(JOB, TileIndex(0)).unwrap();
    assert_eq!(done.check, Some(check(u64::MAX)));
    assert!(
        matches!(&done.state, TileState::Done { stats, .. } if stats.helpers.len() == MAX_HELPERS)
    );
    // Only the named tiles of a running job are reopened.
    assert_eq!(store.invalidate_tiles(JOB, &[TileIndex(1)]).unwrap(), 0);
    assert_eq!(store.invalidate_tiles(JOB, &[TileIndex(0)]).unwrap(), 1);
    assert_eq!(
        store.tile(JOB, TileIndex(0)).unwrap(),
        TileRecord::open(TileIndex(0))
    );
    let far = store.invalidate_tiles(JOB, &[TileIndex(2)]);
    assert!(
        matches!(far, Err(StoreError::UnknownTile { .. })),
        "{far:?}"
    );
    // All tiles of a done job are reopened.
    for tile in 0..2 {
        store.commit_tile(JOB, TileIndex(tile), result(7)).unwrap();
    }
    store.finish_job(JOB, [5; 32], 1, 2).unwrap();
    assert_eq!(store.invalidate_tiles(JOB, &[]).unwrap(), 0);
    assert_eq!(store.invalidate_tiles(JOB, &[TileIndex(1)]).unwrap(), 2);
    let again = store.job(JOB).unwrap().unwrap();
    assert_eq!(
        (again.state, again.finished_at_ms),
        (JobState::Queued, None)
    );
    // The job records the epoch, so that earlier leases can be recognised.
    assert_eq!(again.reopened_epoch, Some(store.epoch().unwrap()));
    // The first reason stays, without control characters.
    for reason in ["fir\u{7}st", "second"] {
        let record = QuarantineRecord {
            worker: "w".to_owned(),
            at_ms: 3,
            reason: reason.to_owned(),
        };
        store.quarantine(record).unwrap();
    }
    let quarantined = store.quarantined().unwrap();
    assert_eq!(
        quarantined
            .iter()
            .map(|q| q.reason.as_str())
            .collect::<Vec<_>>(),
        ["fir st"]
    );
    assert!(store.release("w").unwrap() && !store.release("w").unwrap());
    assert!(store.quarantined().unwrap().is_empty());
    // A scene can be deleted once no job references it.
    assert!(matches!(
        store.delete_scene([1; 32]),
        Err(StoreError::SceneInUse { job: JOB, .. })
    ));
    assert_eq!(store.delete_scene([2; 32]).unwrap(), scene(2));
    assert!(matches!(
        store.delete_scene([2; 32]),
        Err(StoreError::UnknownScene { .. })
    ));
    // An export and an import copy all entries.
    let entries = store.entries().unwrap();
    assert!(matches!(
        store.import(entries.clone(), true),
        Err(StoreError::NotEmpty)
    ));
    let other = MemoryStore::new();
    let (first, rest) = entries.split_at(2);
    other.import(first.to_vec(), true).unwrap();
    other.import(rest.to_vec(), false).unwrap();
    assert_eq!(other.entries().unwrap(), entries);
    let mut damaged = entries[0].clone();
    damaged.value[8] ^= 1;
    let refused = other.import(vec![damaged], false);
    assert!(
        matches!(refused, Err(StoreError::View { .. })),
        "{refused:?}"
    );
    assert_eq!(other.entries().unwrap(), entries);
    store.may_change().unwrap();
}

#[test]
fn unconfirmed_tiles_of_worker_are_untrusted() {
    let store = MemoryStore::new();
    store.record_scene(scene(1)).unwrap();
    store.submit_job(job(4)).unwrap();
    // Tile 0 is confirmed. Tile 1 is older, tile 2 is newer, and tile 3 is from another worker.
    for (tile, worker, at_ms) in [(0, "a", 10), (1, "a", 9), (2, "a", 11), (3, "b", 11)] {
        let stats = TileStats {
            worker: worker.to_owned(),
            at_ms,
            ..TileStats::default()
        };
        let done = TileResult {
            digest: [7; 32],
            bytes: 1,
            stats,
        };
        store.commit_tile(JOB, TileIndex(tile), done).unwrap();
    }
    store
        .confirm_tile(JOB, TileIndex(0), [7; 32], check(20))
        .unwrap();
    let untrusted = |condemned| {
        let tiles = untrusted_tiles(&store, &["a".to_owned()], condemned).unwrap();
        tiles[&JOB].iter().map(|tile| tile.0).collect::<Vec<_>>()
    };
    assert_eq!(untrusted(None), [2]);
    assert_eq!(untrusted(Some((JOB, TileIndex(1)))), [1, 2]);
}

#[test]
fn trust_commands_work_in_memory_and_on_disk() {
    trust(&MemoryStore::new());
    let directory = tempfile::tempdir().unwrap();
    let entries = {
        let store = SledStore::open(directory.path()).unwrap();
        trust(&store);
        store.entries().unwrap()
    };
    assert_eq!(
        SledStore::open(directory.path())
            .unwrap()
            .entries()
            .unwrap(),
        entries
    );
}
