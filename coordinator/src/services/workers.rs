//! The `Workers` service: one stream per worker, scenes and packs out, results in.

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};

use futures::{Stream, StreamExt as _};
use sightline_assemble::OutputError;
use sightline_model::ALGORITHM_VERSION;
use sightline_proto::v1::worker_message::Message as FromWorker;
use sightline_proto::{PROTOCOL, v1};
use sightline_records::ids::{Digest, JobId, Lease, WorkerId, WorkerIdentity, signature};
use sightline_records::{MAX_IDENTIFIER_BYTES, MAX_WORKER_BYTES};
use sightline_scheduler::{Failure, Introduction, Joined, Progress, WorkerCommand};
use sightline_store::Staged;
use sightline_traces::TraceId;
use tokio::sync::{mpsc, oneshot};
use tonic::{Request, Response, Status, Streaming};

use super::blocking::{blocking, blocking_one_of, large, later};
use super::connections::Peer;
use super::guard::caller;
use super::spooling::filled;
use super::streams::{ChunkStream, stream_blob, stream_or_address};
use super::{Answer, crews, status, wire};
use crate::dispatch::follow_ups::Waiting;
use crate::dispatch::outbox::Outbox;
use crate::jobs::suspend;
use crate::outputs::commit::{self, MAX_LIGHT, Origin, ResultError, UploadHeader, Weight};
use crate::quota::Turn;
use crate::state::{Coordinator, MissingBlob};
use crate::telemetry::spans::Spans;
use crate::workers::lease_tags::{LeaseTags, Use};
use crate::workers::sessions::{self, Message};

/// Messages to a worker that wait until it reads them; further ones are lost.
const WAITING: usize = 64;
/// Most numerics profiles of a worker.
const MAX_PROFILES: usize = 16;
/// Most leases that a worker may name when it reconnects.
const MAX_HELD: usize = 64;

/// Serves [`v1::workers_server::Workers`].
pub(crate) struct WorkersService(pub(crate) Arc<Coordinator>);

type Messages = mpsc::Sender<Outgoing>;

/// A message to a worker. Orders are encoded when they are sent, outside of the scheduler's lock.
enum Outgoing {
    WorkerCommand(WorkerCommand, Option<TraceId>),
    Welcome(v1::Welcome),
    Failure(Status),
}

impl Outgoing {
    fn encode(self, tags: &LeaseTags) -> Result<v1::CoordinatorMessage, Status> {
        match self {
            Self::WorkerCommand(order, trace) => Ok(wire::order(tags, order, trace)),
            Self::Welcome(welcome) => {
                let welcome = v1::coordinator_message::Message::Welcome(welcome);
                Ok(v1::CoordinatorMessage {
                    message: Some(welcome),
                })
            }
            Self::Failure(status) => Err(status),
        }
    }
}

#[tonic::async_trait]
impl v1::workers_server::Workers for WorkersService {
    type WorkStream = Pin<Box<dyn Stream<Item = Result<v1::CoordinatorMessage, Status>> + Send>>;

    async fn work(&self, r: Request<Streaming<v1::WorkerMessage>>) -> Answer<Self::WorkStream> {
        let caller = caller(&self.0, &r)?;
        let certificate = r
            .extensions()
            .get::<Peer>()
            .and_then(|peer| peer.certificate.clone());
        let first = first(r).await?;
        let (first, inbound) = (first.0.and_then(|m| m.message), first.1);
        let Some(FromWorker::Hello(hello)) = first else {
            return Err(Status::invalid_argument(
                "a worker's first message must be Hello",
            ));
        };
        check_hello(&hello)?;
        let certificate = certificate.as_ref().map(|shown| shown.as_ref().as_ref());
        let identity = self
            .0
            .identities
            .identify(&caller, certificate, &hello.identity);
        let identity = identity.map_err(|e| status::of_store(&e))?;
        let (out, outbound) = mpsc::channel(WAITING);
        let (answer, joined) = oneshot::channel();
        // A task of its own from the start: a worker that has joined must leave, even when this call is
        // dropped.
        tokio::spawn(session(
            Arc::clone(&self.0),
            (hello, identity),
            inbound,
            out,
            answer,
        ));
        let stopping =
            |_| Status::unavailable("the coordinator is stopping; try again when it is back");
        joined.await.map_err(stopping)??;
        let outbound = tokio_stream::wrappers::ReceiverStream::new(outbound);
        let tags = self.0.lease_tags.clone();
        Ok(Response::new(Box::pin(
            outbound.map(move |message| message.encode(&tags)),
        )))
    }

