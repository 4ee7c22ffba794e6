//! Tests of a worker that reconnects.
//!
//! It names only the tiles that it still computes, and requests work again if the coordinator was wrong about
//! its tiles.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::pin::Pin;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use sightline_proto::v1;
use sightline_proto::v1::coordinator_message::Message as FromCoordinator;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::worker_message::Message as FromWorker;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_proto::v1::workers_server::{Workers, WorkersServer};
use sightline_tests::Sandbox;
use tokio::sync::mpsc;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream, UnboundedReceiverStream};
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Request, Response, Status, Streaming};

type Answers<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The sender of the test's messages to a worker on one stream. Dropping it ends the stream.
type ToWorker = mpsc::Sender<Result<v1::CoordinatorMessage, Status>>;

/// A stream of the worker: its messages, and the sender of the answers.
struct Session {
    hears: Streaming<v1::WorkerMessage>,
    says: Option<ToWorker>,
}

impl Session {
    async fn say(&self, message: FromCoordinator) {
        let message = v1::CoordinatorMessage {
            message: Some(message),
        };
        self.says.as_ref().unwrap().send(Ok(message)).await.unwrap();
    }

    /// Returns the next message that is not a renewal of leases.
    async fn hear(&mut self) -> FromWorker {
        loop {
            let next = tokio::time::timeout(Duration::from_secs(30), self.hears.next()).await;
            match next
                .expect("the worker says nothing")
                .unwrap()
                .unwrap()
                .message
                .unwrap()
            {
                FromWorker::Progress(_) => {}
                message => return message,
            }
        }
    }
}

/// A coordinator whose answers the test determines.
struct Puppet {
    sessions: mpsc::UnboundedSender<Session>,
    scene: Vec<v1::Chunk>,
    /// The stream that ends when the first output arrives.
    ends: Arc<Mutex<Option<ToWorker>>>,
    /// The number of next streams that are rejected.
    refuses: AtomicU32,
}

#[tonic::async_trait]
impl Workers for Puppet {
    type WorkStream = Answers<v1::CoordinatorMessage>;
    type FetchSceneStream = Answers<v1::Chunk>;
    type FetchPackStream = Answers<v1::Chunk>;
    type CrewStream = Answers<v1::CrewMessage>;

    async fn work(
        &self,
        r: Request<Streaming<v1::WorkerMessage>>,
    ) -> Result<Response<Self::WorkStream>, Status> {
        let refused = self
            .refuses
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1));
        if refused.is_ok() {
            return Err(Status::unavailable("not yet"));
        }
        let (says, said) = mpsc::channel(16);
        self.sessions
            .send(Session {
                hears: r.into_inner(),
                says: Some(says),
            })
            .unwrap();
        Ok(Response::new(Box::pin(ReceiverStream::new(said))))
    }

    async fn fetch_scene(
        &self,
        _: Request<v1::FetchSceneRequest>,
    ) -> Result<Response<Self::FetchSceneStream>, Status> {
        Ok(Response::new(Box::pin(tokio_stream::iter(
            self.scene.clone().into_iter().map(Ok),
        ))))
    }

    async fn fetch_pack(
        &self,
        _: Request<v1::FetchPackRequest>,
    ) -> Result<Response<Self::FetchPackStream>, Status> {
        Err(Status::not_found("there are no packs"))
    }

    async fn put_result(
        &self,
        _: Request<Streaming<v1::ResultPart>>,
    ) -> Result<Response<v1::PutResultResponse>, Status> {
        // The worker receives the answer while it has no stream, more than a second before its next stream.
        self.refuses.store(2, Ordering::Relaxed);
        drop(self.ends.lock().unwrap().take());
        tokio::time::sleep(Duration::from_millis(60)).await;
        Err(Status::failed_precondition(
            "this tile was not leased to anybody under this number",
        ))
    }

    async fn stage_result(
        &self,
        _: Request<v1::StageResultRequest>,
    ) -> Result<Response<v1::StageResultResponse>, Status> {
        Err(Status::unimplemented("outputs come in chunks"))
    }

    async fn crew(
        &self,
        _: Request<Streaming<v1::CrewMessage>>,
    ) -> Result<Response<Self::CrewStream>, Status> {
        Err(Status::not_found("there are no crews"))
    }
}

/// Returns a job and its scene as a coordinator sends them.
async fn job(sandbox: &Sandbox) -> (v1::JobSpec, Vec<v1::Chunk>) {
    sandbox.ok("generate maze --grid 3x3 -o maze.glb");
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let id =
        coordinator.submit("maze.glb --sampler cubes --cells 4x4x2 --resolution 32 --backend cpu");
    let url = tonic::transport::Channel::from_shared(coordinator.url.clone()).unwrap();
    let channel = url.connect().await.unwrap();
    let shown = JobsClient::new(channel.clone())
        .show(v1::ShowRequest { job: id })
        .await
        .unwrap();
    let spec = shown.into_inner().spec.unwrap();
    let request = v1::FetchSceneRequest {
        digest: spec.scene.clone(),
        ..Default::default()
    };
    let chunks = WorkersClient::new(channel)
        .fetch_scene(request)
        .await
        .unwrap()
        .into_inner();
    (spec, chunks.map(Result::unwrap).collect().await)
}

#[tokio::test(flavor = "multi_thread")]
async fn output_rejected_without_connection_is_not_claimed() {
    let sandbox = Sandbox::new();
    let (spec, scene) = job(&sandbox).await;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let (sessions, joined) = mpsc::unbounded_channel();
    let ends = Arc::new(Mutex::new(None));
    let puppet = Puppet {
        sessions,
        scene,
        ends: Arc::clone(&ends),
        refuses: AtomicU32::new(0),
    };
    let server = tonic::transport::Server::builder().add_service(WorkersServer::new(puppet));
    tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    let mut joined = UnboundedReceiverStream::new(joined);
    let worker = sandbox.start(&format!(
        "worker --backend cpu --threads 1 --coordinator {url}"
    ));

    let mut first = joined.next().await.unwrap();
    let FromWorker::Hello(hello) = first.hear().await else {
        panic!("no greeting")
    };
    assert!(hello.held.is_empty());
    let welcome = || {
        FromCoordinator::Welcome(v1::Welcome {
            epoch: 1,
            lease_millis: 10_000,
            ..Default::default()
        })
    };
    let two = FromWorker::Want(v1::Want { tiles: 2 });
    first.say(welcome()).await;
    assert_eq!(first.hear().await, two);
    let lease = |tile| {
        Some(v1::Lease {
            job: 1,
            tile,
            epoch: 1,
            lease: u64::from(tile) + 1,
            tag: 5,
        })
    };
    let profile = hello.profiles[0].clone();
    let grant = v1::Grant {
        lease: lease(0),
        spec: Some(spec),
        profile,
        ..v1::Grant::default()
    };
    first.say(FromCoordinator::Grant(grant)).await;
    *ends.lock().unwrap() = first.says.take();

    // The output was rejected while the worker had no stream to receive the rejection.
    let mut second = joined.next().await.unwrap();
    let FromWorker::Hello(hello) = second.hear().await else {
        panic!("no greeting")
    };
    assert_eq!(hello.held, [], "a tile that has ended is claimed");
    second.say(welcome()).await;
    assert_eq!(second.hear().await, two);
    // The coordinator revokes a lease that the worker does not hold, so the worker has more capacity than the
    // coordinator assumed.
    second
        .say(FromCoordinator::Revoke(v1::Revoke { lease: lease(1) }))
        .await;
    assert_eq!(second.hear().await, two);
    worker.kill();
}
