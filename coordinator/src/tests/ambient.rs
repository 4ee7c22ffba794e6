//! Tests of ambient occlusion jobs on a coordinator in memory: owners of receivers, rejections, failed tiles,
//! and retention.

use std::sync::Arc;
use std::time::Duration;

use sightline_model::openness::Openness;
use sightline_model::receivers::{Falloff, Receiver, ReceiverSettings, Receivers};
use sightline_model::{Ambient, JobSpec, NO_PROFILE};
use sightline_records::JobState;
use sightline_records::ids::Digest;
use sightline_scene::TriangleId;
use sightline_scheduler::{Failure, Introduction, Progress, WorkerCommand};
use tokio::sync::mpsc;

use crate::access::{Caller, Scope, Scopes};
use crate::blobs::references;
use crate::coordinator::Coordinator;
use crate::jobs::control;
use crate::jobs::delete;
use crate::jobs::submit::{Submission, SubmitError, submit};
use crate::jobs::suspend;
use crate::jobs::suspensions::MissingBlob;
use crate::outputs::commit::ResultError;
use crate::quota::{Quotas, Usage, usage};
use crate::results::partial;
use crate::results::queries::{self, AskError};
use crate::startup;
use crate::tests::life::{coordinator, granted, nameless, put, two_tiles};
use crate::uploads::complete::UploadError;
use crate::uploads::receivers::{self, StoredReceiversError};
use crate::uploads::scenes;
use crate::users::quota_check::ReservationError;
use crate::workers::sessions::{self, Message};

/// Encodes receivers in blocks of these lengths, on the only triangle.
fn of_blocks(blocks: &[u32]) -> Vec<u8> {
    let all: u32 = blocks.iter().sum();
    let receiver = |i: u32| Receiver {
        point: [f64::from(i), 0.0, 0.0],
        normal: [0.0, 0.0, 1.0],
        triangle: Some(TriangleId(0)),
    };
    let settings = ReceiverSettings {
        distance: 2.0,
        falloff: Falloff::None,
        lights: Vec::new(),
    };
    let receivers = (0..all).map(receiver).collect();
    Receivers {
        settings,
        blocks: blocks.to_vec(),
        receivers,
    }
    .encode()
    .unwrap()
}

/// Uploads bytes as receivers of an owner, in chunks of 100 000 bytes.
fn send(c: &Coordinator, owner: &str, bytes: &[u8]) -> Result<Digest, UploadError> {
    let whole = *blake3::hash(bytes).as_bytes();
    let chunks: Vec<Digest> = bytes
        .chunks(100_000)
        .map(|part| scenes::put_chunk(c, owner, part).unwrap())
        .collect();
    receivers::put(c, owner, whole, &chunks).map(|_| whole)
}

fn user(name: &str) -> Caller {
    Caller::User {
        name: name.to_owned(),
        scopes: Scopes::new(&[Scope::Submit]),
    }
}

fn ambient_job(c: &Coordinator, scene: Digest, digest: Digest, owner: &str) -> Submission {
    let stored = c.uploads.receivers(&*c.blobs, digest).unwrap();
    let (bytes, points, lights) = (stored.bytes, stored.facts.points, stored.facts.lights);
    let spec = JobSpec::of_receivers(
        scene,
        Ambient {
            receivers: digest,
            bytes,
            points,
            lights,
        },
    );
    Submission {
        owner: owner.to_owned(),
        ..nameless(spec)
    }
}

fn worker() -> Introduction {
    Introduction {
        name: "a".to_owned(),
        signature: "a".to_owned(),
        version: String::new(),
        instance: 0,
        profiles: vec![NO_PROFILE.to_owned()],
        held: Vec::new(),
        helps: false,
    }
}

