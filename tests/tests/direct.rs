//! Tests of workers that read and write a bucket directly, at addresses that the coordinator signs. The bytes
//! are the same. If an address does not work, the worker uses the coordinator.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread;

use sightline_test_s3::{KEY, S3Server, SECRET};
use sightline_tests::{Background, Coordinator, Sandbox, ask, assert_same, wait_for};

/// A scene of seven megabytes, and a job with two tiles whose outputs have half a megabyte each.
const LARGE: [&str; 2] = [
    "generate town --triangles 200000 -o town.glb",
    "town.glb --cells 8x8x2 --block-cells 64 --sampler guided --contributions --cell-to-cell off \
     --backend cpu",
];
/// A scene of two megabytes, and a job that takes a second.
const SMALL: [&str; 2] = [
    "generate town --triangles 60000 -o town.glb",
    "town.glb --cells 4x4x2 --block-cells 16 --target-error 0.2 --cell-to-cell off --backend cpu",
];

/// Returns a folder with a scene and the result of a job in one process, and a running object store.
fn sandbox([scene, job]: [&str; 2]) -> (Sandbox, S3Server) {
    let mut sandbox = Sandbox::new();
    sandbox.set("AWS_ACCESS_KEY_ID", KEY);
    sandbox.set("AWS_SECRET_ACCESS_KEY", SECRET);
    sandbox.ok(scene);
    sandbox.ok(&format!("bake {job} -o alone.pvs --data-dir alone"));
    // Log at every level, so that the test can search all logs for secrets.
    sandbox.set("SIGHTLINE_LOG", "trace");
    let server = S3Server::start(&sandbox.path("s3"), "farm");
    (sandbox, server)
}

/// Starts a coordinator on the bucket. `more` contains further options of the bucket's address.
fn coordinator<'a>(
    sandbox: &'a Sandbox,
    server: &S3Server,
    data: &str,
    more: &str,
) -> Coordinator<'a> {
    let blobs = format!("s3://farm/{data}?endpoint={}{more}", server.endpoint());
    sandbox.serve(
        data,
        &format!("--listen 127.0.0.1:0 --metrics-listen 127.0.0.1:0 --blobs {blobs}"),
    )
}

fn worker(coordinator: &Coordinator<'_>, more: &str) -> Background {
    coordinator.start(&format!(
        "worker --backend cpu --threads 1 --metrics-listen 127.0.0.1:0{more}"
    ))
}

/// Returns the sum of the samples whose lines start with `begin`.
fn sum(text: &str, begin: &str) -> u64 {
    let lines = text.lines().filter(|line| line.starts_with(begin));
    lines
        .map(|line| line.rsplit(' ').next().unwrap().parse::<f64>().unwrap() as u64)
        .sum()
}

fn text_at(url: &str) -> String {
    let (host, path) = url.trim_start_matches("http://").split_once('/').unwrap();
    let (status, body) = ask(&format!("http://{host}"), &format!("GET /{path}"), "", "");
    assert_eq!(status, 200, "{url}");
    String::from_utf8(body).unwrap()
}

/// Returns a metric of a coordinator.
fn coordinator_metric(coordinator: &Coordinator<'_>, begin: &str) -> u64 {
    sum(&text_at(&coordinator.metrics), begin)
}

/// Returns the sum of a metric of workers.
fn worker_metric(workers: &[Background], begin: &str) -> u64 {
    let metric_of = |worker: &Background| {
        let out = worker.out();
        let url = out
            .lines()
            .find_map(|line| line.strip_prefix("metrics on "))
            .unwrap();
        sum(&text_at(url), begin)
    };
    workers.iter().map(metric_of).sum()
}

