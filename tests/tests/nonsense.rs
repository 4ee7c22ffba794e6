//! Tests of nonsense on every call of the gRPC interface: altered messages, random bytes, and data that is
//! not HTTP. The coordinator has to stay intact.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::io::Write as _;
use std::time::Duration;

use bytes::{Buf as _, BufMut as _};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::strategy::ValueTree as _;
use proptest::test_runner::TestRunner;
use prost::Message as _;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_tests::{Sandbox, assert_same};
use tokio_stream::StreamExt as _;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::Channel;
use tonic::{Request, Status};

const SCENE: &str = "generate maze --grid 3x3 -o maze.glb";
const JOB: &str = "maze.glb --sampler cubes --cells 4x4x2 --resolution 32 --backend cpu";

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

/// A codec that passes bytes through in place of messages.
#[derive(Clone, Default)]
struct Raw;

impl Codec for Raw {
    type Encode = Vec<u8>;
    type Decode = Vec<u8>;
    type Encoder = Self;
    type Decoder = Self;
    fn encoder(&mut self) -> Self {
        Self
    }
    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;
    fn encode(&mut self, item: Vec<u8>, out: &mut EncodeBuf<'_>) -> Result<(), Status> {
        out.put_slice(&item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;
    fn decode(&mut self, from: &mut DecodeBuf<'_>) -> Result<Option<Vec<u8>>, Status> {
        Ok(Some(from.copy_to_bytes(from.remaining()).to_vec()))
    }
}

/// The part of a file descriptor that contains the names of calls.
#[derive(Clone, PartialEq, prost::Message)]
struct Descriptors {
    #[prost(message, repeated, tag = "1")]
    files: Vec<File>,
}
#[derive(Clone, PartialEq, prost::Message)]
struct File {
    #[prost(string, tag = "2")]
    package: String,
    #[prost(message, repeated, tag = "6")]
    services: Vec<Service>,
}
#[derive(Clone, PartialEq, prost::Message)]
struct Service {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, repeated, tag = "2")]
    calls: Vec<Call>,
}
#[derive(Clone, PartialEq, prost::Message)]
struct Call {
    #[prost(string, tag = "1")]
    name: String,
}

/// Returns the paths of all calls.
fn calls() -> Vec<String> {
    let mut calls = Vec::new();
    for file in Descriptors::decode(sightline_proto::DESCRIPTORS)
        .unwrap()
        .files
    {
        for service in file.services {
            calls.extend(
                service
                    .calls
                    .iter()
                    .map(|c| format!("/{}.{}/{}", file.package, service.name, c.name)),
            );
        }
    }
    assert!(
        calls.len() >= 16 && calls.contains(&"/sightline.v1.Workers/PutResult".to_owned()),
        "{calls:?}"
    );
    calls
}

