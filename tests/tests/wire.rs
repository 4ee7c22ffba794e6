//! Tests of the gRPC interface as other programs use it: status codes, conflicting results, and failing
//! tiles. Tests with malformed messages are in `nonsense.rs`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline_proto::chunks::cut;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_tests::{Coordinator, Sandbox, assert_same, spec};
use tokio_stream::StreamExt as _;
use tonic::transport::Channel;
use tonic::{Code, Status};

const SCENE: &str = "generate maze --grid 3x3 -o maze.glb";
const JOB: &str = "maze.glb --sampler cubes --cells 4x4x2 --resolution 32 --backend cpu";

async fn connect(coordinator: &Coordinator<'_>) -> Channel {
    Channel::from_shared(coordinator.url.clone())
        .unwrap()
        .connect()
        .await
        .unwrap()
}

fn scene_of(digest: &[u8]) -> v1::FetchSceneRequest {
    v1::FetchSceneRequest {
        digest: digest.to_vec(),
        ..Default::default()
    }
}

/// Returns the introduction of a worker that returns wrong results.
fn liar(profiles: &[String]) -> v1::Hello {
    v1::Hello {
        name: "liar".to_owned(),
        profiles: profiles.to_vec(),
        algorithm: sightline_model::ALGORITHM_VERSION,
        protocol: sightline_proto::PROTOCOL,
        ..Default::default()
    }
}

fn pack_of(digest: &[u8]) -> v1::FetchPackRequest {
    v1::FetchPackRequest {
        digest: digest.to_vec(),
        ..Default::default()
    }
}

fn chunk(data: &[u8]) -> v1::Chunk {
    let (crc32c, total) = (crc32c::crc32c(data), data.len() as u64);
    v1::Chunk {
        data: data.to_vec(),
        crc32c,
        offset: 0,
        total,
        address: None,
    }
}