/// Follows the job to its end. Checks that its bytes equal the bytes of one process, and that no log contains
/// a secret.
fn finished(coordinator: &Coordinator<'_>, sandbox: &Sandbox, job: u64, workers: &[Background]) {
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "the result",
    );
    assert_eq!(coordinator.count(job, "tiles_set_aside"), 0);
    let events = coordinator.ok("logs");
    let logs = workers
        .iter()
        .map(Background::err)
        .chain([coordinator.process.err(), events]);
    for log in logs {
        for secret in [SECRET, "X-Amz-", "Signature=", "x-amz-checksum"] {
            let at = log
                .find(secret)
                .map(|at| &log[at.saturating_sub(300)..log.len().min(at + 100)]);
            assert_eq!(at, None, "a log has {secret}");
        }
    }
}

/// Returns the size of a file in bytes.
fn size(path: &Path) -> u64 {
    std::fs::metadata(path).unwrap().len()
}

#[test]
fn workers_read_and_write_bucket_directly() {
    let (sandbox, server) = sandbox(LARGE);
    let mut through = Vec::new();
    for (data, more) in [("through", ""), ("past", "&direct=yes")] {
        let coordinator = coordinator(&sandbox, &server, data, more);
        let job = coordinator.submit(LARGE[1]);
        let scene = coordinator.json(&format!("show {job}"))["scene"]
            .as_str()
            .unwrap()
            .to_owned();
        let scene = size(&server.objects(&format!("farm/{data}"), &scene)[0]);
        assert!(scene > 7_000_000, "{scene}");
        let carried = || {
            let grpc = ["in", "out"].map(|way| {
                coordinator_metric(
                    &coordinator,
                    &format!("sightline_transferred_bytes_total{{direction=\"{way}\""),
                )
            });
            let store = ["in", "out"].map(|way| {
                coordinator_metric(
                    &coordinator,
                    &format!("sightline_object_store_bytes_total{{direction=\"{way}\""),
                )
            });
            [grpc[0], grpc[1], store[0], store[1]]
        };
        // Each worker receives a tile.
        coordinator.ok(&format!("pause {job}"));
        let workers = [worker(&coordinator, ""), worker(&coordinator, "")];
        wait_for("both workers", || {
            (coordinator.json("workers").as_array().unwrap().len() == 2).then_some(())
        });
        let before = carried();
        coordinator.ok(&format!("resume {job}"));
        coordinator.ok(&format!("watch {job}"));
        let after = carried();
        let moved: Vec<u64> = after
            .iter()
            .zip(before)
            .map(|(after, before)| after - before)
            .collect();
        eprintln!(
            "{data}: gRPC in {}, out {}; bucket in {}, out {}",
            moved[0], moved[1], moved[2], moved[3]
        );
        let direct = |direction: &str, way: &str| {
            let labels = format!("{{direction=\"{direction}\",way=\"{way}\"}}");
            [
                worker_metric(&workers, &format!("sightline_worker_blobs_total{labels}")),
                worker_metric(
                    &workers,
                    &format!("sightline_worker_blob_bytes_total{labels}"),
                ),
            ]
        };
        if more.is_empty() {
            assert_eq!(
                (direct("in", "direct"), direct("out", "direct")),
                ([0; 2], [0; 2])
            );
            assert_eq!(direct("in", "coordinator"), [2, 2 * scene]);
            assert_eq!(coordinator_metric(&coordinator, "sightline_direct_"), 0);
        } else {
            assert_eq!(direct("in", "direct"), [2, 2 * scene]);
            let [outputs, bytes] = direct("out", "direct");
            assert!(
                outputs >= 2 && bytes > 512 << 10,
                "{outputs} outputs of {bytes} bytes"
            );
            assert_eq!(
                coordinator_metric(
                    &coordinator,
                    "sightline_direct_addresses_total{operation=\"read\""
                ),
                2
            );
            assert_eq!(
                coordinator_metric(
                    &coordinator,
                    "sightline_direct_bytes_total{operation=\"read\""
                ),
                2 * scene
            );
            assert_eq!(
                coordinator_metric(
                    &coordinator,
                    "sightline_direct_addresses_total{operation=\"write\""
                ),
                outputs
            );
            assert_eq!(
                coordinator_metric(
                    &coordinator,
                    "sightline_direct_bytes_total{operation=\"write\""
                ),
                bytes
            );
            assert_eq!(
                (direct("in", "coordinator"), direct("out", "coordinator")),
                ([0; 2], [0; 2])
            );
            // Only messages and the results of crew members go through the coordinator.
            assert!(
                through[1] > 2 * scene && moved[1] < scene,
                "{moved:?} after {through:?}"
            );
            // The coordinator reads the bucket to check the written outputs, and does not write them again.
            // It may also read the name of the store, which has 33 bytes, to compare it.
            assert!(
                [0, 33].contains(&through[2]) && moved[2] >= bytes,
                "{moved:?} after {through:?}"
            );
            assert!(
                moved[3] < through[3] && through[3] - moved[3] <= bytes,
                "{moved:?} after {through:?}"
            );
        }
        assert_eq!(
            worker_metric(
                &workers,
                "sightline_worker_blobs_total{direction=\"in\",way=\"fallback\"}"
            ),
            0
        );
        assert_eq!(
            coordinator_metric(&coordinator, "sightline_direct_fallbacks_total"),
            0
        );
        finished(&coordinator, &sandbox, job, &workers);
        // The objects that the workers wrote next to the blobs are removed.
        wait_for(
            "the scene, the result and the name of the store alone",
            || (server.objects(&format!("farm/{data}"), "").len() == 3).then_some(()),
        );
        through = moved;
    }
}

