//! Tests of wrong and lost results, and of retention: a job of two tiles on a store in memory.

use std::sync::Arc;
use std::time::Duration;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobState, TileState};
use sightline_scene::{Object, Scene, Triangle};
use sightline_scheduler::WorkerCommand;
use sightline_store::TileFilter;
use sightline_store::{Blobs as _, FileBlobs, MemoryBlobs, MemoryStore, StoreError};

use crate::blobs::references;
use crate::clock::ManualClock;
use crate::config::Config;
use crate::config::Leases;
use crate::config::Retention;
use crate::coordinator::Coordinator;
use crate::jobs::control;
use crate::jobs::invalidate;
use crate::jobs::retention::tidy_up;
use crate::jobs::submit::{SubmitError, submit};
use crate::jobs::suspend;
use crate::jobs::suspensions::MissingBlob;
use crate::quota::Quotas;
use crate::records::{JobChanges, OutputRemoval};
use crate::startup;
use crate::telemetry::readiness::readiness;
use crate::tests::life::{coordinator, granted, join, nameless, one_cell, output, put, two_tiles};
use crate::uploads::complete::UploadError;
use crate::uploads::scenes;
use crate::workers::quarantine;
use crate::workers::sessions::{self, Message};

type Commands = tokio::sync::mpsc::Receiver<WorkerCommand>;

/// Creates a coordinator that checks every tile with a second worker.
fn checking() -> (Arc<Coordinator>, Arc<ManualClock>, Digest) {
    let clock = Arc::new(ManualClock::default());
    let (store, blobs) = (Box::new(MemoryStore::new()), Box::new(MemoryBlobs::new()));
    let leases = Leases {
        spot_check: 1.0,
        ..Leases::default()
    };
    let c = Coordinator::new(leases, store, blobs, Box::new(Arc::clone(&clock))).unwrap();
    let scene = c.take_scene(&scene()).unwrap();
    (c, clock, scene)
}

fn scene() -> Scene {
    let triangle = Triangle {
        v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y],
    };
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: 1,
    }];
    Scene::new("test", vec![triangle], objects).unwrap()
}

