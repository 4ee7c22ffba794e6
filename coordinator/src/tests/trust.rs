//! Results that are wrong or lost, and what a coordinator keeps: a job of two tiles on a memory store.

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
use crate::jobs::control;
use crate::jobs::invalidate;
use crate::jobs::resume;
use crate::jobs::retention::tidy_up;
use crate::jobs::submit::{SubmitError, submit};
use crate::kept::Retention;
use crate::lifecycle::{self, Config};
use crate::quota::Quotas;
use crate::records::{JobChanges, OutputRemoval};
use crate::state::{Coordinator, Leases, MissingBlob};
use crate::telemetry::readiness::readiness;
use crate::tests::life::{coordinator, granted, join, nameless, one_cell, output, put, two_tiles};
use crate::uploads::complete::UploadError;
use crate::uploads::scenes;
use crate::workers::quarantine;
use crate::workers::sessions::{self, Message};

type Orders = tokio::sync::mpsc::Receiver<WorkerCommand>;

/// A coordinator that has every tile computed again.
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

/// The coordinator once no thread of its own has it any more.
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

/// A worker does everything that it is given; a liar sees a triangle that is not there.
fn work(
    c: &Arc<Coordinator>,
    worker: sightline_records::ids::WorkerId,
    orders: &mut Orders,
    lies: bool,
) -> usize {
    let mut done = 0;
    while let Ok(order) = orders.try_recv() {
        let WorkerCommand::Grant(grant) = order else {
            continue;
        };
        let visible: &[u32] = if lies { &[] } else { &[0] };
        // A result that nobody wants any more is refused.
        drop(put(c, &grant, &output(&grant, visible)));
        sessions::heard(c, worker, Message::Want(1)).run(c);
        done += 1;
    }
    done
}

/// Runs a job of two tiles on an honest worker; its result.
fn calm() -> Vec<u8> {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut orders) = join(&c, "honest");
    work(&c, worker, &mut orders, false);
    wait_until("the end", || control::result(&c, id).is_ok());
    c.blobs.read(&control::result(&c, id).unwrap()).unwrap()
}

#[test]
fn a_liar_is_found_and_what_it_did_is_computed_again() {
    let (c, clock, scene) = checking();
    let id = two_tiles(&c, scene);
    let (liar, mut of_liar) = join(&c, "liar");
    assert_eq!(work(&c, liar, &mut of_liar, true), 2);
    let mut workers = ["ada", "bob"].map(|name| join(&c, name));
    wait_until("the end", || {
        clock.advance(Duration::from_millis(200));
        lifecycle::tick(&c).run(&c);
        for (worker, orders) in &mut workers {
            work(&c, *worker, orders, false);
        }
        work(&c, liar, &mut of_liar, true);
        control::result(&c, id).is_ok()
    });
    assert_eq!(
        c.blobs.read(&control::result(&c, id).unwrap()).unwrap(),
        calm()
    );
    let quarantined = c.store.quarantined().unwrap();
    assert_eq!(
        quarantined
            .iter()
            .map(|q| q.worker.as_str())
            .collect::<Vec<_>>(),
        ["liar"]
    );
    for tile in c.store.tiles(id).unwrap() {
        let TileState::Done { stats, .. } = tile.state else {
            panic!("{tile:?}")
        };
        assert_ne!(stats.worker, "liar");
        assert!(tile.check.is_some_and(|check| check.worker != stats.worker));
    }
    assert!(quarantine::release(&c, "liar").unwrap() && !quarantine::release(&c, "liar").unwrap());
}

#[test]
fn what_a_person_does_not_believe_is_computed_again() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut orders) = join(&c, "ada");
    work(&c, worker, &mut orders, false);
    wait_until("the end", || control::result(&c, id).is_ok());
    let before = c.blobs.read(&control::result(&c, id).unwrap()).unwrap();
    let invalidate = |which: TileFilter| {
        let mut changes = JobChanges::begin(&c);
        let opened = invalidate::invalidate(&mut changes, &which).unwrap();
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
    // Of a done job the other tiles are gone, so all are computed again.
    let one = TileFilter {
        job: Some(id),
        tiles: [TileIndex(1)].into(),
        ..all
    };
    assert_eq!(invalidate(one).into_iter().collect::<Vec<_>>(), [(id, 2)]);
    assert!(control::result(&c, id).is_err());
    assert_eq!(work(&c, worker, &mut orders, false), 2);
    wait_until("the end", || control::result(&c, id).is_ok());
    assert_eq!(
        c.blobs.read(&control::result(&c, id).unwrap()).unwrap(),
        before
    );
}