#[test]
fn unreachable_bucket_costs_only_log_line() {
    let (sandbox, server) = sandbox(SMALL);
    // No server listens at this address.
    let coordinator = coordinator(&sandbox, &server, "data", "&direct=http://127.0.0.1:9");
    let job = coordinator.submit(SMALL[1]);
    let workers = [worker(&coordinator, "")];
    coordinator.ok(&format!("watch {job}"));
    let blobs = |workers: &[Background], way: &str| {
        worker_metric(
            workers,
            &format!("sightline_worker_blobs_total{{direction=\"in\",way=\"{way}\"}}"),
        )
    };
    assert_eq!(
        (blobs(&workers, "direct"), blobs(&workers, "fallback")),
        (0, 1)
    );
    assert_eq!(
        coordinator_metric(
            &coordinator,
            "sightline_direct_fallbacks_total{operation=\"read\""
        ),
        1
    );
    // The worker does not try an address again in this session.
    assert_eq!(
        coordinator_metric(&coordinator, "sightline_direct_addresses_total"),
        1
    );
    assert_eq!(
        coordinator_metric(
            &coordinator,
            "sightline_direct_fallbacks_total{operation=\"write\""
        ),
        0
    );
    let said = workers[0].err();
    assert!(
        said.contains("the object store at 127.0.0.1 is unusable (no connection"),
        "{said}"
    );
    finished(&coordinator, &sandbox, job, &workers);
    workers.into_iter().for_each(Background::kill);
    // A worker that does not request addresses, like a worker of an earlier version.
    let again = format!("{} --seed 2", SMALL[1]);
    sandbox.ok(&format!("bake {again} -o alone.pvs --data-dir alone"));
    let job = coordinator.submit(&again);
    let workers = [worker(&coordinator, " --no-direct")];
    coordinator.ok(&format!("watch {job}"));
    assert_eq!(
        (blobs(&workers, "coordinator"), blobs(&workers, "fallback")),
        (1, 0)
    );
    assert_eq!(
        coordinator_metric(&coordinator, "sightline_direct_addresses_total"),
        1
    );
    finished(&coordinator, &sandbox, job, &workers);
}