/// Returns the coordinator after all other threads have dropped it.
pub(crate) fn alone(mut c: Arc<Coordinator>) -> Coordinator {
    loop {
        match Arc::try_unwrap(c) {
            Ok(alone) => return alone,
            Err(shared) => c = shared,
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn wait_until(what: &str, mut is: impl FnMut() -> bool) {
    for _ in 0..1000 {
        if is() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{what} did not come");
}

/// Computes all granted tiles of a worker. If `lies` is true, the outputs contain a triangle that does not
/// exist. Returns the number of tiles.
fn work(
    c: &Arc<Coordinator>,
    worker: sightline_records::ids::WorkerId,
    commands: &mut Commands,
    lies: bool,
) -> usize {
    let mut done = 0;
    while let Ok(command) = commands.try_recv() {
        let WorkerCommand::Grant(grant) = command else {
            continue;
        };
        let visible: &[u32] = if lies { &[] } else { &[0] };
        // The coordinator rejects an output that no longer has a lease.
        drop(put(c, &grant, &output(&grant, visible)));
        sessions::heard(c, worker, Message::Want(1)).run(c);
        done += 1;
    }
    done
}

/// Runs a job of two tiles on an honest worker. Returns the bytes of the result.
fn calm() -> Vec<u8> {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut commands) = join(&c, "honest");
    work(&c, worker, &mut commands, false);
    wait_until("the end", || control::result(&c.records, id).is_ok());
    c.blobs
        .read(&control::result(&c.records, id).unwrap())
        .unwrap()
}

#[test]
fn wrong_worker_is_detected_and_its_tiles_are_recomputed() {
    let (c, clock, scene) = checking();
    let id = two_tiles(&c, scene);
    let (liar, mut of_liar) = join(&c, "liar");
    assert_eq!(work(&c, liar, &mut of_liar, true), 2);
    let mut workers = ["ada", "bob"].map(|name| join(&c, name));
    wait_until("the end", || {
        clock.advance(Duration::from_millis(200));
        startup::tick(&c).run(&c);
        for (worker, commands) in &mut workers {
            work(&c, *worker, commands, false);
        }
        work(&c, liar, &mut of_liar, true);
        control::result(&c.records, id).is_ok()
    });
    assert_eq!(
        c.blobs
            .read(&control::result(&c.records, id).unwrap())
            .unwrap(),
        calm()
    );
    let quarantined = c.records.quarantined().unwrap();
    assert_eq!(
        quarantined
            .iter()
            .map(|q| q.worker.as_str())
            .collect::<Vec<_>>(),
        ["liar"]
    );
    for tile in c.records.tiles(id).unwrap() {
        let TileState::Done { stats, .. } = tile.state else {
            panic!("{tile:?}")
        };
        assert_ne!(stats.worker, "liar");
        assert!(tile.check.is_some_and(|check| check.worker != stats.worker));
    }
    assert!(quarantine::release(&c, "liar").unwrap() && !quarantine::release(&c, "liar").unwrap());
}

#[test]
fn invalidated_tiles_are_recomputed() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut commands) = join(&c, "ada");
    work(&c, worker, &mut commands, false);
    wait_until("the end", || control::result(&c.records, id).is_ok());
    let before = c
        .blobs
        .read(&control::result(&c.records, id).unwrap())
        .unwrap();
    let invalidate = |filter: TileFilter| {
        let mut changes = JobChanges::begin(&c);
        let opened = invalidate::invalidate(&mut changes, &filter).unwrap();
        changes.finish().run(&c);
        opened
    };
    let all = TileFilter {
        to_ms: u64::MAX,
        ..TileFilter::default()
    };
    let none = TileFilter {
        worker: Some("bob".to_owned()),
        ..all.clone()
    };
    assert!(invalidate(none).is_empty());
    let far = TileFilter {
        job: Some(id),
        tiles: [TileIndex(2)].into(),
        ..all.clone()
    };
    let mut changes = JobChanges::begin(&c);
    let refused = invalidate::invalidate(&mut changes, &far);
    changes.finish().run(&c);
    assert!(
        matches!(refused, Err(StoreError::UnknownTile { tiles: 2, .. })),
        "{refused:?}"
    );
    // The outputs of a done job are removed, so all tiles are computed again.
    let one = TileFilter {
        job: Some(id),
        tiles: [TileIndex(1)].into(),
        ..all
    };
    assert_eq!(invalidate(one).into_iter().collect::<Vec<_>>(), [(id, 2)]);
    assert!(control::result(&c.records, id).is_err());
    assert_eq!(work(&c, worker, &mut commands, false), 2);
    wait_until("the end", || control::result(&c.records, id).is_ok());
    assert_eq!(
        c.blobs
            .read(&control::result(&c.records, id).unwrap())
            .unwrap(),
        before
    );
}

#[test]
fn output_lost_before_end_is_recomputed() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut commands) = join(&c, "ada");
    let grants = [granted(&mut commands), granted(&mut commands)];
    let first = output(&grants[0], &[0]);
    put(&c, &grants[0], &first).unwrap();
    assert!(c.blobs.remove(blake3::hash(&first).as_bytes()).unwrap());
    put(&c, &grants[1], &output(&grants[1], &[])).unwrap();
    sessions::heard(&c, worker, Message::Want(2)).run(&c);
    wait_until("the tile again", || {
        if let Ok(WorkerCommand::Grant(grant)) = commands.try_recv() {
            assert_eq!(grant.lease.tile, grants[0].lease.tile);
            put(&c, &grant, &first).unwrap();
        }
        control::result(&c.records, id).is_ok()
    });
}