#[test]
fn an_output_that_is_lost_before_the_end_is_computed_again() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut orders) = join(&c, "ada");
    let grants = [granted(&mut orders), granted(&mut orders)];
    let first = output(&grants[0], &[0]);
    put(&c, &grants[0], &first).unwrap();
    assert!(c.blobs.remove(blake3::hash(&first).as_bytes()).unwrap());
    put(&c, &grants[1], &output(&grants[1], &[])).unwrap();
    sessions::heard(&c, worker, Message::Want(2)).run(&c);
    wait_until("the tile again", || {
        if let Ok(WorkerCommand::Grant(grant)) = orders.try_recv() {
            assert_eq!(grant.lease.tile, grants[0].lease.tile);
            put(&c, &grant, &first).unwrap();
        }
        control::result(&c, id).is_ok()
    });
}

#[test]
fn a_scene_that_is_lost_before_the_end_is_waited_for() {
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
        let (_, mut orders) = join(&c, "ada");
        let grants = [granted(&mut orders), granted(&mut orders)];
        let mut bytes = c.blobs.read(&scene).unwrap();
        bytes[20] ^= 1;
        match damaged {
            true => std::fs::write(blobs.path(&scene), bytes).unwrap(),
            false => assert!(c.blobs.remove(&scene).unwrap()),
        }
        // As after a restart: the worker has the scene and does not ask for it.
        *c.last_scene.lock().unwrap() = None;
        grants
            .iter()
            .for_each(|grant| put(&c, grant, &output(grant, &[0])).unwrap());
        let summary = || control::summary(&c, id).unwrap();
        wait_until("the pause", || summary().record.state == JobState::Paused);
        assert_eq!(summary().lacks, Some(MissingBlob::Scene(scene)));
        // Resumed without it, the job waits again.
        control::resume(&c, id).unwrap();
        wait_until("the pause again", || summary().lacks.is_some());
        wait_until("the pause again", || {
            summary().record.state == JobState::Paused
        });
        c.take_scene(&self::scene()).unwrap();
        resume::back(&c, MissingBlob::Scene(scene));
        wait_until("the end", || control::result(&c, id).is_ok());
        assert_eq!(
            c.blobs.read(&control::result(&c, id).unwrap()).unwrap(),
            calm()
        );
        assert_eq!(summary().lacks, None);
    }
}