/// Returns well-formed messages, each with its call. The test alters these messages.
fn straight(job: u64, spec: &v1::JobSpec) -> Vec<(&'static str, Vec<u8>)> {
    use v1::worker_message::Message;
    let digest = spec.scene.clone();
    let held = v1::Lease {
        job,
        tile: 3,
        epoch: 1,
        lease: 1,
        tag: 7,
    };
    let lease = Some(held);
    let worker = |message| {
        (
            "Workers/Work",
            v1::WorkerMessage {
                message: Some(message),
            }
            .encode_to_vec(),
        )
    };
    let header = v1::ResultHeader {
        lease,
        digest: digest.clone(),
        bytes: 9,
        ..Default::default()
    };
    let scene = v1::FetchSceneRequest {
        digest: digest.clone(),
        direct: true,
        fell_back: true,
    };
    let pack = v1::FetchPackRequest {
        digest: digest.clone(),
        direct: true,
        fell_back: false,
    };
    let stage = v1::StageResultRequest {
        lease,
        sha256: digest.clone(),
        bytes: 9,
    };
    let result = |part| {
        (
            "Workers/PutResult",
            v1::ResultPart { part: Some(part) }.encode_to_vec(),
        )
    };
    let hello = v1::Hello {
        name: "fuzz".to_owned(),
        profiles: vec!["cpu/none".to_owned()],
        held: vec![held; 3],
        version: "0".to_owned(),
        algorithm: sightline_model::ALGORITHM_VERSION,
        protocol: sightline_proto::PROTOCOL,
        instance: 1,
        helps: true,
        identity: vec![7; 24],
    };
    let submit = v1::SubmitRequest {
        request_id: "fuzz".to_owned(),
        name: "fuzz".to_owned(),
        spec: Some(spec.clone()),
        priority: 1,
        user: "fuzz".to_owned(),
    };
    let show = v1::ShowRequest { job }.encode_to_vec();
    let timed = v1::Timed {
        job,
        times: vec![v1::ProfileTime {
            profile: "cpu/none".to_owned(),
            seconds_per_cube: 0.5,
        }],
    };
    let failed = v1::TileFailed {
        lease,
        reason: "fuzz".to_owned(),
        infrastructure: false,
    };
    vec![
        (
            "Jobs/MissingChunks",
            v1::MissingChunksRequest {
                digests: vec![digest.clone(); 3],
            }
            .encode_to_vec(),
        ),
        ("Jobs/PutChunks", chunk(b"fuzz").encode_to_vec()),
        (
            "Jobs/PutScene",
            v1::PutSceneRequest {
                chunks: vec![digest.clone()],
                digest: digest.clone(),
            }
            .encode_to_vec(),
        ),
        (
            "Jobs/PutReceivers",
            v1::PutReceiversRequest {
                chunks: vec![digest.clone()],
                digest: digest.clone(),
            }
            .encode_to_vec(),
        ),
        ("Jobs/Submit", submit.encode_to_vec()),
        (
            "Jobs/Submit",
            v1::SubmitRequest {
                request_id: "other".to_owned(),
                ..submit.clone()
            }
            .encode_to_vec(),
        ),
        (
            "Jobs/List",
            v1::ListRequest {
                limit: 3,
                before: 9,
                states: vec![1, 2],
                name: "fuzz".to_owned(),
                user: "fuzz".to_owned(),
                scene: digest.clone(),
            }
            .encode_to_vec(),
        ),
        (
            "Farm/Invalidate",
            v1::InvalidateRequest {
                job: Some(job),
                tiles: vec![0],
                worker: "fuzz".to_owned(),
                from_ms: Some(1),
                to_ms: Some(2),
            }
            .encode_to_vec(),
        ),
        (
            "Farm/ReleaseWorker",
            v1::ReleaseWorkerRequest {
                worker: "fuzz".to_owned(),
            }
            .encode_to_vec(),
        ),
        (
            "Farm/ListTiles",
            v1::ListTilesRequest {
                job,
                first: 0,
                limit: 5,
                states: vec![1],
            }
            .encode_to_vec(),
        ),
        ("Jobs/Estimate", submit.encode_to_vec()),
        (
            "Jobs/Prioritize",
            v1::PrioritizeRequest { job, priority: 3 }.encode_to_vec(),
        ),
        ("Jobs/Show", show.clone()),
        ("Jobs/Watch", show.clone()),
        ("Jobs/Cancel", show.clone()),
        ("Jobs/Pause", show.clone()),
        ("Jobs/Resume", show.clone()),
        ("Jobs/Retry", show.clone()),
        ("Jobs/Fetch", show),
        worker(Message::Hello(hello)),
        worker(Message::Want(v1::Want { tiles: 2 })),
        worker(Message::Progress(v1::Progress {
            lease,
            cells: 1,
            samples: 1,
        })),
        worker(Message::Failed(failed)),
        worker(Message::Timed(timed)),
        worker(Message::Draining(v1::Draining {})),
        ("Workers/FetchScene", scene.encode_to_vec()),
        ("Workers/FetchPack", pack.encode_to_vec()),
        ("Workers/StageResult", stage.encode_to_vec()),
        result(v1::result_part::Part::Header(header)),
        result(v1::result_part::Part::Chunk(chunk(b"123456789"))),
    ]
}

/// An alteration of a message.
#[derive(Clone, Debug)]
enum Bend {
    Flip(Index, u8),
    Insert(Index, Vec<u8>),
    Remove(Index, usize),
    Cut(Index),
}

impl Bend {
    fn strategy() -> impl Strategy<Value = Self> {
        // Most alterations are small, or are the largest numbers on the wire.
        let large = prop_oneof![
            Just(vec![0xff, 0xff, 0xff, 0xff, 0x0f]),
            proptest::collection::vec(any::<u8>(), 1..9)
        ];
        prop_oneof![
            4 => (any::<Index>(), 1..=255u8).prop_map(|(at, bits)| Self::Flip(at, bits)),
            2 => (any::<Index>(), large).prop_map(|(at, bytes)| Self::Insert(at, bytes)),
            1 => (any::<Index>(), 1..9usize).prop_map(|(at, n)| Self::Remove(at, n)),
            1 => any::<Index>().prop_map(Self::Cut),
        ]
    }