    type FetchSceneStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

    async fn fetch_scene(
        &self,
        r: Request<v1::FetchSceneRequest>,
    ) -> Answer<Self::FetchSceneStream> {
        let v1::FetchSceneRequest {
            digest,
            direct,
            fell_back,
        } = r.into_inner();
        let answer = self.fetch(&digest, direct, fell_back).await;
        self.noticing(answer, &digest, MissingBlob::Scene).await
    }

    type FetchPackStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

    async fn fetch_pack(&self, r: Request<v1::FetchPackRequest>) -> Answer<Self::FetchPackStream> {
        let v1::FetchPackRequest {
            digest,
            direct,
            fell_back,
        } = r.into_inner();
        let answer = self.fetch(&digest, direct, fell_back).await;
        // Receivers come this way, too. A worker that needs a lost pack computes it again.
        self.noticing(answer, &digest, MissingBlob::Receivers).await
    }

    type CrewStream = Pin<Box<dyn Stream<Item = Result<v1::CrewMessage, Status>> + Send>>;

    async fn crew(&self, r: Request<Streaming<v1::CrewMessage>>) -> Answer<Self::CrewStream> {
        let first = first(r).await?;
        let (first, inbound) = (first.0.and_then(|m| m.message), first.1);
        let Some(v1::crew_message::Message::Enter(v1::CrewEnter {
            lease: Some(lease),
            leads,
            phases,
        })) = first
        else {
            return Err(Status::invalid_argument(
                "a member's first message must be Enter, with a lease",
            ));
        };
        let to = if leads { Use::Hold } else { Use::Help };
        let lease = self
            .0
            .lease_tags
            .check(&lease, to)
            .map_err(|e| status::of_forged(&e))?;
        let (out, outbound) = mpsc::channel(crate::workers::crews::WAITING);
        let c = Arc::clone(&self.0);
        if leads {
            let (answer, opened) = oneshot::channel();
            // A task of its own from the start: a crew that is open must end, even when this call is dropped.
            // Nobody waits for the answer then.
            tokio::spawn(async move {
                // The outcomes of an earlier leader are counted on the disk.
                match blocking(&c, move |c| Ok(sessions::lead(c, lease))).await {
                    Ok(Some((room, told, follow_ups))) => {
                        later(&c, follow_ups);
                        let _ = answer.send(Ok(()));
                        crews::lead(c, room, told, phases, inbound, out).await;
                    }
                    Ok(None) => {
                        let _ =
                            answer.send(Err(Status::not_found("the lease is not valid any more")));
                    }
                    Err(s) => {
                        let _ = answer.send(Err(s));
                    }
                }
            });
            let stopping =
                |_| Status::unavailable("the coordinator is stopping; try again when it is back");
            opened.await.map_err(stopping)??;
        } else {
            let room = c.crews.find(&lease);
            let room =
                room.ok_or_else(|| Status::not_found("nobody leads a crew under this lease"))?;
            tokio::spawn(crews::help(c, room, inbound, out));
        }
        Ok(Response::new(Box::pin(
            tokio_stream::wrappers::ReceiverStream::new(outbound),
        )))
    }

    async fn put_result(
        &self,
        r: Request<Streaming<v1::ResultPart>>,
    ) -> Answer<v1::PutResultResponse> {
        let mut parts = r.into_inner();
        let first = parts.next().await.transpose()?.and_then(|p| p.part);
        let Some(v1::result_part::Part::Header(header)) = first else {
            return Err(Status::invalid_argument(
                "a result's first part must be its header",
            ));
        };
        if header.fell_back {
            self.0.metrics.fell_back("write");
        }
        if !header.staged.is_empty() {
            return self.commit_staged(header, parts).await;
        }
        let announced = announced(&self.0, &header)?;
        let begin = move |c: &Arc<Coordinator>| {
            commit::begin(c, &announced).map_err(|e| status::of_result(&e))
        };
        let spool = blocking(&self.0, begin).await?;
        let spool = filled(&self.0, spool, None, &mut parts, |part| match part.part {
            Some(v1::result_part::Part::Chunk(chunk)) => Ok(chunk),
            _ => Err(Status::invalid_argument(
                "after a result's header only chunks may come",
            )),
        })
        .await?;
        if spool.digest().map_err(|e| status::of_spool(&e))? != announced.digest {
            return Err(status::of_result(&ResultError::Digest));
        }
        // A large output waits on the disk until no other one is in memory, and others until few are checked.
        let large = large(&self.0, "", announced.bytes > MAX_LIGHT).await?;
        let spool = Mutex::new(spool);
        self.commit(large, announced, move |c, weight| {
            let bytes = spool
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .bytes(c)?;
            commit::put(c, &announced, &Origin::Sent(&bytes), weight)
        })
        .await
    }