#[test]
fn job_waits_for_scene_lost_before_end() {
    for damaged in [true, false] {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let (store, clock) = (
            Box::new(MemoryStore::new()),
            Box::<Arc<ManualClock>>::default(),
        );
        let c = Coordinator::new(Leases::default(), store, Box::new(blobs.clone()), clock).unwrap();
        let scene = c.take_scene(&self::scene()).unwrap();
        let id = two_tiles(&c, scene);
        let (_, mut commands) = join(&c, "ada");
        let grants = [granted(&mut commands), granted(&mut commands)];
        let mut bytes = c.blobs.read(&scene).unwrap();
        bytes[20] ^= 1;
        match damaged {
            true => std::fs::write(blobs.path(&scene), bytes).unwrap(),
            false => assert!(c.blobs.remove(&scene).unwrap()),
        }
        // As after a restart: the worker has the scene and does not request it.
        *c.uploads.last_scene.lock().unwrap() = None;
        grants
            .iter()
            .for_each(|grant| put(&c, grant, &output(grant, &[0])).unwrap());
        let summary = || control::summary(&c, id).unwrap();
        wait_until("the pause", || summary().record.state == JobState::Paused);
        assert_eq!(summary().missing, Some(MissingBlob::Scene(scene)));
        // After `resume` without the scene, the job waits again.
        control::resume(&c, id).unwrap();
        wait_until("the pause again", || summary().missing.is_some());
        wait_until("the pause again", || {
            summary().record.state == JobState::Paused
        });
        c.take_scene(&self::scene()).unwrap();
        suspend::resume_jobs(&c, MissingBlob::Scene(scene));
        wait_until("the end", || control::result(&c.records, id).is_ok());
        assert_eq!(
            c.blobs
                .read(&control::result(&c.records, id).unwrap())
                .unwrap(),
            calm()
        );
        assert_eq!(summary().missing, None);
    }
}

#[test]
fn sweep_removes_only_unreferenced_blobs() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (_, mut commands) = join(&c, "ada");
    let grant = granted(&mut commands);
    put(&c, &grant, &output(&grant, &[0])).unwrap();
    let chunk = c.blobs.put(b"a chunk of an upload that was left").unwrap();
    let alone = |remove: &mut dyn FnMut()| remove();
    let sweep =
        |is_old| references::sweep(c.records.queries(), &*c.blobs, &|_, _| is_old, &alone).unwrap();
    assert_eq!(sweep(false), (0, 0));
    assert_eq!(sweep(true), (1, 34));
    assert!(!c.blobs.has(&chunk).unwrap());
    let found = references::verify(c.records.queries(), &*c.blobs, &|_| ()).unwrap();
    assert_eq!(
        (
            found.scenes,
            found.jobs,
            found.blobs,
            found.unneeded,
            found.lost.len()
        ),
        (1, 1, 2, 0, 0)
    );
    // The coordinator detects a lost output and reopens its tile.
    c.blobs
        .remove(blake3::hash(&output(&grant, &[0])).as_bytes())
        .unwrap();
    let found = references::verify(c.records.queries(), &*c.blobs, &|_| ()).unwrap();
    assert_eq!(found.lost.len(), 1);
    let mut changes = JobChanges::begin(&c);
    let no_commits = OutputRemoval::begin(&c);
    let mut reopen = |job, tiles: &[TileIndex]| changes.invalidate_tiles(&no_commits, job, tiles);
    let reopened = references::repair(&*c.blobs, &found, &mut reopen).unwrap();
    assert_eq!(reopened, 1);
    drop(no_commits);
    changes.finish().run(&c);
    assert_eq!(
        c.records.tile(id, grant.lease.tile).unwrap().state,
        TileState::Open
    );
}

/// Submits a job of one cell for a user. Each seed gives a different job.
fn of_user(
    c: &Arc<Coordinator>,
    user: &str,
    scene: Digest,
    seed: u64,
) -> Result<JobId, SubmitError> {
    let mut submission = nameless(one_cell(scene, seed));
    submission.owner = user.to_owned();
    submit(c, &submission).map(|submitted| submitted.id)
}

