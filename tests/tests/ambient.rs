//! Tests of ambient occlusion on a cluster of real processes.
//!
//! The bytes equal the bytes of the solver in this process, and the coordinator rejects invalid requests.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline::{Client, Endpoint, OrderedReceivers, Silent, Submission};
use sightline_ambient::{AmbientScene, Falloff, Light, Receiver, Solver, SolverSettings};
use sightline_proto::connection::{Connection, Credentials};
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::{Scene, TriangleId};
use sightline_tests::{Coordinator, Sandbox};
use tonic::{Code, Status};

const SCENE: &str = "generate town --triangles 2000 -o town.glb";
/// The maximum distance of occluders, in metres.
const DISTANCE: f64 = 1.0;
/// The number of receivers, which fill five tiles.
const RECEIVERS: usize = 18_000;

fn town(sandbox: &Sandbox) -> Scene {
    sandbox.ok(SCENE);
    sightline_scene::load(&sandbox.path("town.glb")).unwrap()
}

/// Returns points on the triangles of a scene, one after the other.
fn receivers(scene: &Scene, count: usize) -> Vec<Receiver> {
    let mut out = Vec::new();
    let triangles = scene.triangles();
    // The points are away from the edges. Further points of a triangle are on the line to its first corner.
    for turn in 0u32.. {
        for (id, triangle) in (0u32..).zip(triangles) {
            let [a, b, c] = triangle.v.map(|v| v.as_dvec3());
            let normal = (b - a).cross(c - a);
            let flat = normal.length() < 1e-9;
            if flat {
                continue;
            }
            let middle = (a + b + c) / 3.0;
            let point = middle + (a - middle) * f64::from(turn % 9) / 10.0;
            out.push(Receiver {
                point,
                normal: normal.normalize(),
                triangle: Some(TriangleId(id)),
            });
            if out.len() == count {
                return out;
            }
        }
    }
    out
}

/// Returns settings with falloff and a light.
fn settings() -> SolverSettings {
    let light = Light::new(&[[0.0, 9.0, 0.0], [5.0, 9.0, 0.0], [5.0, 9.0, 5.0]]).unwrap();
    SolverSettings {
        falloff: Falloff::Sqrt,
        lights: vec![light],
        ..SolverSettings::new(DISTANCE)
    }
}

async fn connect(coordinator: &Coordinator<'_>) -> JobsClient<Connection> {
    let credentials = Credentials::default();
    let channel = credentials
        .endpoint(&coordinator.url)
        .unwrap()
        .connect()
        .await
        .unwrap();
    JobsClient::new(credentials.over(channel))
}

fn library_client(coordinator: &Coordinator<'_>) -> Client {
    Client::new(Endpoint::new(&coordinator.url)).unwrap()
}

