//! Tests of the retention of a coordinator whose wall clock steps.

use std::sync::Arc;
use std::time::Duration;

use sightline_records::ids::{Digest, JobId};
use sightline_store::{MemoryBlobs, MemoryStore};

use crate::clock::ManualClock;
use crate::config::Leases;
use crate::config::Retention;
use crate::coordinator::Coordinator;
use crate::jobs::control;
use crate::jobs::retention::tidy_up;
use crate::jobs::retention_stamp;
use crate::jobs::submit::submit;
use crate::telemetry::events::EventKind;
use crate::tests::life::{nameless, one_cell, triangle};
use crate::tests::trust::alone;
use crate::uploads::scenes;

const DAY: Duration = Duration::from_secs(24 * 3600);
const DAY_MS: i64 = 24 * 3_600_000;

/// Creates a coordinator that has run for longer than its ages, with a correct wall clock. Returns the
/// coordinator, its clock, and the digest of a scene.
fn coordinator(
    keep: Option<Duration>,
    keep_bytes: Option<u64>,
) -> (Arc<Coordinator>, Arc<ManualClock>, Digest) {
    let clock = Arc::new(ManualClock::default());
    // The times of blobs are from the system's clock.
    clock.step(-2 * DAY_MS);
    let (store, blobs) = (Box::new(MemoryStore::new()), Box::new(MemoryBlobs::new()));
    let c = Coordinator::new(
        Leases::default(),
        store,
        blobs,
        Box::new(Arc::clone(&clock)),
    )
    .unwrap();
    let mut c = alone(c);
    c.config.retention = Retention {
        keep,
        keep_bytes,
        grace: DAY,
    };
    clock.advance(2 * DAY);
    let scene = c.take_scene(&triangle()).unwrap();
    (Arc::new(c), clock, scene)
}

/// Submits a job and cancels it.
fn ended(c: &Arc<Coordinator>, scene: Digest, seed: u64) -> JobId {
    let id = submit(c, &nameless(one_cell(scene, seed))).unwrap().id;
    control::cancel(c, id).unwrap();
    id
}

/// Returns the events about pauses of retention.
fn pauses(c: &Coordinator) -> Vec<String> {
    retention_stamp::record(c);
    let (events, _) = c.telemetry.event_log.after(None, 0, usize::MAX);
    let reports_clock_step = |text: &String| text.contains("the wall clock stepped");
    events
        .into_iter()
        .filter(|e| e.what.kind == EventKind::Coordinator)
        .map(|e| e.what.text)
        .filter(reports_clock_step)
        .collect()
}

#[test]
fn stepped_clock_deletes_no_jobs_and_no_blobs() {
    for step in [2 * DAY_MS, 3650 * DAY_MS, -2 * DAY_MS, -3650 * DAY_MS] {
        let (c, clock, scene) = coordinator(Some(DAY), None);
        let chunk = scenes::put_chunk(&c, "", b"a part of a scene").unwrap();
        let job = ended(&c, scene, 1);
        let is_there = || c.records.job(job).unwrap().is_some() && c.blobs.has(&chunk).unwrap();
        clock.step(step);
        tidy_up(&c);
        assert!(is_there(), "{step}");
        // This job ends under the wrong clock.
        let other = ended(&c, scene, 2);
        clock.step(-step);
        tidy_up(&c);
        assert!(
            is_there() && c.records.job(other).unwrap().is_some(),
            "{step}"
        );
        let pauses = pauses(&c);
        assert_eq!(pauses.len(), 2, "one for jobs, one for blobs: {pauses:?}");
        assert!(
            pauses[0].contains("the time service of the machine"),
            "{pauses:?}"
        );
        clock.advance(DAY - Duration::from_secs(1));
        tidy_up(&c);
        assert!(is_there(), "{step}");
        // Later, retention deletes both jobs and the scene.
        for _ in 0..4 {
            clock.advance(DAY);
            tidy_up(&c);
        }
        assert!(
            c.records.jobs().unwrap().is_empty() && c.records.scenes().unwrap().is_empty(),
            "{step}"
        );
        assert!(!c.blobs.has(&chunk).unwrap(), "{step}");
    }
}

#[test]
fn byte_bound_deletes_job_with_lowest_number() {
    let bytes = triangle().to_blob().len() as u64;
    let (c, clock, scene) = coordinator(None, Some(bytes + 10));
    clock.step(DAY_MS);
    let first = ended(&c, scene, 1);
    clock.step(-DAY_MS);
    let other = sightline_scene::Scene::new(
        "other",
        vec![sightline_scene::Triangle {
            v: [glam::Vec3::X, glam::Vec3::Y, glam::Vec3::Z],
        }],
        vec![sightline_scene::Object {
            name: "all".to_owned(),
            first: 0,
            count: 1,
        }],
    );
    let other = c.take_scene(&other.unwrap()).unwrap();
    let second = ended(&c, other, 2);
    tidy_up(&c);
    assert!(c.records.job(first).unwrap().is_none() && c.records.job(second).unwrap().is_some());
}