#[test]
fn quota_limits_jobs_of_user() {
    let (c, _, scene) = coordinator();
    let mut c = alone(c);
    c.config.quotas =
        Quotas::parse(&["jobs=2".to_owned(), "bob:jobs=none,scenes=0".to_owned()]).unwrap();
    let c = Arc::new(c);
    let first = of_user(&c, "ada", scene, 1).unwrap();
    of_user(&c, "ada", scene, 2).unwrap();
    let refused = of_user(&c, "ada", scene, 3).unwrap_err().to_string();
    assert!(refused.contains("ada may have at most 2 jobs"), "{refused}");
    // An existing job does not count again, and other users have separate quotas.
    assert_eq!(of_user(&c, "ada", scene, 1).unwrap(), first);
    (1..5).for_each(|seed| assert!(of_user(&c, "bob", scene, seed).is_ok()));
    (1..5).for_each(|seed| assert!(of_user(&c, "", scene, seed).is_ok()));
    // After the deletion of a job, the quota permits another one.
    control::cancel(&c, first).unwrap();
    crate::jobs::delete::delete(&c, first).unwrap();
    of_user(&c, "ada", scene, 3).unwrap();
    let refused = c
        .take_scene_of("bob", &self::scene())
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("bob may have at most 0 scenes"),
        "{refused}"
    );
    assert!(c.take_scene_of("ada", &self::scene()).is_ok());
}