    async fn stage_result(
        &self,
        r: Request<v1::StageResultRequest>,
    ) -> Answer<v1::StageResultResponse> {
        let v1::StageResultRequest {
            lease,
            sha256,
            bytes,
        } = r.into_inner();
        let staged = staged(&self.0, lease.as_ref(), &sha256, bytes)?;
        blocking(&self.0, move |c| {
            let address = commit::address(c, &staged).map_err(|e| status::of_blob(&e))?;
            Ok(Response::new(v1::StageResultResponse {
                address: address.map(wire::address),
            }))
        })
        .await
    }
}

impl WorkersService {
    /// A blob for a worker.
    async fn fetch(&self, digest: &[u8], direct: bool, fell_back: bool) -> Answer<ChunkStream> {
        let d = wire::digest(digest)?;
        if fell_back {
            self.0.metrics.fell_back("read");
        }
        let stream = if direct {
            stream_or_address(&self.0, d).await
        } else {
            stream_blob(&self.0, d).await
        };
        stream.map(Response::new)
    }

    /// Pauses the jobs that need a blob which turns out to be lost.
    async fn noticing(
        &self,
        answer: Answer<ChunkStream>,
        digest: &[u8],
        lacks: fn(Digest) -> MissingBlob,
    ) -> Answer<ChunkStream> {
        if let Err(refused) = &answer
            && matches!(
                refused.code(),
                tonic::Code::DataLoss | tonic::Code::NotFound
            )
        {
            let (lacks, why) = (lacks(wire::digest(digest)?), refused.message().to_owned());
            blocking(&self.0, move |c| {
                let (_, follow_ups) =
                    suspend::lost(c, lacks, &why).map_err(|e| status::of_store(&e))?;
                follow_ups.run(c);
                Ok(())
            })
            .await?;
        }
        answer
    }

    /// Commits an output that its worker has written by itself.
    async fn commit_staged(
        &self,
        header: v1::ResultHeader,
        mut parts: Streaming<v1::ResultPart>,
    ) -> Answer<v1::PutResultResponse> {
        let staged = staged(&self.0, header.lease.as_ref(), &header.staged, header.bytes)?;
        if parts.next().await.transpose()?.is_some() {
            return Err(Status::invalid_argument(
                "an output that is staged has no chunks",
            ));
        }
        let announced = announced(&self.0, &header)?;
        let large = large(&self.0, "", staged.bytes > MAX_LIGHT).await?;
        self.commit(large, announced, move |c, weight| {
            commit::put(c, &announced, &Origin::Staged(&staged), weight)
        })
        .await
    }

    /// Commits an output by `put`. One that unpacks to much is checked again, while no other large one is.
    async fn commit(
        &self,
        right: Option<Turn>,
        announced: UploadHeader,
        put: impl Fn(&Arc<Coordinator>, Weight) -> Result<(), ResultError> + Send + Sync + 'static,
    ) -> Answer<v1::PutResultResponse> {
        let put = Arc::new(put);
        let mut right = right;
        loop {
            let (put, held) = (Arc::clone(&put), right.take());
            let weight = if held.is_some() {
                Weight::Any
            } else {
                Weight::Light
            };
            let committed = blocking_one_of(&self.0, &self.0.checks, move |c| {
                let _held = held;
                match put(c, weight) {
                    Ok(()) => Ok(true),
                    Err(ResultError::Output(OutputError::Large)) => Ok(false),
                    Err(e) => Err(status::of_result(&e)),
                }
            });
            if committed.await? {
                return Ok(Response::new(v1::PutResultResponse {}));
            }
            tracing::debug!("the output of tile {} is large", announced.lease.tile);
            right = large(&self.0, "", true).await?;
        }
    }
}

/// Returns the first message of a stream that stays open, and the stream. Until its first message a stream
/// counts as idle.
async fn first<M>(r: Request<Streaming<M>>) -> Result<(Option<M>, Streaming<M>), Status> {
    let limit = r.extensions().get::<Peer>().map(|peer| peer.limits().idle);
    let mut inbound = r.into_inner();
    let first = match limit {
        None => inbound.next().await,
        Some(limit) => tokio::time::timeout(limit, inbound.next())
            .await
            .map_err(|_| {
                Status::deadline_exceeded(format!("no message within {limit:?}; call again"))
            })?,
    };
    Ok((first.transpose()?, inbound))
}