#[track_caller]
fn refused<T>(answer: Result<T, Status>, code: Code) -> String {
    let Err(status) = answer else {
        panic!("was not refused as {code:?}")
    };
    assert_eq!(status.code(), code, "{status:?}");
    assert!(status.message().len() > 10, "says too little: {status:?}");
    status.message().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_requests_are_rejected_with_right_code() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let channel = connect(&coordinator).await;
    let (mut jobs, mut workers) = (
        JobsClient::new(channel.clone()),
        WorkersClient::new(channel),
    );

    // Chunks: damaged in transit, too large, good, and good again.
    let mut damaged = chunk(b"some bytes");
    damaged.crc32c ^= 1;
    refused(
        jobs.put_chunks(tokio_stream::iter([damaged])).await,
        Code::DataLoss,
    );
    let digest = blake3::hash(b"some bytes").as_bytes().to_vec();
    let missing = |jobs: &mut JobsClient<Channel>| {
        let (mut jobs, asked) = (
            jobs.clone(),
            v1::MissingChunksRequest {
                digests: vec![digest.clone()],
            },
        );
        async move {
            jobs.missing_chunks(asked)
                .await
                .unwrap()
                .into_inner()
                .digests
        }
    };
    assert_eq!(
        missing(&mut jobs).await,
        std::slice::from_ref(&digest),
        "a damaged chunk is not kept"
    );
    for _ in 0..2 {
        let put = jobs
            .put_chunks(tokio_stream::iter([chunk(b"some bytes")]))
            .await
            .unwrap();
        assert_eq!(put.into_inner().chunks, 1);
    }
    assert!(missing(&mut jobs).await.is_empty());
    refused(
        jobs.put_chunks(tokio_stream::iter([chunk(&vec![0; (1 << 20) + 1])]))
            .await,
        Code::DataLoss,
    );

    // Digests: malformed, without a blob, and of a blob that is not a scene.
    for length in [0, 1, 31, 33, 1000] {
        let bad = vec![7; length];
        let request = v1::MissingChunksRequest {
            digests: vec![digest.clone(), bad.clone()],
        };
        refused(jobs.missing_chunks(request).await, Code::InvalidArgument);
        let request = v1::PutSceneRequest {
            chunks: vec![],
            digest: bad.clone(),
        };
        refused(jobs.put_scene(request).await, Code::InvalidArgument);
        refused(
            workers.fetch_scene(scene_of(&bad)).await,
            Code::InvalidArgument,
        );
        refused(
            workers.fetch_pack(pack_of(&bad)).await,
            Code::InvalidArgument,
        );
        let staged = v1::StageResultRequest {
            lease: None,
            sha256: bad,
            bytes: 1,
        };
        refused(workers.stage_result(staged).await, Code::InvalidArgument);
    }
    let nothing = vec![9; 32];
    refused(
        workers.fetch_scene(scene_of(&nothing)).await,
        Code::NotFound,
    );
    refused(workers.fetch_pack(pack_of(&nothing)).await, Code::NotFound);
    let put = |chunks: &[&Vec<u8>], digest: &Vec<u8>| v1::PutSceneRequest {
        chunks: chunks.iter().map(|c| c.to_vec()).collect(),
        digest: digest.clone(),
    };
    refused(
        jobs.put_scene(put(&[&nothing], &nothing)).await,
        Code::FailedPrecondition,
    );
    refused(
        jobs.put_scene(put(&[&digest], &nothing)).await,
        Code::InvalidArgument,
    );
    refused(
        jobs.put_scene(put(&[&digest], &digest)).await,
        Code::InvalidArgument,
    );

    // Jobs that do not exist.
    let unknown = || v1::ShowRequest { job: 4711 };
    refused(jobs.show(unknown()).await, Code::NotFound);
    refused(jobs.watch(unknown()).await, Code::NotFound);
    refused(jobs.cancel(unknown()).await, Code::NotFound);
    refused(
        jobs.pause(v1::PauseRequest {
            job: 4711,
            now: true,
        })
        .await,
        Code::NotFound,
    );
    refused(jobs.delete(unknown()).await, Code::NotFound);
    refused(jobs.fetch_partial(unknown()).await, Code::NotFound);
    refused(jobs.resume(unknown()).await, Code::NotFound);
    refused(jobs.retry(unknown()).await, Code::NotFound);
    assert!(refused(jobs.fetch(unknown()).await, Code::NotFound).contains("4711"));

    // Invalid jobs.
    let good = coordinator.submit(&format!("{JOB} --request-id good"));
    let spec = jobs
        .show(v1::ShowRequest { job: good })
        .await
        .unwrap()
        .into_inner()
        .spec
        .unwrap();
    refused(
        jobs.fetch(v1::ShowRequest { job: good }).await,
        Code::FailedPrecondition,
    );
    let submit = |request_id: &str, change: &dyn Fn(&mut v1::JobSpec)| {
        let (mut jobs, mut spec) = (jobs.clone(), spec.clone());
        change(&mut spec);
        let request = v1::SubmitRequest {
            request_id: request_id.to_owned(),
            name: "x".to_owned(),
            spec: Some(spec),
            ..Default::default()
        };
        async move { jobs.submit(request).await }
    };
    let answer = submit("good", &|_| {}).await.unwrap().into_inner();
    assert!(answer.existing && answer.job.unwrap().id == good);
    // A submission without a request id is identified by its job.
    assert!(submit("", &|_| {}).await.unwrap().into_inner().existing);
    refused(
        submit(&"long".repeat(100), &|_| {}).await,
        Code::InvalidArgument,
    );
    refused(
        submit("good", &|s| spec::task(s).seed = Some(1)).await,
        Code::InvalidArgument,
    );
    refused(
        submit("a", &|s| s.scene = vec![9; 32]).await,
        Code::NotFound,
    );
    refused(
        submit("b", &|s| s.scene = vec![9; 5]).await,
        Code::InvalidArgument,
    );
    refused(
        submit("d", &|s| spec::cube_grid(s).view_box.truncate(5)).await,
        Code::InvalidArgument,
    );
    refused(
        submit("e", &|s| spec::cube_grid(s).view_box[3] = f32::NAN).await,
        Code::InvalidArgument,
    );
    refused(
        submit("g", &|s| spec::cubes(s).resolution = Some(1)).await,
        Code::InvalidArgument,
    );
    for n in [0, 1 << 20, u32::MAX] {
        refused(
            submit("h", &|s| spec::cube_grid(s).x = Some(n)).await,
            Code::InvalidArgument,
        );
    }
    let no_spec = v1::SubmitRequest {
        request_id: "i".to_owned(),
        name: String::new(),
        spec: None,
        ..Default::default()
    };
    refused(jobs.clone().submit(no_spec).await, Code::InvalidArgument);
    // Exact queries need triangles that are visible from both sides.
    let culled = coordinator.submit(&format!("{JOB} --cull-back-faces --request-id culled"));
    let culled = jobs
        .clone()
        .show(v1::ShowRequest { job: culled })
        .await
        .unwrap()
        .into_inner()
        .spec
        .unwrap();
    assert_ne!(culled.scene, spec.scene);
    let exact = |s: &mut v1::JobSpec| {
        s.scene.clone_from(&culled.scene);
        let sampling = Some(spec::sampling(s).clone());
        spec::task(s).method = Some(v1::visibility::Method::Exact(v1::Exact {
            sampling,
            ..v1::Exact::default()
        }));
    };
    assert!(refused(submit("k", &exact).await, Code::InvalidArgument).contains("both sides"));
    // Without a view box, the job uses the scene's bounds, as on the command line.
    let answer = submit("j", &|s| spec::cube_grid(s).view_box.clear())
        .await
        .unwrap()
        .into_inner();
    assert!(answer.existing && answer.job.unwrap().id == good);

    // Results without a header, without a lease, and without a job.
    let part = |part| v1::ResultPart { part: Some(part) };
    let header = |lease| {
        v1::result_part::Part::Header(v1::ResultHeader {
            lease,
            digest: blake3::hash(b"x").as_bytes().to_vec(),
            bytes: 1,
            ..Default::default()
        })
    };
    let body = || part(v1::result_part::Part::Chunk(chunk(b"x")));
    let lease = |job| {
        Some(v1::Lease {
            job,
            tile: 0,
            epoch: 1,
            lease: 1,
            tag: 0,
        })
    };
    let mut put =
        async |parts: Vec<v1::ResultPart>| workers.put_result(tokio_stream::iter(parts)).await;
    refused(put(vec![]).await, Code::InvalidArgument);
    refused(put(vec![body()]).await, Code::InvalidArgument);
    refused(
        put(vec![part(header(None)), body()]).await,
        Code::InvalidArgument,
    );
    // The lease is checked first, regardless of the following parts.
    refused(
        put(vec![part(header(lease(good)))]).await,
        Code::FailedPrecondition,
    );
    refused(
        put(vec![part(header(lease(good))), body()]).await,
        Code::FailedPrecondition,
    );
    refused(
        put(vec![part(header(lease(4711))), body()]).await,
        Code::FailedPrecondition,
    );

    // Workers with an invalid introduction.
    let want = v1::worker_message::Message::Want(v1::Want { tiles: 1 });
    let hello = |name: &str, profiles: &[&str]| {
        v1::worker_message::Message::Hello(v1::Hello {
            name: name.to_owned(),
            profiles: profiles.iter().map(|p| (*p).to_owned()).collect(),
            algorithm: sightline_model::ALGORITHM_VERSION,
            protocol: sightline_proto::PROTOCOL,
            ..Default::default()
        })
    };
    for first in [
        want,
        hello("", &["cpu/x"]),
        hello("w", &[]),
        hello("w\n", &["cpu/x"]),
        hello("w", &["cpü"]),
    ] {
        let messages = tokio_stream::iter([v1::WorkerMessage {
            message: Some(first),
        }]);
        refused(workers.work(messages).await, Code::InvalidArgument);
    }
    // A worker of an earlier version.
    let hello = v1::worker_message::Message::Hello(v1::Hello {
        protocol: 0,
        ..liar(&["cpu/x".to_owned()])
    });
    let message = Some(hello);
    let messages = tokio_stream::iter([v1::WorkerMessage { message }]);
    let refusal = refused(workers.work(messages).await, Code::InvalidArgument);
    assert!(
        refusal.contains("version 1") && refusal.contains("version 2"),
        "{refusal}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_reflection_answer() {
    use tonic_health::pb::health_client::HealthClient;
    use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus};
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
    use tonic_reflection::pb::v1::{ServerReflectionRequest, ServerReflectionResponse};

    let sandbox = Sandbox::new();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let channel = connect(&coordinator).await;
    let mut health = HealthClient::new(channel.clone());
    for service in ["", "sightline.v1.Jobs", "sightline.v1.Workers"] {
        let asked = HealthCheckRequest {
            service: service.to_owned(),
        };
        assert_eq!(
            health.check(asked).await.unwrap().into_inner().status(),
            ServingStatus::Serving,
            "{service}"
        );
    }
    let asked = HealthCheckRequest {
        service: "sightline.v1.Nonsense".to_owned(),
    };
    assert_eq!(
        health.check(asked).await.unwrap_err().code(),
        Code::NotFound
    );

    let mut reflection = ServerReflectionClient::new(channel);
    let mut ask = async |request| -> ServerReflectionResponse {
        let request = ServerReflectionRequest {
            host: String::new(),
            message_request: Some(request),
        };
        let stream = reflection
            .server_reflection_info(tokio_stream::iter([request]))
            .await
            .unwrap();
        stream.into_inner().next().await.unwrap().unwrap()
    };
    let answer = ask(MessageRequest::ListServices(String::new())).await;
    let Some(MessageResponse::ListServicesResponse(list)) = answer.message_response else {
        panic!("{answer:?}")
    };
    let names: Vec<_> = list.service.iter().map(|s| s.name.as_str()).collect();
    for service in [
        "sightline.v1.Jobs",
        "sightline.v1.Workers",
        "grpc.health.v1.Health",
    ] {
        assert!(names.contains(&service), "{names:?}");
    }
    let answer = ask(MessageRequest::FileContainingSymbol(
        "sightline.v1.Jobs.Submit".to_owned(),
    ))
    .await;
    assert!(
        matches!(
            answer.message_response,
            Some(MessageResponse::FileDescriptorResponse(_))
        ),
        "{answer:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn second_result_of_tile_is_rejected() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    // Tiles take long enough that the test can pause the job after the first ones.
    let job = JOB.replace("--resolution 32", "--resolution 64");
    sandbox.ok(&format!("bake {job} -o alone.pvs --data-dir alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let honest = coordinator.worker();
    let profiles = sightline_tests::wait_for("a worker", || {
        let listed = coordinator.json("workers");
        let profiles = listed[0]["profiles"].as_array()?.iter();
        Some(
            profiles
                .map(|profile| profile.as_str().unwrap().to_owned())
                .collect::<Vec<_>>(),
        )
    });
    honest.kill();
    let job = coordinator.submit(&job);
    // The faulty worker receives the first tiles and returns them. Its leases stay granted.
    let mut olds = Vec::new();
    {
        let mut workers = WorkersClient::new(connect(&coordinator).await);
        let (say, said) = tokio::sync::mpsc::channel(16);
        let send = async |message| {
            say.send(v1::WorkerMessage {
                message: Some(message),
            })
            .await
            .unwrap()
        };
        send(v1::worker_message::Message::Hello(liar(&profiles))).await;
        let said = tokio_stream::wrappers::ReceiverStream::new(said);
        let mut heard = workers.work(said).await.unwrap().into_inner();
        send(v1::worker_message::Message::Want(v1::Want { tiles: 2 })).await;
        while olds.len() < 2 {
            let message = heard.next().await.unwrap().unwrap().message.unwrap();
            if let v1::coordinator_message::Message::Grant(grant) = message {
                olds.push(grant.lease.unwrap());
            }
        }
        send(v1::worker_message::Message::Draining(v1::Draining {})).await;
        drop(say);
        while heard.next().await.is_some() {}
    }
    let honest = coordinator.worker();
    coordinator.until(job, "some tiles done", |job| {
        job["tiles_done"].as_u64().unwrap() >= 10
    });
    coordinator.ok(&format!("pause {job}"));
    honest.kill();
    let shown = coordinator.json(&format!("show {job}"));
    assert_eq!(
        shown["state"], "paused",
        "the job was over before it could be disturbed: {shown}"
    );
    coordinator.ok(&format!("resume {job}"));

    // This worker claims the same profile and requests tiles until it receives one that depends on a tile of
    // the faulty worker, which the honest worker finished.
    use v1::coordinator_message::Message as Heard;
    use v1::worker_message::Message as Said;
    let mut workers = WorkersClient::new(connect(&coordinator).await);
    let (say, said) = tokio::sync::mpsc::channel(16);
    let send = async |message| {
        say.send(v1::WorkerMessage {
            message: Some(message),
        })
        .await
        .unwrap()
    };
    send(Said::Hello(liar(&profiles))).await;
    let said = tokio_stream::wrappers::ReceiverStream::new(said);
    let mut heard = workers.work(said).await.unwrap().into_inner();
    let facts = sightline_model::SceneFacts::default();
    let mut leases = 0;
    let (grant, plan, at, finished) = loop {
        match heard.next().await.unwrap().unwrap().message.unwrap() {
            Heard::Welcome(_) => send(Said::Want(v1::Want { tiles: 1 })).await,
            Heard::Grant(grant) => {
                leases += 1;
                if !grant.packs.is_empty() {
                    let spec = grant.spec.as_ref().unwrap();
                    let planned = sightline_model::JobSpec::from_message(spec, &facts).unwrap();
                    let planned = sightline_model::PlannedJob::stored(planned);
                    let plan = planned.plan().clone();
                    let needs = &plan.tiles[grant.lease.unwrap().tile as usize].needs;
                    let known = |tile: &u32| olds.iter().find(|old| old.tile == *tile).copied();
                    let found = needs.iter().map(known).enumerate();
                    if let Some((at, old)) = found.filter_map(|(at, old)| Some((at, old?))).next() {
                        break (grant, plan, at, old);
                    }
                }
                send(Said::Want(v1::Want { tiles: 1 })).await;
            }
            other => panic!("{other:?}"),
        }
    };
    let lease = grant.lease.unwrap();
    let mut stream = workers
        .fetch_pack(pack_of(&grant.packs[at]))
        .await
        .unwrap()
        .into_inner();
    let mut genuine = Vec::new();
    while let Some(chunk) = stream.next().await {
        genuine.extend(chunk.unwrap().data);
    }
    assert_eq!(
        blake3::hash(&genuine).as_bytes().as_slice(),
        grant.packs[at]
    );

    let mut put = async |lease, bytes: &[u8], announced: &[u8]| {
        let header = v1::ResultHeader {
            lease: Some(lease),
            digest: blake3::hash(announced).as_bytes().to_vec(),
            bytes: bytes.len() as u64,
            ..Default::default()
        };
        let parts: Vec<_> = std::iter::once(v1::result_part::Part::Header(header))
            .chain(cut(bytes).map(v1::result_part::Part::Chunk))
            .map(|part| v1::ResultPart { part: Some(part) })
            .collect();
        workers.put_result(tokio_stream::iter(parts)).await
    };
    // A well-formed pack without samples: a zstd frame of one raw block.
    let empty = b"\x28\xb5\x2f\xfd\x20\x02\x11\x00\x00P\x00";
    refused(put(finished, empty, empty).await, Code::Aborted);
    // The same result, sent again, is accepted.
    put(finished, &genuine, &genuine).await.unwrap();
    for lease in [finished, lease] {
        refused(
            put(lease, b"garbage", b"garbage").await,
            Code::InvalidArgument,
        );
        refused(put(lease, b"", b"").await, Code::InvalidArgument);
        refused(
            put(lease, &genuine[..genuine.len() - 5], &genuine).await,
            Code::DataLoss,
        );
    }
    // The lease of one tile is not valid for another tile, and a client cannot forge a lease.
    for forged in [
        v1::Lease {
            tile: finished.tile,
            ..lease
        },
        v1::Lease {
            tile: u32::MAX,
            ..lease
        },
        v1::Lease {
            epoch: 0,
            lease: 0,
            ..lease
        },
        v1::Lease { tag: 0, ..lease },
    ] {
        let status = put(forged, empty, empty).await.unwrap_err();
        assert_eq!(status.code(), Code::FailedPrecondition, "{status}");
        assert!(
            status
                .message()
                .contains(&format!("lease {} of epoch", forged.lease)),
            "{status}"
        );
    }
    if plan.tiles[lease.tile as usize].kind == sightline_viewcells::TileKind::Leaf {
        // A pack of samples in place of cells.
        refused(put(lease, empty, empty).await, Code::InvalidArgument);
    }
    // A thread of the test reads the output of the coordinator.
    sightline_tests::wait_for("the message about two results", || {
        let log = coordinator.process.err();
        log.contains("TWO RESULTS").then_some(())
    });

    // The worker does not return, so its tiles are free immediately, and an honest worker finishes the job.
    // The tile of the killed worker may be its own for a while.
    let running = |tiles: u64| {
        coordinator.until(job, "the other leases to end", |job| {
            job["tiles_running"].as_u64() == Some(tiles)
        })
    };
    running(leases);
    send(Said::Draining(v1::Draining {})).await;
    drop(say);
    while heard.next().await.is_some() {}
    running(0);
    let _honest = coordinator.worker();
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after a conflict",
    );
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
}

/// Makes the same tile fail on three workers, one after the other. Returns the number of the tile.
async fn fail_everywhere(channel: &Channel, profile: &str) -> u32 {
    use v1::coordinator_message::Message as Heard;
    use v1::worker_message::Message as Said;
    let mut tiles = Vec::new();
    for name in ["one", "two", "three"] {
        let (say, said) = tokio::sync::mpsc::channel(16);
        let send = async |message| {
            say.send(v1::WorkerMessage {
                message: Some(message),
            })
            .await
            .unwrap()
        };
        send(Said::Hello(v1::Hello {
            name: name.to_owned(),
            profiles: vec![profile.to_owned()],
            algorithm: sightline_model::ALGORITHM_VERSION,
            protocol: sightline_proto::PROTOCOL,
            ..Default::default()
        }))
        .await;
        let said = tokio_stream::wrappers::ReceiverStream::new(said);
        let mut heard = WorkersClient::new(channel.clone())
            .work(said)
            .await
            .unwrap()
            .into_inner();
        loop {
            match heard.next().await.unwrap().unwrap().message.unwrap() {
                Heard::Welcome(_) => send(Said::Want(v1::Want { tiles: 1 })).await,
                Heard::Grant(grant) => {
                    let lease = grant.lease.unwrap();
                    tiles.push(lease.tile);
                    let reason = "the test says so".to_owned();
                    let failed = v1::TileFailed {
                        lease: Some(lease),
                        reason,
                        infrastructure: false,
                    };
                    send(Said::Failed(failed)).await;
                    break;
                }
                other => panic!("{other:?}"),
            }
        }
        send(Said::Draining(v1::Draining {})).await;
        drop(say);
        // The coordinator ends the stream after it has read all messages.
        while heard.next().await.is_some() {}
    }
    assert!(tiles.iter().all(|t| *t == tiles[0]), "{tiles:?}");
    tiles[0]
}

#[tokio::test(flavor = "multi_thread")]
async fn tile_that_fails_everywhere_is_set_aside_and_can_be_retried() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let alone = sandbox.json(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let channel = connect(&coordinator).await;
    // A real worker computes the first dozen tiles: the faces, the uppermost separators and more.
    let worker = coordinator.worker();
    coordinator.until(job, "a dozen tiles", |j| {
        j["tiles_done"].as_u64() >= Some(12)
    });
    worker.signal("TERM");
    worker.end().code(0);
    let tile = fail_everywhere(&channel, alone["info"]["profile"].as_str().unwrap()).await;
    assert!(tile > 6, "neither a face nor the root: {tile}");
    let aside = coordinator.json(&format!("show {job}"))["tiles_set_aside"]
        .as_u64()
        .unwrap();
    assert!(aside > 0);
    let _worker = coordinator.worker();
    let lacking = coordinator.finish(job);
    sandbox.write("lacking.pvs", &lacking);
    let info = sandbox.json("info lacking.pvs");
    // A result counts only tiles with cells; the job also counts tiles with samples.
    assert!(
        (1..=aside).contains(&info["info"]["tiles_set_aside"].as_u64().unwrap()),
        "{info}"
    );
    let dump = sandbox.dump("lacking.pvs");
    let all: Vec<u64> = (0..dump.header["triangles"].as_u64().unwrap()).collect();
    let everything = dump
        .cells
        .iter()
        .filter(|cell| cell.visible == all && cell.undecided == all)
        .count();
    assert!(
        everything > 0,
        "cells that failed show everything, undecided"
    );
    assert_eq!(info["cells_set_aside"], everything);

    // A retry gives the full result.
    assert_ne!(coordinator.json(&format!("retry {job}"))["state"], "done");
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after another try",
    );
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn job_without_tiles_fails_and_can_be_retried() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let alone = sandbox.json(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let channel = connect(&coordinator).await;
    // Without the first face, neither the root nor any node below it can be split.
    assert_eq!(
        fail_everywhere(&channel, alone["info"]["profile"].as_str().unwrap()).await,
        0
    );
    let _worker = coordinator.worker();
    coordinator.until(job, "the end", |j| j["state"] == "failed");
    assert_ne!(coordinator.json(&format!("retry {job}"))["state"], "failed");
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "after another try",
    );
}
