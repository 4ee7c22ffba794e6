//! Tests that a coordinator rejects bad calls before it stores their bytes or does their work, on loopback.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc as events;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::results_client::ResultsClient;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_pvs::Pvs;
use sightline_records::QuarantineRecord;
use sightline_records::ids::JobId;
use sightline_scene::{Scene, TriangleId};
use sightline_scheduler::{Event, WorkerCommand};
use sightline_viewcells::CellIndex;
use tokio::sync::mpsc;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

use super::connections::{ConnectionLimits, Connections, Listener};
use super::{serve, serve_http};
use crate::access::Caller;
use crate::config::Config;
use crate::coordinator::Coordinator;
use crate::jobs::control;
use crate::quota::Quotas;
use crate::records::JobChanges;
use crate::results::state::SceneQueries;
use crate::tests::life::{join, output, put, triangle, two_tiles};
use crate::workers::lease_tags::LeaseUse;
use crate::workers::sessions::{self, Message};

/// Maximum time for an answer before a test fails.
const LIMIT: Duration = Duration::from_secs(60);

/// A coordinator that serves until the end of the test.
struct ServedCoordinator {
    c: Arc<Coordinator>,
    channel: Channel,
    pages: SocketAddr,
    tasks: Vec<tokio::task::JoinHandle<()>>,
    _folder: tempfile::TempDir,
}

impl Drop for ServedCoordinator {
    fn drop(&mut self) {
        self.tasks.iter().for_each(tokio::task::JoinHandle::abort);
    }
}

async fn served(quotas: &[&str]) -> ServedCoordinator {
    served_with(quotas, ConnectionLimits::for_descriptors(1024)).await
}

async fn served_with(quotas: &[&str], limits: ConnectionLimits) -> ServedCoordinator {
    let folder = tempfile::tempdir().unwrap();
    let mut config = Config::new(folder.path().to_owned());
    let quotas: Vec<String> = quotas.iter().map(|text| (*text).to_owned()).collect();
    config.quotas = Quotas::parse(&quotas).unwrap();
    let c = tokio::task::spawn_blocking(move || Coordinator::open(config))
        .await
        .unwrap()
        .unwrap();
    let connections = Connections::new(limits);
    let listen = || Listener::bind("127.0.0.1:0".parse().unwrap(), false, &connections);
    let (calls, pages) = (listen().await.unwrap(), listen().await.unwrap());
    let (url, at) = (
        format!("http://{}", calls.local_addr().unwrap()),
        pages.local_addr().unwrap(),
    );
    let (first, second) = (Arc::clone(&c), Arc::clone(&c));
    let tasks = vec![
        tokio::spawn(async move { drop(serve(first, calls, None, std::future::pending()).await) }),
        tokio::spawn(async move { drop(serve_http(second, pages, None).await) }),
    ];
    let channel = Channel::from_shared(url).unwrap().connect().await.unwrap();
    ServedCoordinator {
        c,
        channel,
        pages: at,
        tasks,
        _folder: folder,
    }
}

/// Creates a stream that sends the messages and stays open.
async fn open<M>(messages: Vec<M>) -> (mpsc::Sender<M>, ReceiverStream<M>) {
    let (send, stream) = mpsc::channel(messages.len().max(1));
    for message in messages {
        assert!(send.send(message).await.is_ok());
    }
    (send, ReceiverStream::new(stream))
}

fn header(lease: v1::Lease, bytes: u64) -> v1::ResultPart {
    let digest = vec![7; 32];
    let header = v1::ResultHeader {
        lease: Some(lease),
        digest,
        bytes,
        ..Default::default()
    };
    v1::ResultPart {
        part: Some(v1::result_part::Part::Header(header)),
    }
}

fn piece(total: u64) -> v1::Chunk {
    chunks::chunk(vec![7; 9], 0, total)
}