/// Returns the lease of a result, if it was given.
fn result_lease(c: &Coordinator, lease: Option<&v1::Lease>) -> Result<Lease, Status> {
    let lease = lease.ok_or_else(|| Status::invalid_argument("a result must name its lease"))?;
    c.lease_tags
        .check(lease, Use::Hold)
        .map_err(|e| status::of_forged(&e))
}

fn staged(
    c: &Coordinator,
    lease: Option<&v1::Lease>,
    sha256: &[u8],
    bytes: u64,
) -> Result<Staged, Status> {
    let lease = result_lease(c, lease)?;
    let sha256 = sha256.try_into();
    let sha256 = sha256.map_err(|_| Status::invalid_argument("a result's SHA-256 has 32 bytes"))?;
    Ok(Staged {
        lease,
        sha256,
        bytes,
    })
}

fn announced(c: &Coordinator, header: &v1::ResultHeader) -> Result<UploadHeader, Status> {
    Ok(UploadHeader {
        lease: result_lease(c, header.lease.as_ref())?,
        digest: wire::digest(&header.digest)?,
        bytes: header.bytes,
        samples: header.samples,
        millis: header.millis,
    })
}

fn check_hello(hello: &v1::Hello) -> Result<(), Status> {
    if hello.protocol != PROTOCOL {
        // The field is of version 2.
        let theirs = hello.protocol.max(1);
        return Err(Status::invalid_argument(format!(
            "this worker ({}) speaks version {theirs} of the protocol, the coordinator version {PROTOCOL}; \
             run the same version of sightline on both",
            hello.version
        )));
    }
    if hello.algorithm != ALGORITHM_VERSION {
        return Err(Status::invalid_argument(format!(
            "this worker ({}) samples by algorithm {}, the coordinator plans for {ALGORITHM_VERSION}; run \
             the same version of sightline on both",
            hello.version, hello.algorithm
        )));
    }
    let printable = |s: &str| s.chars().all(|c| !c.is_control() && c != '"' && c != '\\');
    if hello.name.is_empty() || hello.name.len() > MAX_WORKER_BYTES || !printable(&hello.name) {
        return Err(Status::invalid_argument(format!(
            "a worker's name must have 1 to {MAX_WORKER_BYTES} bytes and no quotes or control characters; \
             give another --name"
        )));
    }
    if hello.version.len() > MAX_IDENTIFIER_BYTES || !printable(&hello.version) {
        return Err(Status::invalid_argument(
            "a worker's version is too long or has control characters",
        ));
    }
    let fine = |p: &String| p.len() <= MAX_IDENTIFIER_BYTES && printable(p) && p.is_ascii();
    if hello.profiles.is_empty()
        || hello.profiles.len() > MAX_PROFILES
        || !hello.profiles.iter().all(fine)
    {
        return Err(Status::invalid_argument(format!(
            "a worker must name 1 to {MAX_PROFILES} numerics profiles in plain ASCII"
        )));
    }
    if hello.held.len() > MAX_HELD {
        return Err(Status::invalid_argument(
            "a worker names more leases than it can hold",
        ));
    }
    Ok(())
}

/// The outgoing half of a worker's stream.
struct WireOutbox(Messages, Arc<Spans>);

impl Outbox for WireOutbox {
    fn offer(&self, order: WorkerCommand) -> bool {
        let trace = match &order {
            WorkerCommand::Grant(grant) => self.1.trace(grant.lease.job),
            WorkerCommand::Help(help) => self.1.trace(help.lease.job),
            WorkerCommand::Revoke(_) | WorkerCommand::Time { .. } => None,
        };
        self.0
            .try_send(Outgoing::WorkerCommand(order, trace))
            .is_ok()
    }
}