    fn apply(&self, bytes: &mut Vec<u8>) {
        let at = |index: &Index| index.index(bytes.len() + 1);
        match self {
            Self::Flip(index, bits) => {
                let at = at(index);
                bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= bits);
            }
            Self::Insert(index, more) => {
                let at = at(index);
                bytes.splice(at..at, more.iter().copied());
            }
            Self::Remove(index, n) => {
                let at = at(index);
                bytes.drain(at..(at + n).min(bytes.len()));
            }
            Self::Cut(index) => bytes.truncate(at(index)),
        }
    }
}

/// Calls a method with these frames, and reads the answer for up to 200 ms.
async fn call(channel: &Channel, path: &str, frames: Vec<Vec<u8>>) {
    let mut grpc = tonic::client::Grpc::new(channel.clone());
    grpc.ready().await.unwrap();
    let path = PathAndQuery::try_from(path).unwrap();
    let conversation = async {
        let frames = Request::new(tokio_stream::iter(frames));
        if let Ok(answer) = grpc.streaming(frames, path, Raw).await {
            let mut answer = answer.into_inner();
            while let Some(Ok(_)) = answer.next().await {}
        }
    };
    // The answer to a watch of an open job has no end.
    let _ = tokio::time::timeout(Duration::from_millis(200), conversation).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nonsense_on_any_call_does_not_affect_coordinator() {
    const BENT: usize = 1500;
    const RANDOM_PER_CALL: usize = 12;
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir alone"));
    let mut coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    coordinator.ok(&format!("pause {job}"));
    let channel = Channel::from_shared(coordinator.url.clone())
        .unwrap()
        .connect()
        .await
        .unwrap();
    let mut jobs = JobsClient::new(channel.clone());
    let spec = jobs
        .show(v1::ShowRequest { job })
        .await
        .unwrap()
        .into_inner()
        .spec
        .unwrap();

    // Use the same cases in every run, so that a failure can be reproduced.
    let mut runner = TestRunner::deterministic();
    let (calls, straight) = (calls(), straight(job, &spec));
    for path in &calls {
        let frames = proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..80), 0..3);
        for _ in 0..RANDOM_PER_CALL {
            call(
                &channel,
                path,
                frames.new_tree(&mut runner).unwrap().current(),
            )
            .await;
        }
    }
    let case = (
        any::<Index>(),
        proptest::option::weighted(0.2, any::<Index>()),
        proptest::collection::vec(
            (
                any::<Index>(),
                proptest::collection::vec(Bend::strategy(), 0..4),
            ),
            0..3,
        ),
        proptest::collection::vec(Bend::strategy(), 0..4),
    );
    for _ in 0..BENT {
        let (first, elsewhere, more, bends) = case.new_tree(&mut runner).unwrap().current();
        let (name, message) = first.get(&straight);
        let mut frames = vec![bent(message, &bends)];
        // Later messages of a stream belong to the same call.
        let same: Vec<_> = straight.iter().filter(|(other, _)| other == name).collect();
        frames.extend(
            more.iter()
                .map(|(which, bends)| bent(&which.get(&same).1, bends)),
        );
        let path = match elsewhere {
            Some(other) => other.get(&calls).clone(),
            None => format!("/sightline.v1.{name}"),
        };
        call(&channel, &path, frames).await;
    }
    // Bytes that are not gRPC.
    for bytes in [
        &b"GET / HTTP/1.1\r\n\r\n"[..],
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\xff\xff\xff\xff\xff\xff",
        &[0xa5; 5000],
    ] {
        let mut stream = std::net::TcpStream::connect(coordinator.address()).unwrap();
        // The coordinator may close the connection in the meantime.
        let _ = stream.write_all(bytes);
    }

    assert!(coordinator.process.runs(), "the coordinator died");
    let log = coordinator.process.err();
    assert!(!log.contains("panicked"), "{log}");
    assert_eq!(coordinator.ok("health").trim(), "serving");
    // Cancel the jobs that the calls created, so that a worker is free for a real one.
    for job in coordinator.json("jobs").as_array().unwrap() {
        if !["done", "failed", "cancelled"].contains(&job["state"].as_str().unwrap()) {
            coordinator.ok(&format!("cancel {}", job["job"]));
        }
    }
    let real = coordinator.submit(JOB);
    let _worker = coordinator.worker();
    assert_same(
        &coordinator.finish(real),
        &sandbox.read("alone.pvs"),
        "after the nonsense",
    );
}

fn bent(message: &[u8], bends: &[Bend]) -> Vec<u8> {
    let mut bytes = message.to_vec();
    bends.iter().for_each(|bend| bend.apply(&mut bytes));
    bytes
}