#[test]
fn cluster_with_killed_worker_gives_bytes_of_solver() {
    let sandbox = Sandbox::new();
    let scene = town(&sandbox);
    let all = receivers(&scene, RECEIVERS);
    let prepared = AmbientScene::new(&scene, false).unwrap();
    let solver = Solver::new(&prepared, settings());
    let ordered = OrderedReceivers::new(&solver, &all);
    let submission = Submission {
        name: "town".to_owned(),
        ..Submission::default()
    };
    let mut results = Vec::new();
    for (data, workers, kills) in [("one", 1, false), ("two", 2, false), ("killed", 2, true)] {
        let coordinator = sandbox.coordinator(data, "127.0.0.1:0");
        let client = library_client(&coordinator);
        let handle = client
            .submit_ambient(&scene, &ordered, &submission, &Silent)
            .unwrap();
        let job = handle.job().message().clone();
        assert_eq!((job.tiles_total, job.cells_total), (5, RECEIVERS as u64));
        let mut working: Vec<_> = (0..workers).map(|_| coordinator.worker()).collect();
        if kills {
            coordinator.until(job.id, "the job's middle", |job| {
                job["tiles_done"].as_u64().unwrap() > 0
                    && job["tiles_running"].as_u64().unwrap() > 0
            });
            working.remove(0).kill();
        }
        coordinator.ok(&format!("watch {}", job.id));
        // The same submission returns the same job.
        let handle = client
            .submit_ambient(&scene, &ordered, &submission, &Silent)
            .unwrap();
        let again = handle.job().message().clone();
        assert_eq!((again.id, again.state()), (job.id, v1::JobState::Done));
        assert_eq!(
            (again.cells_done, again.tiles_set_aside),
            (RECEIVERS as u64, 0)
        );
        assert_eq!(again.profile, "none");
        let openness = handle.fetch_openness(&ordered, &Silent).unwrap();
        assert_eq!(openness.missing(), 0);
        results.push((again.result, openness));
        // The job has no sets.
        coordinator
            .run(&format!("fetch {} -o town.pvs", job.id))
            .code(2)
            .says("ambient occlusion");
    }
    let (digest, openness) = &results[0];
    assert!(
        results.iter().all(|(other, _)| other == digest),
        "the bytes differ"
    );
    let solved = solver.solve(&all, |_| {});
    let numbers = solved.iter().flat_map(|a| [a.openness.open, a.lights[0]]);
    let expected: Vec<f32> = numbers.map(|x| (x as f32).clamp(0.0, 1.0)).collect();
    assert!(
        ordered.restore(openness) == expected,
        "the answers are not those of the solver"
    );
    let bound = solved
        .iter()
        .fold(0.0, |most: f64, a| most.max(a.openness.bound));
    assert_eq!(openness.bound, bound);
    // Some receivers are in the open, and others are not.
    let mean = |k: usize| {
        expected
            .iter()
            .skip(k)
            .step_by(2)
            .map(|x| f64::from(*x))
            .sum::<f64>()
            / RECEIVERS as f64
    };
    assert!(
        (0.1..0.98).contains(&mean(0)) && mean(1) > 1e-4,
        "{} {}",
        mean(0),
        mean(1)
    );
}

#[test]
fn job_without_receivers_waits_for_upload() {
    let sandbox = Sandbox::new();
    let scene = town(&sandbox);
    let all = receivers(&scene, 300);
    let prepared = AmbientScene::new(&scene, false).unwrap();
    let ordered =
        OrderedReceivers::new(&Solver::new(&prepared, SolverSettings::new(DISTANCE)), &all);
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let client = library_client(&coordinator);
    let submission = Submission::default();
    let job = client
        .submit_ambient(&scene, &ordered, &submission, &Silent)
        .unwrap()
        .job()
        .id();
    let digest = blake3::hash(&ordered.receivers().encode().unwrap()).to_hex();
    let blob = format!("data/blobs/{}/{}/{digest}", &digest[..2], &digest[2..4]);
    std::fs::remove_file(sandbox.path(&blob)).unwrap();
    let _worker = coordinator.worker();
    // The job waits, and reports the missing blob.
    let paused = coordinator.until(job, "a pause", |job| job["state"] == "paused");
    assert!(
        paused["reason"]
            .as_str()
            .unwrap()
            .contains("send the receivers again"),
        "{paused}"
    );
    assert!(
        coordinator
            .ok(&format!("logs {job}"))
            .contains("send the receivers again")
    );
    // The same submission uploads the receivers, and the job continues.
    let again = client
        .submit_ambient(&scene, &ordered, &submission, &Silent)
        .unwrap();
    assert_eq!(again.job().id(), job);
    coordinator.ok(&format!("watch {job}"));
    let handle = client
        .submit_ambient(&scene, &ordered, &submission, &Silent)
        .unwrap();
    let done = handle.job().message().clone();
    assert_eq!(
        (done.id, done.state(), done.reason.as_str()),
        (job, v1::JobState::Done, "")
    );
    let openness = handle.fetch_openness(&ordered, &Silent).unwrap();
    assert_eq!((openness.points(), openness.missing()), (300, 0));
}

