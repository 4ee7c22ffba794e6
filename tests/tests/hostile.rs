//! Tests of silent clients and endless uploads, against a coordinator with few descriptors.
//!
//! `SIGHTLINE_HOSTILE=full` opens 1200 connections to each port and sends 400 MB with each upload, as
//! `scripts/nightly.sh` does, and prints the measurements.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use sightline_proto::chunks::{CHUNK_BYTES, chunk};
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_tests::{Coordinator, Sandbox, ask, assert_same};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;
use tonic::transport::Channel;

const JOB: &str = "rooms.glb --cells 8x8x8 --block-cells 8 --target-error 0.001 --backend cpu";

fn is_full() -> bool {
    std::env::var_os("SIGHTLINE_HOSTILE").is_some_and(|size| size == "full")
}

/// Opens connections that send the first bytes of a request and no more.
fn idle(address: &str, count: usize) -> Vec<TcpStream> {
    let beginnings = [
        &b""[..],
        b"GET / HTTP/1.1\r\nHost: x\r\n",
        b"PRI * HTTP/2.0\r\n",
    ];
    let open = |beginning: &&[u8]| {
        let mut stream = TcpStream::connect(address).unwrap();
        // A connection that was closed in favor of another one accepts no bytes.
        drop(stream.write_all(beginning));
        stream
    };
    beginnings.iter().cycle().take(count).map(open).collect()
}

/// Returns the value of a metric.
fn metric(coordinator: &Coordinator<'_>, name: &str) -> f64 {
    let address = coordinator
        .metrics
        .trim_start_matches("http://")
        .trim_end_matches("/metrics");
    let text = String::from_utf8(ask(address, "GET /metrics", "", "").1).unwrap();
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("no metric {name} in {text}"))
        .parse()
        .unwrap()
}

#[test]
fn idle_connections_do_not_stop_callers_or_workers() {
    let mut sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox.ok(&format!("bake {JOB} -o alone.pvs"));
    let count = if is_full() { 1200 } else { 120 };
    if !is_full() {
        // The connections together exceed the coordinator's limit.
        sandbox.limit_descriptors(192);
    }
    let arguments = "--listen 127.0.0.1:0 --http 127.0.0.1:0 --metrics-listen 127.0.0.1:0";
    let coordinator = sandbox.serve("data", arguments);
    let _worker = coordinator.worker();
    let job = coordinator.submit(JOB);
    coordinator.until(job, "a tile at work", |job| job["tiles_running"] != 0);
    let host = |url: &str| {
        url.trim_start_matches("http://")
            .split('/')
            .next()
            .unwrap()
            .to_owned()
    };
    let ports = [&coordinator.url, &coordinator.pages, &coordinator.metrics].map(|url| host(url));
    let began = Instant::now();
    let mut streams: Vec<TcpStream> = ports.iter().flat_map(|port| idle(port, count)).collect();
    let opened = Instant::now();
    assert!(coordinator.ok("jobs").contains("rooms.glb"));
    let answered = opened.elapsed();
    assert_eq!(ask(&ports[1], "GET /", "", "").0, 200);
    let result = coordinator.finish(job);
    assert_same(
        &result,
        &sandbox.read("alone.pvs"),
        "beside idle connections",
    );
    assert_eq!(
        metric(&coordinator, "sightline_leases_taken_back_total"),
        0.0
    );
    if is_full() {
        for stream in &mut streams {
            stream
                .set_read_timeout(Some(Duration::from_secs(60)))
                .unwrap();
            // The read returns the end of the stream, or a reset.
            let _ = stream.read_to_end(&mut Vec::new());
        }
        let closed = opened.elapsed();
        eprintln!(
            "{} idle connections, opened in {:?}: jobs answered in {answered:?}, all closed after {closed:?}",
            streams.len(),
            opened - began
        );
        assert!(answered < Duration::from_secs(1) && closed < Duration::from_secs(45));
    }
}

/// Returns the resident memory of a process in bytes.
fn resident(process: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() * 1024
}

/// Returns all chunks of an upload except the last one.
fn unfinished(megabytes: u64) -> impl Iterator<Item = v1::Chunk> {
    let total = megabytes * CHUNK_BYTES as u64;
    (0..megabytes - 1)
        .map(move |i| chunk(vec![i as u8; CHUNK_BYTES], i * CHUNK_BYTES as u64, total))
}