#[test]
fn worker_detects_changed_object_and_uses_coordinator() {
    let (sandbox, server) = sandbox(SMALL);
    let coordinator = coordinator(&sandbox, &server, "data", "&direct=yes");
    let job = coordinator.submit(SMALL[1]);
    let digest = coordinator.json(&format!("show {job}"))["scene"]
        .as_str()
        .unwrap()
        .to_owned();
    let [scene] = &server.objects("farm", &digest)[..] else {
        panic!("one scene")
    };
    let mut bytes = std::fs::read(scene).unwrap();
    bytes[1_000_000] ^= 1;
    std::fs::write(scene, bytes).unwrap();
    // The coordinator has a copy.
    let workers = [worker(&coordinator, "")];
    coordinator.ok(&format!("watch {job}"));
    assert!(
        workers[0]
            .err()
            .contains("do not have the requested digest"),
        "{}",
        workers[0].err()
    );
    assert_eq!(
        coordinator_metric(
            &coordinator,
            "sightline_direct_fallbacks_total{operation=\"read\""
        ),
        1
    );
    finished(&coordinator, &sandbox, job, &workers);
}

/// A proxy between workers and the object store that breaks connections off.
struct FaultyProxy {
    address: SocketAddr,
    /// The number of connections that broke off in the middle of an answer.
    broken: Arc<AtomicUsize>,
    /// The number of transferred bytes of answers.
    passed: Arc<AtomicU64>,
}

/// Starts a proxy that forwards connections to a server, and breaks the first `breaks` ones off after `after`
/// bytes of answers.
fn between(to: SocketAddr, breaks: usize, after: u64) -> FaultyProxy {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (broken, passed) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicU64::new(0)));
    let (count, bytes) = (Arc::clone(&broken), Arc::clone(&passed));
    thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            let Ok(server) = TcpStream::connect(to) else {
                return;
            };
            let (mut up, mut down) = (client.try_clone().unwrap(), server.try_clone().unwrap());
            thread::spawn(move || io::copy(&mut up, &mut { server }));
            let (count, bytes) = (Arc::clone(&count), Arc::clone(&bytes));
            thread::spawn(move || {
                let mut client = client;
                let mut room = if count.load(Ordering::Relaxed) < breaks {
                    after
                } else {
                    u64::MAX
                };
                let mut piece = vec![0; 64 << 10];
                while room > 0 {
                    let most = room.min(piece.len() as u64) as usize;
                    let Ok(read @ 1..) = down.read(&mut piece[..most]) else {
                        break;
                    };
                    if client.write_all(&piece[..read]).is_err() {
                        break;
                    }
                    room -= read as u64;
                    bytes.fetch_add(read as u64, Ordering::Relaxed);
                }
                if room == 0 {
                    count.fetch_add(1, Ordering::Relaxed);
                }
                drop(client.shutdown(Shutdown::Both));
                drop(down.shutdown(Shutdown::Both));
            });
        }
    });
    FaultyProxy {
        address,
        broken,
        passed,
    }
}

#[test]
fn interrupted_download_continues() {
    let (sandbox, server) = sandbox(SMALL);
    let between = between(server.address(), 2, 700_000);
    let coordinator = coordinator(
        &sandbox,
        &server,
        "data",
        &format!("&direct=http://{}", between.address),
    );
    let job = coordinator.submit(SMALL[1]);
    let workers = [worker(&coordinator, "")];
    coordinator.ok(&format!("watch {job}"));
    assert_eq!(
        between.broken.load(Ordering::Relaxed),
        2,
        "it broke off twice"
    );
    let read = "sightline_worker_blobs_total{direction=\"in\",way=\"direct\"}";
    assert_eq!(worker_metric(&workers, read), 1);
    let bytes = worker_metric(
        &workers,
        "sightline_worker_blob_bytes_total{direction=\"in\",way=\"direct\"}",
    );
    // No byte was transferred twice, except bytes in transit.
    let passed = between.passed.load(Ordering::Relaxed);
    assert!(
        (bytes..bytes + bytes / 4).contains(&passed),
        "{passed} bytes for {bytes}"
    );
    assert_eq!(
        coordinator_metric(&coordinator, "sightline_direct_fallbacks_total"),
        0
    );
    finished(&coordinator, &sandbox, job, &workers);
}