#[test]
fn job_finishes_and_failed_tile_has_no_answers() {
    let (c, clock, scene) = coordinator();
    // The second tile starts with receiver 4100.
    let digest = send(&c, "", &of_blocks(&[4090, 10, 5])).unwrap();
    let id = submit(&c, &ambient_job(&c, scene, digest, "")).unwrap().id;
    let summary = control::summary(&c, id).unwrap();
    assert_eq!((summary.tiles_total, summary.cells_total), (2, 4105));
    let (out, mut commands) = mpsc::channel(64);
    let (joined, follow_ups) = sessions::join(&c, worker(), Box::new(out)).unwrap();
    follow_ups.run(&c);
    sessions::heard(&c, joined.worker, Message::Want(2)).run(&c);
    let grants = [granted(&mut commands), granted(&mut commands)];
    assert_eq!(grants[0].planned.ambient().unwrap().receivers, digest);
    let tile = |points: usize, value| Openness {
        numbers: 1,
        values: vec![value; points],
        bound: 1e-9,
    };
    let refused =
        |openness: Openness| put(&c, &grants[0], &openness.encode().unwrap()).unwrap_err();
    assert!(matches!(refused(tile(4096, 0.5)), ResultError::Answers(_)));
    assert!(matches!(refused(tile(4100, 1.5)), ResultError::Answers(_)));
    assert!(matches!(
        refused(Openness {
            numbers: 2,
            ..tile(4100, 0.5)
        }),
        ResultError::Answers(_)
    ));
    assert!(matches!(
        partial::so_far(&c, id, &|| false),
        Err(partial::PartialError::Nothing(_))
    ));
    put(&c, &grants[0], &tile(4100, 0.5).encode().unwrap()).unwrap();
    let so_far = Openness::of_result(&partial::so_far(&c, id, &|| false).unwrap()).unwrap();
    assert_eq!(
        (so_far.points(), so_far.missing(), so_far.values[4099]),
        (4105, 5, 0.5)
    );
    // The other tile fails five times.
    let mut grant = grants[1].clone();
    for attempt in 0.. {
        assert!(attempt < 10, "{:?}", control::summary(&c, id).unwrap());
        let failure = Failure {
            lease: grant.lease,
            reason: "test".to_owned(),
            infrastructure: false,
        };
        sessions::heard(&c, joined.worker, Message::Failed(failure)).run(&c);
        sessions::heard(&c, joined.worker, Message::Want(1)).run(&c);
        clock.advance(Duration::from_secs(1));
        startup::tick(&c).run(&c);
        match commands.try_recv() {
            Ok(WorkerCommand::Grant(next)) => grant = *next,
            _ => break,
        }
    }
    let mut tries = 0;
    while !control::summary(&c, id).unwrap().ended() {
        tries += 1;
        assert!(tries < 1000, "{:?}", control::summary(&c, id).unwrap());
        std::thread::sleep(Duration::from_millis(10));
    }
    let summary = control::summary(&c, id).unwrap();
    assert_eq!(
        (
            summary.tiles_done,
            summary.tiles_set_aside,
            summary.cells_done
        ),
        (1, 1, 4100)
    );
    let result = c
        .blobs
        .read(&control::result(&c.records, id).unwrap())
        .unwrap();
    assert_eq!(Openness::of_result(&result).unwrap().missing(), 5);
    let why = queries::query(
        &c,
        &sightline_proto::v1::QueryRequest {
            job: id.0,
            ..Default::default()
        },
    );
    assert!(
        matches!(&why, Err(AskError::Unable(text)) if text.contains("ambient")),
        "{why:?}"
    );
}