/// Sends a scene file without its last chunk. Returns the sender that keeps the call open.
async fn half_a_file(channel: Channel, megabytes: u64) -> mpsc::Sender<v1::SceneFilePart> {
    use v1::scene_file_part::Part;
    let (send, parts) = mpsc::channel(1);
    tokio::spawn(async move {
        JobsClient::new(channel)
            .put_scene_file(ReceiverStream::new(parts))
            .await
    });
    let header = Part::Header(v1::SceneFileHeader {
        name: "a.obj".to_owned(),
        rules: Vec::new(),
    });
    let parts = std::iter::once(header).chain(unfinished(megabytes).map(Part::Chunk));
    for part in parts {
        send.send(v1::SceneFilePart { part: Some(part) })
            .await
            .unwrap();
    }
    // At this point the server has read all parts except the last one, which the channel may hold.
    send.reserve().await.unwrap();
    send
}

/// Posts a file without its last megabyte. Returns the connection.
fn half_a_post(pages: &str, megabytes: u64) -> TcpStream {
    let host = pages.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).unwrap();
    let length = megabytes * CHUNK_BYTES as u64;
    write!(
        stream,
        "POST /scenes?name=a.obj HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/octet-stream\r\n\
         Content-Length: {length}\r\n\r\n"
    )
    .unwrap();
    for _ in 1..megabytes {
        stream.write_all(&[7; CHUNK_BYTES]).unwrap();
    }
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn endless_uploads_need_little_memory() {
    let megabytes = if is_full() { 400 } else { 40 };
    let sandbox = Sandbox::new();
    let coordinator = sandbox.coordinator_with_pages("data");
    let process = coordinator.process.id();
    let before = resident(process);
    let channel = Channel::from_shared(coordinator.url.clone())
        .unwrap()
        .connect()
        .await
        .unwrap();

    // Incomplete files, over gRPC and HTTP.
    let files = (0..4).map(|_| tokio::spawn(half_a_file(channel.clone(), megabytes)));
    let files: Vec<_> = files.collect();
    let posts = (0..2).map(|_| {
        let pages = coordinator.pages.clone();
        tokio::task::spawn_blocking(move || half_a_post(&pages, megabytes))
    });
    let posts: Vec<_> = posts.collect();
    // An output with a forged lease is rejected before its bytes are sent.
    let lease = Some(v1::Lease {
        job: 1,
        tile: 0,
        epoch: 1,
        lease: 7,
        tag: 0,
    });
    let bytes = megabytes * CHUNK_BYTES as u64;
    let header = v1::ResultHeader {
        lease,
        digest: vec![7; 32],
        bytes,
        ..Default::default()
    };
    let (send, parts) = mpsc::channel(1);
    send.send(v1::ResultPart {
        part: Some(v1::result_part::Part::Header(header)),
    })
    .await
    .unwrap();
    let refused = WorkersClient::new(channel.clone())
        .put_result(ReceiverStream::new(parts))
        .await;
    assert_eq!(refused.unwrap_err().code(), Code::FailedPrecondition);
    // A list that repeats a chunk is not a scene.
    let mut jobs = JobsClient::new(channel.clone());
    let piece = chunk(vec![7; CHUNK_BYTES], 0, CHUNK_BYTES as u64);
    let digest = blake3::hash(&piece.data).as_bytes().to_vec();
    jobs.put_chunks(tokio_stream::once(piece)).await.unwrap();
    let list = v1::PutSceneRequest {
        chunks: vec![digest; 1500],
        digest: vec![9; 32],
    };
    let refused = jobs.put_scene(list).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
    assert!(
        refused
            .message()
            .contains("the maximum is 16 times their size"),
        "{refused}"
    );

    let mut held = Vec::new();
    for file in files {
        held.push(file.await.unwrap());
    }
    let mut open = Vec::new();
    for post in posts {
        open.push(post.await.unwrap());
    }
    let now = resident(process);
    eprintln!(
        "resident: {} MB before, {} MB with 6 uploads of {megabytes} MB",
        before >> 20,
        now >> 20
    );
    if is_full() {
        assert!(now < 600 << 20, "{now} bytes");
    }
    // The memory grew by less than half of the sent bytes.
    let sent = (6 * megabytes) << 20;
    assert!(
        now.saturating_sub(before) < sent / 2,
        "{before} bytes, then {now}"
    );
    // The uploads end with their callers, and the coordinator continues.
    drop((held, open));
    assert_eq!(
        tokio::task::block_in_place(|| coordinator.ok("health")).trim(),
        "serving"
    );
}