/// Sends a tile's output on a stream that stays open, and returns the answer.
async fn put_result(served: &ServedCoordinator, parts: Vec<v1::ResultPart>) -> Result<(), Status> {
    let (_open, parts) = open(parts).await;
    let answer = WorkersClient::new(served.channel.clone())
        .put_result(parts)
        .await;
    answer.map(|_| ())
}

#[tokio::test(flavor = "multi_thread")]
async fn result_header_is_rejected_without_lease_or_with_wrong_length() {
    let served = served(&[]).await;
    let c = Arc::clone(&served.c);
    let grant = tokio::task::spawn_blocking(move || {
        let scene = c.take_scene(&triangle()).unwrap();
        two_tiles(&c, scene);
        let (_, mut commands) = join(&c, "ada");
        let WorkerCommand::Grant(grant) = commands.try_recv().unwrap() else {
            panic!("no tile")
        };
        grant.lease
    });
    let given = grant.await.unwrap();
    let lease = served.c.workers.lease_tags.to_wire(&given, LeaseUse::Hold);
    let piece = |total| v1::ResultPart {
        part: Some(v1::result_part::Part::Chunk(piece(total))),
    };
    let cases = [
        // A lease that was never granted, of a tile of a job that does not exist.
        (
            vec![header(
                v1::Lease {
                    lease: lease.lease + 77,
                    ..lease
                },
                9,
            )],
            Code::FailedPrecondition,
        ),
        (
            vec![header(v1::Lease { job: 99, ..lease }, 9)],
            Code::FailedPrecondition,
        ),
        (
            vec![header(v1::Lease { tile: 99, ..lease }, 9)],
            Code::FailedPrecondition,
        ),
        // Forged leases: for any start of the coordinator, with another tag, with the tag of a helper.
        (
            vec![header(
                v1::Lease {
                    epoch: 0,
                    lease: 0,
                    ..lease
                },
                9,
            )],
            Code::FailedPrecondition,
        ),
        (
            vec![header(v1::Lease { tag: 0, ..lease }, 9)],
            Code::FailedPrecondition,
        ),
        (
            vec![header(
                served.c.workers.lease_tags.to_wire(&given, LeaseUse::Help),
                9,
            )],
            Code::FailedPrecondition,
        ),
        // More bytes than an output of two cells and one triangle can have.
        (vec![header(lease, 1 << 30)], Code::InvalidArgument),
        // More or fewer bytes than the header announced.
        (vec![header(lease, 100), piece(200)], Code::InvalidArgument),
        (vec![header(lease, 100), piece(50)], Code::InvalidArgument),
    ];
    for (parts, code) in cases {
        let refused = tokio::time::timeout(LIMIT, put_result(&served, parts)).await;
        let refused = refused.expect("the call waits for its end").unwrap_err();
        assert_eq!(refused.code(), code, "{refused}");
        assert_eq!(served.c.uploads.unfinished.all(), 0);
    }
    let refused = put_result(&served, vec![header(lease, 1 << 30)])
        .await
        .unwrap_err();
    let most = refused
        .message()
        .rsplit(' ')
        .next()
        .and_then(|most| most.parse().ok());
    let most: u64 = most.unwrap_or_else(|| panic!("{refused}"));
    let longer = put_result(&served, vec![header(lease, most + 1)])
        .await
        .unwrap_err();
    assert_eq!(longer.code(), Code::InvalidArgument, "{longer}");
    // An output under a valid lease is accepted, even the longest one.
    for bytes in [100, most] {
        let mut calls = WorkersClient::new(served.channel.clone());
        let (_open, parts) = open(vec![header(lease, bytes), piece(bytes)]).await;
        let waiting = tokio::spawn(async move { calls.put_result(parts).await.map(|_| ()) });
        until(|| served.c.uploads.unfinished.all() == bytes).await;
        waiting.abort();
        until(|| served.c.uploads.unfinished.all() == 0).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn scene_file_header_is_rejected_with_many_rules_or_long_text() {
    use v1::scene_file_part::Part;
    let served = served(&[]).await;
    let long = "x".repeat(1025);
    let rule = |kind: &str, glob: &str| v1::KindRule {
        kind: kind.to_owned(),
        glob: glob.to_owned(),
    };
    let headers = [
        v1::SceneFileHeader {
            name: "a.obj".to_owned(),
            rules: vec![rule("opaque", "a"); 257],
        },
        v1::SceneFileHeader {
            name: "a.obj".to_owned(),
            rules: vec![rule("opaque", &long)],
        },
        v1::SceneFileHeader {
            name: long.clone(),
            rules: Vec::new(),
        },
    ];
    for header in headers {
        let (_open, parts) = open(vec![v1::SceneFilePart {
            part: Some(Part::Header(header)),
        }])
        .await;
        let mut calls = JobsClient::new(served.channel.clone());
        let refused = tokio::time::timeout(LIMIT, calls.put_scene_file(parts)).await;
        let refused = refused.expect("the call waits for its end").unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
    }
}

/// Joins as a worker that shows an identity. Returns the identity in the welcome, and the open stream.
async fn join_as(
    served: &ServedCoordinator,
    name: &str,
    identity: &[u8],
) -> (Vec<u8>, mpsc::Sender<v1::WorkerMessage>) {
    use v1::worker_message::Message;
    let hello = v1::Hello {
        name: name.to_owned(),
        profiles: vec!["cpu/test".to_owned()],
        algorithm: sightline_model::ALGORITHM_VERSION,
        protocol: sightline_proto::PROTOCOL,
        identity: identity.to_vec(),
        ..Default::default()
    };
    let (stream, messages) = open(vec![v1::WorkerMessage {
        message: Some(Message::Hello(hello)),
    }])
    .await;
    let answer = WorkersClient::new(served.channel.clone())
        .work(messages)
        .await
        .unwrap();
    let welcome = answer
        .into_inner()
        .next()
        .await
        .unwrap()
        .unwrap()
        .message
        .unwrap();
    let v1::coordinator_message::Message::Welcome(welcome) = welcome else {
        panic!("{welcome:?}")
    };
    (welcome.identity, stream)
}

/// Returns the faults of the connected workers.
fn troubles(served: &ServedCoordinator) -> Vec<Option<&'static str>> {
    let now = served.c.scheduler_now();
    served
        .c
        .dispatcher
        .read(|scheduler| scheduler.roster(now))
        .into_iter()
        .map(|member| member.trouble)
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn stranger_cannot_quarantine_worker_of_same_name() {
    let served = served(&[]).await;
    let (ada, stream) = join_as(&served, "ada", b"").await;
    drop(stream);
    until(|| troubles(&served).is_empty()).await;
    let (stranger, stream) = join_as(&served, "ada", b"").await;
    assert_ne!(ada, stranger);
    let number = u64::from_be_bytes(*stranger.first_chunk().unwrap());
    let signature =
        sightline_records::ids::signature("ada", sightline_records::ids::WorkerIdentity(number));
    let record = QuarantineRecord {
        worker: signature.clone(),
        at_ms: 1,
        reason: "it lied".to_owned(),
    };
    let mut changes = JobChanges::begin(&served.c);
    changes.quarantine(record).unwrap();
    changes.tell(Event::Quarantined(signature));
    changes.finish().run(&served.c);
    assert!(troubles(&served)[0].is_some_and(|trouble| trouble.contains("quarantined")));
    drop(stream);
    until(|| troubles(&served).is_empty()).await;
    // The stranger stays quarantined, but the worker with the same name is not.
    let (again, stream) = join_as(&served, "ada", &stranger).await;
    assert_eq!(again, stranger);
    assert!(troubles(&served)[0].is_some());
    drop(stream);
    until(|| troubles(&served).is_empty()).await;
    let (again, _stream) = join_as(&served, "ada", &ada).await;
    assert_eq!(again, ada);
    assert_eq!(troubles(&served), [None]);
    // An admin can release by the name as well as by the signature.
    assert!(!crate::workers::quarantine::release(&served.c, "bob").unwrap());
    assert!(crate::workers::quarantine::release(&served.c, "ada").unwrap());
    assert!(served.c.records.quarantined().unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_calls_end() {
    let short = Duration::from_millis(50);
    let limits = ConnectionLimits::for_descriptors(1024);
    let served = served_with(
        &[],
        ConnectionLimits {
            call_silence: short,
            idle: short,
            ..limits
        },
    )
    .await;
    let refused = tokio::time::timeout(LIMIT, put_result(&served, Vec::new())).await;
    assert_eq!(
        refused.expect("the call does not end").unwrap_err().code(),
        Code::DeadlineExceeded
    );
    // A stream that workers keep open has a time limit until its first message.
    let mut calls = WorkersClient::new(served.channel.clone());
    let (_open, messages) = open(Vec::new()).await;
    let refused = tokio::time::timeout(LIMIT, calls.work(messages))
        .await
        .expect("the call does not end");
    assert_eq!(
        refused.err().map(|status| status.code()),
        Some(Code::DeadlineExceeded)
    );
    let (_open, messages) = open(Vec::new()).await;
    let refused = tokio::time::timeout(LIMIT, calls.crew(messages))
        .await
        .expect("the call does not end");
    assert_eq!(
        refused.err().map(|status| status.code()),
        Some(Code::DeadlineExceeded)
    );
}

/// Waits until `is` returns true.
async fn until(is: impl Fn() -> bool) {
    let wait = async {
        while !is() {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    };
    tokio::time::timeout(LIMIT, wait)
        .await
        .expect("it did not come");
}

/// Adds a caller to a request, like the authentication by tokens.
fn by<T>(user: &str, message: T) -> Request<T> {
    let scopes = crate::access::Scopes::new(&[crate::access::Scope::Submit]);
    let mut request = Request::new(message);
    request.extensions_mut().insert(Caller::User {
        name: user.to_owned(),
        scopes,
    });
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn scene_file_counts_from_first_chunk() {
    let served = served(&["bytes=100"]).await;
    let file = |total: u64| {
        use v1::scene_file_part::Part;
        let header = v1::SceneFileHeader {
            name: "a.obj".to_owned(),
            rules: Vec::new(),
        };
        let parts = [Part::Header(header), Part::Chunk(piece(total))];
        parts
            .map(|part| v1::SceneFilePart { part: Some(part) })
            .to_vec()
    };
    // A header with a too long file is rejected immediately, while the stream is open.
    let (_held, parts) = open(file((1 << 30) + 1)).await;
    let call = async {
        JobsClient::new(served.channel.clone())
            .put_scene_file(parts)
            .await
    };
    let refused = tokio::time::timeout(LIMIT, call)
        .await
        .expect("the call waits for its end")
        .unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
    // Unfinished files of one user count together.
    let caller = by("ada", ()).extensions().get::<Caller>().unwrap().clone();
    let first = super::jobs::begin_file(&served.c, &caller, 60)
        .await
        .unwrap();
    let refused = super::jobs::begin_file(&served.c, &caller, 41)
        .await
        .err()
        .unwrap();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    assert!(
        refused.message().contains("ada may have at most 100 bytes"),
        "{refused}"
    );
    drop(first);
    drop(
        super::jobs::begin_file(&served.c, &caller, 100)
            .await
            .unwrap(),
    );
}

/// Sends the head of a request and returns the first line of the answer.
fn head(pages: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(pages).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    write!(
        stream,
        "{request}\r\nHost: {pages}\r\nContent-Type: application/octet-stream\r\n\r\n"
    )
    .unwrap();
    let mut answer = [0; 64];
    let read = stream.read(&mut answer).unwrap();
    String::from_utf8_lossy(&answer[..read]).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn posted_scene_is_rejected_by_announced_length() {
    let served = served(&[]).await;
    let pages = served.pages;
    for length in ["Content-Length: 1073741825", "Transfer-Encoding: chunked"] {
        let request = format!("POST /scenes?name=a.obj HTTP/1.1\r\n{length}");
        let answer = tokio::task::spawn_blocking(move || head(pages, &request))
            .await
            .unwrap();
        assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
    }
}

/// Answers that run until the caller has gone.
struct EndlessAnswers {
    begun: Mutex<events::Sender<u32>>,
    count: AtomicU32,
}

impl EndlessAnswers {
    fn ask<T>(&self, is_gone: &(dyn Fn() -> bool + Sync)) -> Result<T, String> {
        let number = self.count.fetch_add(1, Ordering::Relaxed);
        self.begun.lock().unwrap().send(number).unwrap();
        let began = Instant::now();
        while !is_gone() && began.elapsed() < LIMIT {
            std::thread::sleep(Duration::from_millis(1));
        }
        Err("the asker has gone".to_owned())
    }
}

impl SceneQueries for EndlessAnswers {
    fn why(
        &self,
        _: &Pvs,
        _: Scene,
        _: CellIndex,
        _: TriangleId,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::WhyResponse, String> {
        self.ask(is_gone)
    }

    fn measure(
        &self,
        _: &Pvs,
        _: Scene,
        _: &v1::MeasureRequest,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::MeasureResponse, String> {
        self.ask(is_gone)
    }
}

/// Runs a job of two tiles to its end.
fn done(c: &Arc<Coordinator>) -> JobId {
    let scene = c.take_scene(&triangle()).unwrap();
    let id = two_tiles(c, scene);
    let (worker, mut commands) = join(c, "ada");
    while control::result(&c.records, id).is_err() {
        while let Ok(command) = commands.try_recv() {
            let WorkerCommand::Grant(grant) = command else {
                continue;
            };
            put(c, &grant, &output(&grant, &[0])).unwrap();
            sessions::heard(c, worker, Message::Want(1)).run(c);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    id
}

#[tokio::test(flavor = "multi_thread")]
async fn question_ends_when_caller_has_gone() {
    let served = served(&[]).await;
    let (begun, begins) = events::channel();
    served.c.answer_with(Box::new(EndlessAnswers {
        begun: Mutex::new(begun),
        count: AtomicU32::new(0),
    }));
    let c = Arc::clone(&served.c);
    let job = tokio::task::spawn_blocking(move || done(&c))
        .await
        .unwrap()
        .0;
    let begins = Arc::new(Mutex::new(begins));
    for number in 0..6 {
        let mut results = ResultsClient::new(served.channel.clone());
        let from = Some(v1::why_request::From::Cell(0));
        let asked = tokio::spawn(async move {
            match number % 2 {
                0 => results
                    .why(v1::WhyRequest {
                        job,
                        triangle: 0,
                        from,
                    })
                    .await
                    .map(drop),
                _ => results
                    .measure(v1::MeasureRequest {
                        job,
                        ..Default::default()
                    })
                    .await
                    .map(drop),
            }
        });
        // Each query starts, because the previous one ended with its call.
        let begins = Arc::clone(&begins);
        let next = move || begins.lock().unwrap().recv_timeout(LIMIT);
        assert_eq!(tokio::task::spawn_blocking(next).await.unwrap(), Ok(number));
        asked.abort();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn measurement_is_limited() {
    let served = served(&[]).await;
    let mut results = ResultsClient::new(served.channel.clone());
    let mut ask = async |viewpoints, resolution| {
        let asked = v1::MeasureRequest {
            job: 1,
            viewpoints,
            resolution,
            seed: 0,
        };
        results.measure(asked).await.unwrap_err()
    };
    for (viewpoints, resolution) in [(1000, 512), (64, 512), (1000, 130)] {
        let refused = ask(viewpoints, resolution).await;
        assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
        assert!(
            refused.message().contains("but the maximum is 100000000"),
            "{refused}"
        );
    }
    // A measurement within the limit reaches the job, which does not exist.
    for (viewpoints, resolution) in [(1000, 128), (63, 512), (0, 0)] {
        assert_eq!(ask(viewpoints, resolution).await.code(), Code::NotFound);
    }
}