#[test]
fn old_and_surplus_jobs_are_deleted() {
    let (c, clock, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut commands) = join(&c, "ada");
    work(&c, worker, &mut commands, false);
    wait_until("the end", || control::result(&c.records, id).is_ok());
    let mut c = alone(c);
    c.config.retention = Retention {
        keep: Some(Duration::from_secs(60)),
        keep_bytes: None,
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    tidy_up(&c);
    assert!(c.records.job(id).unwrap().is_some());
    let result = control::result(&c.records, id).unwrap();
    let mut c = alone(c);
    c.config.retention = Retention {
        keep: None,
        keep_bytes: Some(10),
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    tidy_up(&c);
    assert!(c.records.job(id).unwrap().is_none() && !c.blobs.has(&result).unwrap());
    // Retention removed the job's scene, too. Another scene without jobs stays, regardless of its size.
    assert!(c.records.scenes().unwrap().is_empty());
    c.take_scene(&self::scene()).unwrap();
    tidy_up(&c);
    assert_eq!(c.records.scenes().unwrap().len(), 1);
    // Retention removes the job by its age, and the scene that no job references.
    let other = of_user(&c, "", scene, 1).unwrap();
    control::cancel(&c, other).unwrap();
    let keep = Some(Duration::from_millis(1));
    let mut c = alone(c);
    c.config.retention = Retention {
        keep,
        keep_bytes: None,
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    // The times of blobs are from the system's clock, which advances during the test.
    clock.advance(Duration::from_secs(3600));
    tidy_up(&c);
    assert!(c.records.jobs().unwrap().is_empty() && c.records.scenes().unwrap().is_empty());
    assert!(!c.blobs.has(&scene).unwrap());
}

#[test]
fn list_with_repeated_chunk_is_rejected_before_writing() {
    let (c, ..) = coordinator();
    let chunk = scenes::put_chunk(&c, "", &[7; 1 << 20]).unwrap();
    let refused = scenes::put_scene(&c, "", [9; 32], &vec![chunk; 65_536]).unwrap_err();
    assert!(
        matches!(refused, UploadError::TooLong { bytes, .. } if bytes == 64 << 30),
        "{refused}"
    );
    // A short upload cannot become a long scene, either.
    let refused = scenes::put_scene(&c, "", [9; 32], &vec![chunk; 1500]).unwrap_err();
    let is_found =
        matches!(refused, UploadError::Repeated { bytes, sent, .. } if bytes / 1500 == sent);
    assert!(is_found, "{refused}");
    // A blob that is longer than a chunk is rejected.
    let long = c.blobs.put(&vec![7; (1 << 20) + 1]).unwrap();
    let refused = scenes::put_scene(&c, "", [9; 32], &[long]).unwrap_err();
    assert!(
        matches!(refused, UploadError::LongChunk { .. }),
        "{refused}"
    );
}

#[test]
fn coordinator_without_writable_disk_is_not_ready() {
    let directory = tempfile::tempdir().unwrap();
    let c = Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
    assert_eq!(readiness(&c), Ok(()));
    std::fs::remove_dir_all(directory.path().join("blobs")).unwrap();
    *c.telemetry.last_test.lock().unwrap() = None;
    let reasons = readiness(&c).unwrap_err();
    assert!(
        reasons.len() == 1 && reasons[0].contains("blobs cannot be written"),
        "{reasons:?}"
    );
}

#[test]
fn worker_is_responsible_for_wrong_tile_before_correct_one() {
    let (c, clock, scene) = checking();
    let id = two_tiles(&c, scene);
    let (liar, mut of_liar) = join(&c, "liar");
    let grants = [granted(&mut of_liar), granted(&mut of_liar)];
    put(&c, &grants[0], &output(&grants[0], &[])).unwrap();
    clock.advance(Duration::from_secs(1));
    // This tile is confirmed first, and is later than the wrong one.
    put(&c, &grants[1], &output(&grants[1], &[0])).unwrap();
    let mut workers = ["ada", "bob"].map(|name| join(&c, name));
    wait_until("the end", || {
        clock.advance(Duration::from_millis(200));
        startup::tick(&c).run(&c);
        for (worker, commands) in &mut workers {
            work(&c, *worker, commands, false);
        }
        work(&c, liar, &mut of_liar, true);
        control::result(&c.records, id).is_ok()
    });
    assert_eq!(
        c.blobs
            .read(&control::result(&c.records, id).unwrap())
            .unwrap(),
        calm()
    );
    assert_eq!(c.records.quarantined().unwrap().len(), 1);
}

#[test]
fn deleted_job_removes_unshared_scene() {
    let (c, _, scene) = coordinator();
    let [first, second] = [1, 2].map(|seed| of_user(&c, "", scene, seed).unwrap());
    for (job, stays) in [(first, true), (second, false)] {
        control::cancel(&c, job).unwrap();
        crate::jobs::delete::delete(&c, job).unwrap();
        assert_eq!(c.records.scene(&scene).unwrap().is_some(), stays);
        assert_eq!(c.blobs.has(&scene).unwrap(), stays);
    }
    // A scene that another user has uploaded stays.
    c.take_scene_of("ada", &self::scene()).unwrap();
    c.take_scene_of("bob", &self::scene()).unwrap();
    let job = of_user(&c, "ada", scene, 1).unwrap();
    control::cancel(&c, job).unwrap();
    crate::jobs::delete::delete(&c, job).unwrap();
    assert!(c.records.scene(&scene).unwrap().is_some());
}

#[test]
fn wrong_records_remove_no_blob() {
    let blobs = MemoryBlobs::new();
    let coordinator_with = |store: MemoryStore| {
        let clock = Box::new(Arc::new(ManualClock::default()));
        let c = Coordinator::new(
            Leases::default(),
            Box::new(store),
            Box::new(blobs.clone()),
            clock,
        )
        .unwrap();
        let mut c = alone(c);
        c.config.retention = Retention {
            keep: None,
            keep_bytes: None,
            grace: Duration::ZERO,
        };
        Arc::new(c)
    };
    let right = coordinator_with(MemoryStore::new());
    let scene = right.take_scene(&scene()).unwrap();
    let chunk = blobs.put(b"a chunk of an upload that was left").unwrap();
    // Records of another store, for example of a wrong data directory, do not reference the blobs.
    tidy_up(&coordinator_with(MemoryStore::new()));
    assert!(blobs.has(&scene).unwrap() && blobs.has(&chunk).unwrap());
    // The store that owns the blobs still removes unreferenced ones.
    tidy_up(&right);
    assert!(blobs.has(&scene).unwrap() && !blobs.has(&chunk).unwrap());
}