#[test]
fn job_waits_for_receivers_lost_before_end() {
    let (c, _, scene) = coordinator();
    let bytes = of_blocks(&[3]);
    let digest = send(&c, "", &bytes).unwrap();
    let id = submit(&c, &ambient_job(&c, scene, digest, "")).unwrap().id;
    let (out, mut commands) = mpsc::channel(8);
    let (joined, follow_ups) = sessions::join(&c, worker(), Box::new(out)).unwrap();
    follow_ups.run(&c);
    sessions::heard(&c, joined.worker, Message::Want(1)).run(&c);
    let grant = granted(&mut commands);
    let progress = Progress {
        lease: grant.lease,
        cells: 1,
        samples: 0,
    };
    sessions::heard(&c, joined.worker, Message::Progress(progress)).run(&c);
    // The output arrives while no assembly runs. Then the coordinator is in the state after a restart.
    control::pause(&c, id, false).unwrap();
    let tile = Openness {
        numbers: 1,
        values: vec![0.5; 3],
        bound: 1e-9,
    };
    put(&c, &grant, &tile.encode().unwrap()).unwrap();
    *c.uploads.last_receivers.lock().unwrap() = None;
    assert!(c.blobs.remove(&digest).unwrap());
    control::resume(&c, id).unwrap();
    let until = |is: &dyn Fn() -> bool| {
        for _ in 0..1000 {
            if is() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("{:?}", control::summary(&c, id).unwrap());
    };
    until(&|| control::summary(&c, id).unwrap().missing == Some(MissingBlob::Receivers(digest)));
    until(&|| control::summary(&c, id).unwrap().record.state == JobState::Paused);
    send(&c, "", &bytes).unwrap();
    suspend::resume_jobs(&c, MissingBlob::Receivers(digest));
    until(&|| control::result(&c.records, id).is_ok());
    let result = c
        .blobs
        .read(&control::result(&c.records, id).unwrap())
        .unwrap();
    assert_eq!(Openness::of_result(&result).unwrap().values, [0.5; 3]);
}

#[test]
fn receivers_belong_to_sender_and_count_for_quota() {
    let (c, _, scene) = coordinator();
    let bytes = of_blocks(&[4096, 4096]);
    assert!(bytes.len() > 200_000);
    let digest = send(&c, "ada", &bytes).unwrap();
    assert_eq!(c.uploads.chunks.bytes("ada"), bytes.len() as u64);
    assert_eq!(
        receivers::known(&c, &user("ada"), digest)
            .unwrap()
            .facts
            .points,
        8192
    );
    assert!(matches!(
        receivers::known(&c, &user("bob"), digest),
        Err(StoredReceiversError::Unknown(_))
    ));
    // The digest is not sufficient, and chunks of another user do not count.
    let chunk = *blake3::hash(&bytes[..100_000]).as_bytes();
    for chunks in [&[][..], &[chunk], &[digest]] {
        let refused = receivers::put(&c, "bob", digest, chunks).unwrap_err();
        let is_refused = matches!(
            refused,
            UploadError::ChunkMissing | UploadError::Mismatch(_)
        );
        assert!(is_refused, "{chunks:?}: {refused}");
        assert!(matches!(
            receivers::known(&c, &user("bob"), digest),
            Err(StoredReceiversError::Unknown(_))
        ));
    }
    // From the submission on, the job counts the receivers, and its owner owns them.
    let id = submit(&c, &ambient_job(&c, scene, digest, "ada"))
        .unwrap()
        .id;
    assert_eq!(c.uploads.chunks.bytes("ada"), 0);
    let has = usage(c.records.queries(), "ada").unwrap();
    assert_eq!(
        has,
        Usage {
            bytes: bytes.len() as u64,
            scenes: 0,
            jobs: 1,
            tiles: 2
        }
    );
    assert!(receivers::known(&c, &user("ada"), digest).is_ok());
    // A second upload with only the digest finds the receivers.
    assert!(receivers::put(&c, "ada", digest, &[]).is_ok());
    assert!(matches!(
        receivers::known(&c, &user("bob"), digest),
        Err(StoredReceiversError::Unknown(_))
    ));
    // The receivers are kept while a job references them.
    let alone = |remove: &mut dyn FnMut()| remove();
    references::sweep(c.records.queries(), &*c.blobs, &|_, _| true, &alone).unwrap();
    assert!(c.blobs.has(&digest).unwrap());
    let lost = |c: &Coordinator| {
        references::verify(c.records.queries(), &*c.blobs, &|_| ())
            .unwrap()
            .lost
            .len()
    };
    assert_eq!(lost(&c), 0);
    let other = submit(&c, &ambient_job(&c, scene, digest, "")).unwrap().id;
    for (job, stays) in [(id, true), (other, false)] {
        control::cancel(&c, job).unwrap();
        delete::delete(&c, job).unwrap();
        assert_eq!(c.blobs.has(&digest).unwrap(), stays);
    }
}

#[test]
fn invalid_ambient_jobs_are_rejected() {
    let (c, _, scene) = coordinator();
    // The bytes are not receivers, and none of them are kept.
    for bytes in [&b"halls"[..], &vec![7; 300_000]] {
        let refused = send(&c, "", bytes).unwrap_err();
        assert!(matches!(refused, UploadError::Receivers(_)), "{refused}");
        assert!(!c.blobs.has(blake3::hash(bytes).as_bytes()).unwrap());
    }
    // An existing blob stays.
    let refused = receivers::put(&c, "", scene, &[]).unwrap_err();
    assert!(
        matches!(refused, UploadError::Receivers(_)) && c.blobs.has(&scene).unwrap(),
        "{refused}"
    );
    let chunk = scenes::put_chunk(&c, "", &[7; 1 << 20]).unwrap();
    let refused = receivers::put(&c, "", [9; 32], &vec![chunk; 65_536]).unwrap_err();
    assert!(
        matches!(refused, UploadError::TooLong { bytes, .. } if bytes == 64 << 30),
        "{refused}"
    );
    // The receiver is on a triangle that the scene does not have.
    let settings = ReceiverSettings {
        distance: f64::INFINITY,
        falloff: Falloff::None,
        lights: Vec::new(),
    };
    let receiver = Receiver {
        point: [0.0; 3],
        normal: [0.0, 1.0, 0.0],
        triangle: Some(TriangleId(1)),
    };
    let bytes = Receivers {
        settings,
        blocks: vec![1],
        receivers: vec![receiver],
    }
    .encode()
    .unwrap();
    let digest = send(&c, "", &bytes).unwrap();
    let refused = submit(&c, &ambient_job(&c, scene, digest, "")).unwrap_err();
    assert!(matches!(refused, SubmitError::Receiver(1)), "{refused}");
    // The receivers no longer exist.
    let digest = send(&c, "", &of_blocks(&[3])).unwrap();
    let submission = ambient_job(&c, scene, digest, "");
    c.blobs.remove(&digest).unwrap();
    let refused = submit(&c, &submission).unwrap_err();
    assert!(
        matches!(
            refused,
            SubmitError::Receivers(StoredReceiversError::Unknown(_))
        ),
        "{refused}"
    );
    // The receivers exceed the user's quota.
    let mut c = c;
    let c = loop {
        match Arc::try_unwrap(c) {
            Ok(mut alone) => {
                alone.config.quotas = Quotas::parse(&["bytes=300".to_owned()]).unwrap();
                break Arc::new(alone);
            }
            Err(shared) => c = shared,
        }
    };
    assert!(send(&c, "ada", &of_blocks(&[3])).is_ok());
    let refused = scenes::put_chunk(&c, "ada", &of_blocks(&[2])).unwrap_err();
    assert!(
        matches!(
            refused,
            UploadError::Quota(ReservationError::LimitExceeded(_))
        ),
        "{refused}"
    );
    // Other jobs continue as before.
    assert_eq!(
        control::summary(&c, two_tiles(&c, scene))
            .unwrap()
            .tiles_total,
        2
    );
}