#[test]
fn blobs_that_nobody_needs_go_and_all_others_stay() {
    let (c, _, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (_, mut orders) = join(&c, "ada");
    let grant = granted(&mut orders);
    put(&c, &grant, &output(&grant, &[0])).unwrap();
    let chunk = c.blobs.put(b"a chunk of an upload that was left").unwrap();
    let alone = |remove: &mut dyn FnMut()| remove();
    let sweep =
        |is_old| references::sweep(c.store.queries(), &*c.blobs, &|_, _| is_old, &alone).unwrap();
    assert_eq!(sweep(false), (0, 0));
    assert_eq!(sweep(true), (1, 34));
    assert!(!c.blobs.has(&chunk).unwrap());
    let found = references::verify(c.store.queries(), &*c.blobs, &|_| ()).unwrap();
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
    // A lost output is found, and its tile opened again.
    c.blobs
        .remove(blake3::hash(&output(&grant, &[0])).as_bytes())
        .unwrap();
    let found = references::verify(c.store.queries(), &*c.blobs, &|_| ()).unwrap();
    assert_eq!(found.lost.len(), 1);
    let mut changes = JobChanges::begin(&c);
    let no_commits = OutputRemoval::begin(&c);
    let mut reopen = |job, tiles: &[TileIndex]| changes.invalidate_tiles(&no_commits, job, tiles);
    let reopened = references::repair(&*c.blobs, &found, &mut reopen).unwrap();
    assert_eq!(reopened, 1);
    drop(no_commits);
    changes.finish().run(&c);
    assert_eq!(
        c.store.tile(id, grant.lease.tile).unwrap().state,
        TileState::Open
    );
}

/// The same job for a user, with another seed each time.
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
fn a_user_may_have_as_much_as_the_quota_says() {
    let (c, _, scene) = coordinator();
    let mut c = alone(c);
    c.quotas = Quotas::parse(&["jobs=2".to_owned(), "bob:jobs=none,scenes=0".to_owned()]).unwrap();
    let c = Arc::new(c);
    let first = of_user(&c, "ada", scene, 1).unwrap();
    of_user(&c, "ada", scene, 2).unwrap();
    let refused = of_user(&c, "ada", scene, 3).unwrap_err().to_string();
    assert!(refused.contains("ada may have 2 jobs"), "{refused}");
    // What is there already is no more, and others have their own.
    assert_eq!(of_user(&c, "ada", scene, 1).unwrap(), first);
    (1..5).for_each(|seed| assert!(of_user(&c, "bob", scene, seed).is_ok()));
    (1..5).for_each(|seed| assert!(of_user(&c, "", scene, seed).is_ok()));
    // Once one is deleted there is room.
    control::cancel(&c, first).unwrap();
    crate::jobs::delete::delete(&c, first).unwrap();
    of_user(&c, "ada", scene, 3).unwrap();
    let refused = c
        .take_scene_of("bob", &self::scene())
        .unwrap_err()
        .to_string();
    assert!(refused.contains("bob may have 0 scenes"), "{refused}");
    assert!(c.take_scene_of("ada", &self::scene()).is_ok());
}

#[test]
fn jobs_that_are_too_old_or_too_many_are_deleted() {
    let (c, clock, scene) = coordinator();
    let id = two_tiles(&c, scene);
    let (worker, mut orders) = join(&c, "ada");
    work(&c, worker, &mut orders, false);
    wait_until("the end", || control::result(&c, id).is_ok());
    let mut c = alone(c);
    c.retention = Retention {
        keep: Some(Duration::from_secs(60)),
        keep_bytes: None,
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    tidy_up(&c);
    assert!(c.store.job(id).unwrap().is_some());
    let result = control::result(&c, id).unwrap();
    let mut c = alone(c);
    c.retention = Retention {
        keep: None,
        keep_bytes: Some(10),
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    tidy_up(&c);
    assert!(c.store.job(id).unwrap().is_none() && !c.blobs.has(&result).unwrap());
    // Its scene has gone with it; another one that no job names stays, however large it is.
    assert!(c.store.scenes().unwrap().is_empty());
    c.take_scene(&self::scene()).unwrap();
    tidy_up(&c);
    assert_eq!(c.store.scenes().unwrap().len(), 1);
    // By age, and with it the scene that nobody names any more.
    let other = of_user(&c, "", scene, 1).unwrap();
    control::cancel(&c, other).unwrap();
    let keep = Some(Duration::from_millis(1));
    let mut c = alone(c);
    c.retention = Retention {
        keep,
        keep_bytes: None,
        grace: Duration::ZERO,
    };
    let c = Arc::new(c);
    // Times of blobs are of the system's clock, which advances during the test.
    clock.advance(Duration::from_secs(3600));
    tidy_up(&c);
    assert!(c.store.jobs().unwrap().is_empty() && c.store.scenes().unwrap().is_empty());
    assert!(!c.blobs.has(&scene).unwrap());
}

#[test]
fn a_list_that_names_a_chunk_many_times_is_refused_before_anything_is_written() {
    let (c, ..) = coordinator();
    let chunk = scenes::put_chunk(&c, "", &[7; 1 << 20]).unwrap();
    let refused = scenes::put_scene(&c, "", [9; 32], &vec![chunk; 65_536]).unwrap_err();
    assert!(
        matches!(refused, UploadError::TooLong { bytes, .. } if bytes == 64 << 30),
        "{refused}"
    );
    // A short upload does not become a long scene, either.
    let refused = scenes::put_scene(&c, "", [9; 32], &vec![chunk; 1500]).unwrap_err();
    let is_found =
        matches!(refused, UploadError::Repeated { bytes, sent, .. } if bytes / 1500 == sent);
    assert!(is_found, "{refused}");
    // Another blob than a chunk is rejected.
    let long = c.blobs.put(&vec![7; (1 << 20) + 1]).unwrap();
    let refused = scenes::put_scene(&c, "", [9; 32], &[long]).unwrap_err();
    assert!(
        matches!(refused, UploadError::LongChunk { .. }),
        "{refused}"
    );
}

#[test]
fn a_coordinator_whose_disk_cannot_be_written_is_not_ready() {
    let directory = tempfile::tempdir().unwrap();
    let c = Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
    assert_eq!(readiness(&c), Ok(()));
    std::fs::remove_dir_all(directory.path().join("blobs")).unwrap();
    *c.last_trial.lock().unwrap() = None;
    let reasons = readiness(&c).unwrap_err();
    assert!(
        reasons.len() == 1 && reasons[0].contains("blobs cannot be written"),
        "{reasons:?}"
    );
}

#[test]
fn a_worker_that_was_right_later_answers_for_what_was_wrong_before() {
    let (c, clock, scene) = checking();
    let id = two_tiles(&c, scene);
    let (liar, mut of_liar) = join(&c, "liar");
    let grants = [granted(&mut of_liar), granted(&mut of_liar)];
    put(&c, &grants[0], &output(&grants[0], &[])).unwrap();
    clock.advance(Duration::from_secs(1));
    // This one is confirmed first, and is later than the wrong one.
    put(&c, &grants[1], &output(&grants[1], &[0])).unwrap();
    let mut workers = ["ada", "bob"].map(|name| join(&c, name));
    wait_until("the end", || {
        clock.advance(Duration::from_millis(200));
        lifecycle::tick(&c).run(&c);
        for (worker, orders) in &mut workers {
            work(&c, *worker, orders, false);
        }
        work(&c, liar, &mut of_liar, true);
        control::result(&c, id).is_ok()
    });
    assert_eq!(
        c.blobs.read(&control::result(&c, id).unwrap()).unwrap(),
        calm()
    );
    assert_eq!(c.store.quarantined().unwrap().len(), 1);
}

#[test]
fn a_deleted_job_takes_its_scene_along_unless_others_need_it() {
    let (c, _, scene) = coordinator();
    let [first, second] = [1, 2].map(|seed| of_user(&c, "", scene, seed).unwrap());
    for (job, stays) in [(first, true), (second, false)] {
        control::cancel(&c, job).unwrap();
        crate::jobs::delete::delete(&c, job).unwrap();
        assert_eq!(c.store.scene(&scene).unwrap().is_some(), stays);
        assert_eq!(c.blobs.has(&scene).unwrap(), stays);
    }
    // What another user has sent stays theirs.
    c.take_scene_of("ada", &self::scene()).unwrap();
    c.take_scene_of("bob", &self::scene()).unwrap();
    let job = of_user(&c, "ada", scene, 1).unwrap();
    control::cancel(&c, job).unwrap();
    crate::jobs::delete::delete(&c, job).unwrap();
    assert!(c.store.scene(&scene).unwrap().is_some());
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
        c.retention = Retention {
            keep: None,
            keep_bytes: None,
            grace: Duration::ZERO,
        };
        Arc::new(c)
    };
    let right = coordinator_with(MemoryStore::new());
    let scene = right.take_scene(&scene()).unwrap();
    let chunk = blobs.put(b"a chunk of an upload that was left").unwrap();
    // Another store's records, such as the records of a wrong data directory, name none of the blobs.
    tidy_up(&coordinator_with(MemoryStore::new()));
    assert!(blobs.has(&scene).unwrap() && blobs.has(&chunk).unwrap());
    // The store that the blobs belong to still removes unreferenced ones.
    tidy_up(&right);
    assert!(blobs.has(&scene).unwrap() && !blobs.has(&chunk).unwrap());
}