/// A worker's stream, until it ends. Reports through `answer` whether the worker has joined.
async fn session(
    c: Arc<Coordinator>,
    (hello, (identity, shown)): (v1::Hello, (WorkerIdentity, Vec<u8>)),
    inbound: Streaming<v1::WorkerMessage>,
    out: Messages,
    answer: oneshot::Sender<Result<(), Status>>,
) {
    let name = hello.name.clone();
    // A lease of another store is none of this coordinator's: the worker stops its tile.
    let held = hello
        .held
        .iter()
        .filter_map(|lease| c.lease_tags.check(lease, Use::Hold).ok());
    let intro = Introduction {
        signature: signature(&hello.name, identity),
        name: hello.name,
        version: hello.version,
        instance: hello.instance,
        profiles: hello.profiles,
        held: held.collect(),
        helps: hello.helps,
    };
    let outbox = Box::new(WireOutbox(out.clone(), Arc::clone(&c.spans)));
    let joined = match sessions::join(&c, intro, outbox) {
        Ok((joined, follow_ups)) => {
            later(&c, follow_ups);
            joined
        }
        Err(e) => {
            let s = status::of_name(&e);
            tracing::warn!("worker {name} is refused: {}", s.message());
            // Nobody waits for the answer when the worker has gone.
            let _ = answer.send(Err(s));
            return;
        }
    };
    // A worker that has joined must leave, also when the coordinator stops in between.
    let leaving = Leaving {
        c: Arc::clone(&c),
        worker: joined.worker,
        name: name.clone(),
    };
    // As above.
    let _ = answer.send(Ok(()));
    listen(&c, &name, &joined, shown, inbound, &out).await;
    drop(leaving);
}

/// Lets a worker go when its session ends, however it ends.
struct Leaving {
    c: Arc<Coordinator>,
    worker: WorkerId,
    name: String,
}

impl Drop for Leaving {
    fn drop(&mut self) {
        later(&self.c, sessions::leave(&self.c, self.worker, &self.name));
    }
}

/// Welcomes a worker and passes its messages on, until its stream ends or a message cannot be acted on.
async fn listen(
    c: &Arc<Coordinator>,
    name: &str,
    joined: &Joined,
    identity: Vec<u8>,
    mut inbound: Streaming<v1::WorkerMessage>,
    out: &Messages,
) {
    let welcome = v1::Welcome {
        epoch: joined.epoch.0,
        lease_millis: c.leases.ttl.as_millis() as u32,
        kept: joined
            .kept
            .iter()
            .map(|lease| c.lease_tags.to_wire(lease, Use::Hold))
            .collect(),
        direct: c.blobs.direct().map(|direct| v1::Direct {
            ca: direct.authorities().to_vec(),
        }),
        identity,
    };
    if out.send(Outgoing::Welcome(welcome)).await.is_err() {
        return;
    }
    let worker = joined.worker;
    while let Some(received) = inbound.next().await {
        let received = match received {
            Ok(m) => m.message,
            Err(s) => {
                tracing::info!("the stream of worker {name} broke: {}", s.message());
                return;
            }
        };
        let Some(received) = received else { continue };
        let handled = match message(c, received) {
            Ok(None) => Ok(()),
            Ok(Some(message)) => {
                let failure = matches!(message, Message::Failed(_));
                let follow_ups = sessions::heard(c, worker, message);
                if failure && !follow_ups.is_empty() {
                    // Its next message waits until the failure is on record; nobody else does.
                    let waiting = Waiting::new(follow_ups);
                    blocking(c, |c| {
                        waiting.take().run(c);
                        Ok(())
                    })
                    .await
                } else {
                    later(c, follow_ups);
                    Ok(())
                }
            }
            Err(s) => Err(s),
        };
        if let Err(s) = handled {
            tracing::error!("worker {name}: {}", s.message());
            // The worker reconnects when its stream breaks; it may have gone already.
            let _ = out.send(Outgoing::Failure(s)).await;
            return;
        }
    }
}

/// A worker's message; `None` when it says nothing.
fn message(c: &Coordinator, message: FromWorker) -> Result<Option<Message>, Status> {
    let given = |lease, to| {
        c.lease_tags
            .check(&lease, to)
            .map_err(|e| status::of_forged(&e))
    };
    Ok(Some(match message {
        FromWorker::Hello(_) => {
            return Err(Status::invalid_argument("a second Hello on one stream"));
        }
        FromWorker::Want(w) => Message::Want(w.tiles),
        FromWorker::Draining(_) => Message::Draining,
        FromWorker::Progress(p) => {
            let Some(lease) = p.lease else {
                return Ok(None);
            };
            Message::Progress(Progress {
                lease: given(lease, Use::Hold)?,
                cells: p.cells,
                samples: p.samples,
            })
        }
        FromWorker::Failed(f) => {
            let Some(lease) = f.lease else {
                return Err(Status::invalid_argument("a failure must name its lease"));
            };
            let lease = given(lease, Use::Hold)?;
            Message::Failed(Failure {
                lease,
                reason: f.reason,
                infrastructure: f.infrastructure,
            })
        }
        FromWorker::Helped(h) => {
            let Some(lease) = h.lease else {
                return Ok(None);
            };
            Message::Helped(given(lease, Use::Help)?)
        }
        FromWorker::Timed(t) => Message::Timed(JobId(t.job), wire::times(t.times)),
    }))
}