#[track_caller]
fn refused<T>(answer: Result<T, Status>, code: Code, text: &str) {
    let Err(status) = answer else {
        panic!("was not refused as {code:?}")
    };
    assert_eq!(status.code(), code, "{status:?}");
    assert!(
        status.message().contains(text),
        "{status:?} does not say {text:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_receivers_and_jobs_are_rejected_with_reason() {
    let sandbox = Sandbox::new();
    let scene = town(&sandbox);
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let client = connect(&coordinator).await;
    let put_chunk = async |bytes: &[u8]| {
        let (crc32c, total) = (crc32c::crc32c(bytes), bytes.len() as u64);
        let chunk = v1::Chunk {
            data: bytes.to_vec(),
            crc32c,
            offset: 0,
            total,
            address: None,
        };
        client
            .clone()
            .put_chunks(tokio_stream::iter([chunk]))
            .await
            .unwrap();
    };
    let put = async |bytes: &[u8]| {
        let mut client = client.clone();
        let digest = blake3::hash(bytes).as_bytes().to_vec();
        put_chunk(bytes).await;
        let request = v1::PutReceiversRequest {
            chunks: vec![digest.clone()],
            digest: digest.clone(),
        };
        client
            .put_receivers(request)
            .await
            .map(tonic::Response::into_inner)
    };
    let prepared = AmbientScene::new(&scene, false).unwrap();
    let ordered = |change: &dyn Fn(&mut Receiver)| {
        let mut all = receivers(&scene, 3);
        all.iter_mut().for_each(change);
        OrderedReceivers::new(&Solver::new(&prepared, SolverSettings::new(DISTANCE)), &all)
    };
    // Receivers with each kind of damage that has its own message. The layout is in docs/formats/ambient.md.
    let good = ordered(&|_| ()).receivers().encode().unwrap();
    let bent = |at: usize, with: &[u8]| {
        let mut bytes = good.clone();
        bytes[at..at + with.len()].copy_from_slice(with);
        bytes
    };
    let nan = f64::NAN.to_le_bytes();
    let first = good.len() - 3 * 52;
    refused(put(b"halls").await, Code::InvalidArgument, "cut short");
    refused(
        put(&bent(0, b"X")).await,
        Code::InvalidArgument,
        "not SLRECV01",
    );
    refused(put(&bent(8, &nan)).await, Code::InvalidArgument, "distance");
    refused(
        put(&bent(8, &0f64.to_le_bytes())).await,
        Code::InvalidArgument,
        "distance",
    );
    refused(put(&bent(16, &[2])).await, Code::InvalidArgument, "falloff");
    refused(
        put(&bent(17, &u32::MAX.to_le_bytes())).await,
        Code::InvalidArgument,
        "exceeds the remaining bytes",
    );
    refused(
        put(&bent(21, &u32::MAX.to_le_bytes())).await,
        Code::InvalidArgument,
        "exceeds the remaining bytes",
    );
    refused(
        put(&bent(first, &nan)).await,
        Code::InvalidArgument,
        "receiver 0",
    );
    refused(
        put(&bent(first + 52 + 24, &[0; 24])).await,
        Code::InvalidArgument,
        "receiver 1",
    );
    refused(
        put(&good[..good.len() - 1]).await,
        Code::InvalidArgument,
        "block sizes",
    );
    // Damaged lights.
    let lit = |corners: &[[f64; 3]]| {
        let words = [1, corners.len() as u32]
            .into_iter()
            .flat_map(u32::to_le_bytes);
        let light: Vec<u8> = words
            .chain(corners.iter().flatten().flat_map(|x| x.to_le_bytes()))
            .collect();
        [&good[..17], &light, &good[21..]].concat()
    };
    let dented = lit(&[
        [0.0, 9.0, 0.0],
        [4.0, 9.0, 0.0],
        [1.0, 9.0, 1.0],
        [0.0, 9.0, 4.0],
    ]);
    for (light, text) in [
        (
            &dented,
            "light 0 of the job cannot be used: the polygon is not convex at corner 2; divide it",
        ),
        (
            &lit(&[[0.0, 9.0, 0.0], [4.0, 9.0, 0.0]]),
            "give a convex polygon of 3 to 64",
        ),
        (
            &lit(&[[0.0, 9.0, 0.0], [4.0, f64::NAN, 0.0], [0.0, 9.0, 4.0]]),
            "corner 1 is not finite",
        ),
        (
            &lit(&[[0.0, 9.0, 0.0], [4.0, 9.0, 0.0], [8.0, 9.0, 0.0]]),
            "no area",
        ),
    ] {
        refused(put(light).await, Code::InvalidArgument, text);
    }
    put(&lit(&[[0.0, 9.0, 0.0], [0.0, 9.0, 4.0], [4.0, 9.0, 0.0]]))
        .await
        .unwrap();
    // Invalid jobs.
    let mut jobs = client.clone();
    let receivers = ordered(&|_| ());
    // The client of the library blocks, so it needs a thread.
    std::thread::scope(|scope| {
        let submit = || {
            let submission = Submission::default();
            let client = library_client(&coordinator);
            let submitted = client.submit_ambient(&scene, &receivers, &submission, &Silent);
            submitted.map(drop).unwrap();
        };
        scope.spawn(submit).join().unwrap();
    });
    let submit = async |receivers: Vec<u8>, change: &dyn Fn(&mut v1::JobSpec)| {
        let ambient = v1::Ambient {
            receivers,
            ..v1::Ambient::default()
        };
        let scene = scene.digest().0.to_vec();
        let task = Some(v1::job_spec::Task::Ambient(ambient));
        let mut spec = v1::JobSpec { scene, task };
        change(&mut spec);
        let request = v1::SubmitRequest {
            spec: Some(spec),
            ..v1::SubmitRequest::default()
        };
        client
            .clone()
            .submit(request)
            .await
            .map(tonic::Response::into_inner)
    };
    let digest = put(&good).await.unwrap().digest;
    // Fields that the coordinator fills in do not change the job.
    assert!(submit(digest.clone(), &|_| ()).await.unwrap().existing);
    refused(
        submit(vec![9; 32], &|_| ()).await,
        Code::NotFound,
        "PutReceivers",
    );
    refused(
        submit(vec![9; 3], &|_| ()).await,
        Code::InvalidArgument,
        "32",
    );
    refused(
        submit(scene.digest().0.to_vec(), &|_| ()).await,
        Code::InvalidArgument,
        "not SLRECV01",
    );
    // The submission references receivers that were not checked.
    put_chunk(&dented).await;
    let unchecked = blake3::hash(&dented).as_bytes().to_vec();
    refused(
        submit(unchecked, &|_| ()).await,
        Code::InvalidArgument,
        "light 0 of the job",
    );
    refused(
        submit(digest.clone(), &|s| s.scene = vec![9; 32]).await,
        Code::NotFound,
        "scene",
    );
    let beyond = ordered(&|r| r.triangle = Some(TriangleId(u32::MAX - 1)))
        .receivers()
        .encode()
        .unwrap();
    let beyond = put(&beyond).await.unwrap().digest;
    refused(
        submit(beyond, &|_| ()).await,
        Code::InvalidArgument,
        "triangle 4294967294",
    );
    // Without workers, no result exists.
    let job = submit(digest, &|_| ()).await.unwrap().job.unwrap();
    let request = v1::ShowRequest { job: job.id };
    refused(
        jobs.fetch(request).await.map(drop),
        Code::FailedPrecondition,
        "queued",
    );
    refused(
        jobs.fetch_partial(request).await.map(drop),
        Code::FailedPrecondition,
        "no finished tile",
    );
}
