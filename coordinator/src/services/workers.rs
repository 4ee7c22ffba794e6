//! The `Workers` service: a stream per worker, downloads of scenes and packs, and uploads of tile outputs.

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

use super::authorize::caller;
use super::blocking::{blocking, blocking_one_of, large, later};
use super::connections::Peer;
use super::spooling::filled;
use super::streams::{ChunkStream, stream_blob, stream_or_address};
use super::{Answer, crews, status, wire};
use crate::coordinator::Coordinator;
use crate::dispatch::follow_ups::Waiting;
use crate::dispatch::outbox::Outbox;
use crate::jobs::suspend;
use crate::jobs::suspensions::MissingBlob;
use crate::outputs::commit::{self, MAX_LIGHT, OutputBytes, ResultError, SizeLimit, UploadHeader};
use crate::quota::QueueTurn;
use crate::telemetry::spans::Spans;
use crate::workers::lease_tags::{LeaseTags, LeaseUse};
use crate::workers::sessions::{self, Message};

/// Maximum number of messages that wait for a worker. Further messages are lost.
const WAITING: usize = 64;
/// Maximum number of numerics profiles of a worker.
const MAX_PROFILES: usize = 16;
/// Maximum number of leases that a worker may name when it reconnects.
const MAX_HELD: usize = 64;

/// Serves [`v1::workers_server::Workers`].
pub(crate) struct WorkersService(pub(crate) Arc<Coordinator>);

type Messages = mpsc::Sender<Outgoing>;

/// A message to a worker. Commands are encoded when they are sent, outside the scheduler's lock.
enum Outgoing {
    WorkerCommand(WorkerCommand, Option<TraceId>),
    Welcome(v1::Welcome),
    Failure(Status),
}

impl Outgoing {
    fn encode(self, tags: &LeaseTags) -> Result<v1::CoordinatorMessage, Status> {
        match self {
            Self::WorkerCommand(command, trace) => Ok(wire::command(tags, command, trace)),
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
                "the first message of a worker must be Hello",
            ));
        };
        check_hello(&hello)?;
        let certificate = certificate.as_ref().map(|shown| shown.as_ref().as_ref());
        let identity = self
            .0
            .workers
            .identities
            .identify(&caller, certificate, &hello.identity);
        let identity = identity.map_err(|e| status::of_store(&e))?;
        let (out, outbound) = mpsc::channel(WAITING);
        let (answer, joined) = oneshot::channel();
        // The session needs its own task from the start: a worker that has joined must leave, even if this
        // call is dropped.
        tokio::spawn(session(
            Arc::clone(&self.0),
            hello,
            identity,
            inbound,
            out,
            answer,
        ));
        let stopping =
            |_| Status::unavailable("the coordinator is stopping; try again after its restart");
        joined.await.map_err(stopping)??;
        let outbound = tokio_stream::wrappers::ReceiverStream::new(outbound);
        let tags = self.0.workers.lease_tags.clone();
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
        // Receivers are downloaded this way, too. A worker that needs a lost pack computes the pack again.
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
                "the first message of a crew member must be Enter, with a lease",
            ));
        };
        let to = if leads {
            LeaseUse::Hold
        } else {
            LeaseUse::Help
        };
        let lease = self
            .0
            .workers
            .lease_tags
            .check(&lease, to)
            .map_err(|e| status::of_forged(&e))?;
        let (out, outbound) = mpsc::channel(crate::workers::crews::WAITING);
        let c = Arc::clone(&self.0);
        if leads {
            let (answer, opened) = oneshot::channel();
            // The stream needs its own task from the start: an open crew must end, even if this call is
            // dropped and its answer is lost.
            tokio::spawn(async move {
                // Counting the outcomes of an earlier leader reads the disk.
                match blocking(&c, move |c| Ok(sessions::lead(c, lease))).await {
                    Ok(Some((channel, messages, follow_ups))) => {
                        later(&c, follow_ups);
                        let _ = answer.send(Ok(()));
                        crews::lead(c, channel, messages, phases, inbound, out).await;
                    }
                    Ok(None) => {
                        let _ = answer.send(Err(Status::not_found(
                            "the lease has ended, is a check, or has another leader",
                        )));
                    }
                    Err(s) => {
                        let _ = answer.send(Err(s));
                    }
                }
            });
            let stopping =
                |_| Status::unavailable("the coordinator is stopping; try again after its restart");
            opened.await.map_err(stopping)??;
        } else {
            let channel = c.workers.crews.find(&lease);
            let channel = channel
                .ok_or_else(|| Status::not_found("no worker leads a crew with this lease"))?;
            tokio::spawn(crews::help(c, channel, inbound, out));
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
                "the first part of a result must be its header",
            ));
        };
        if header.fell_back {
            self.0.telemetry.metrics.fell_back("write");
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
                "only chunks may follow the header of a result",
            )),
        })
        .await?;
        if spool.digest().map_err(|e| status::of_spool(&e))? != announced.digest {
            return Err(status::of_result(&ResultError::Digest));
        }
        // A large output waits on the disk until no other large output is in memory. Smaller outputs wait
        // until few are being checked.
        let large = large(&self.0, "", announced.bytes > MAX_LIGHT).await?;
        let spool = Mutex::new(spool);
        self.commit(large, announced, move |c, limit| {
            let bytes = spool
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .bytes(&*c.blobs)?;
            commit::put(c, &announced, &OutputBytes::Sent(&bytes), limit)
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
    /// Streams a blob to a worker.
    async fn fetch(&self, digest: &[u8], direct: bool, fell_back: bool) -> Answer<ChunkStream> {
        let d = wire::digest(digest)?;
        if fell_back {
            self.0.telemetry.metrics.fell_back("read");
        }
        let stream = if direct {
            stream_or_address(&self.0, d).await
        } else {
            stream_blob(&self.0, d).await
        };
        stream.map(Response::new)
    }

    /// Pauses the jobs that need a blob if `answer` shows that the blob is lost.
    async fn noticing(
        &self,
        answer: Answer<ChunkStream>,
        digest: &[u8],
        missing: fn(Digest) -> MissingBlob,
    ) -> Answer<ChunkStream> {
        if let Err(refused) = &answer
            && matches!(
                refused.code(),
                tonic::Code::DataLoss | tonic::Code::NotFound
            )
        {
            let (missing, why) = (missing(wire::digest(digest)?), refused.message().to_owned());
            blocking(&self.0, move |c| {
                let (_, follow_ups) =
                    suspend::suspend_jobs(c, missing, &why).map_err(|e| status::of_store(&e))?;
                follow_ups.run(c);
                Ok(())
            })
            .await?;
        }
        answer
    }

    /// Commits an output that its worker has written directly to the blob store.
    async fn commit_staged(
        &self,
        header: v1::ResultHeader,
        mut parts: Streaming<v1::ResultPart>,
    ) -> Answer<v1::PutResultResponse> {
        let staged = staged(&self.0, header.lease.as_ref(), &header.staged, header.bytes)?;
        if parts.next().await.transpose()?.is_some() {
            return Err(Status::invalid_argument(
                "a staged output must not have chunks",
            ));
        }
        let announced = announced(&self.0, &header)?;
        let large = large(&self.0, "", staged.bytes > MAX_LIGHT).await?;
        self.commit(large, announced, move |c, limit| {
            commit::put(c, &announced, &OutputBytes::Staged(&staged), limit)
        })
        .await
    }

    /// Commits an output with `put`. An output that is large when unpacked is checked again, while no other
    /// large output is checked.
    async fn commit(
        &self,
        turn: Option<QueueTurn>,
        announced: UploadHeader,
        put: impl Fn(&Arc<Coordinator>, SizeLimit) -> Result<(), ResultError> + Send + Sync + 'static,
    ) -> Answer<v1::PutResultResponse> {
        let put = Arc::new(put);
        let mut turn = turn;
        loop {
            let (put, current_turn) = (Arc::clone(&put), turn.take());
            let limit = if current_turn.is_some() {
                SizeLimit::Any
            } else {
                SizeLimit::Light
            };
            let committed = blocking_one_of(&self.0, &self.0.uploads.checks, move |c| {
                let _turn = current_turn;
                match put(c, limit) {
                    Ok(()) => Ok(true),
                    Err(ResultError::Output(OutputError::Large)) => Ok(false),
                    Err(e) => Err(status::of_result(&e)),
                }
            });
            if committed.await? {
                return Ok(Response::new(v1::PutResultResponse {}));
            }
            tracing::debug!("the output of tile {} is large", announced.lease.tile);
            turn = large(&self.0, "", true).await?;
        }
    }
}

/// Returns the first message of a stream that stays open, and the stream. Until its first message, the stream
/// has the time limit of an idle connection.
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

/// Returns the lease that a result names, after a check of the lease's tag.
fn result_lease(c: &Coordinator, lease: Option<&v1::Lease>) -> Result<Lease, Status> {
    let lease = lease.ok_or_else(|| Status::invalid_argument("a result must name its lease"))?;
    c.workers
        .lease_tags
        .check(lease, LeaseUse::Hold)
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
    let sha256 = sha256
        .map_err(|_| Status::invalid_argument("the SHA-256 of a result must have 32 bytes"))?;
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
        // Version 1 of the protocol does not have this field.
        let theirs = hello.protocol.max(1);
        return Err(Status::invalid_argument(format!(
            "this worker ({}) uses version {theirs} of the protocol, but the coordinator uses \
             version {PROTOCOL}; run the same version of sightline on both",
            hello.version
        )));
    }
    if hello.algorithm != ALGORITHM_VERSION {
        return Err(Status::invalid_argument(format!(
            "this worker ({}) uses version {} of the algorithm, but the coordinator uses version \
             {ALGORITHM_VERSION}; run the same version of sightline on both",
            hello.version, hello.algorithm
        )));
    }
    let printable = |s: &str| s.chars().all(|c| !c.is_control() && c != '"' && c != '\\');
    if hello.name.is_empty() || hello.name.len() > MAX_WORKER_BYTES || !printable(&hello.name) {
        return Err(Status::invalid_argument(format!(
            "the name of a worker must have 1 to {MAX_WORKER_BYTES} bytes and no quotes or control \
             characters; give another --name"
        )));
    }
    if hello.version.len() > MAX_IDENTIFIER_BYTES || !printable(&hello.version) {
        return Err(Status::invalid_argument(
            "the version of a worker is too long or has quotes or control characters",
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
        return Err(Status::invalid_argument(format!(
            "a worker that reconnects may name at most {MAX_HELD} leases"
        )));
    }
    Ok(())
}

/// The outbox of a worker on the wire.
struct WireOutbox(Messages, Arc<Spans>);

impl Outbox for WireOutbox {
    fn offer(&self, command: WorkerCommand) -> bool {
        let trace = match &command {
            WorkerCommand::Grant(grant) => self.1.trace(grant.lease.job),
            WorkerCommand::Help(help) => self.1.trace(help.lease.job),
            WorkerCommand::Revoke(_) | WorkerCommand::Time { .. } => None,
        };
        self.0
            .try_send(Outgoing::WorkerCommand(command, trace))
            .is_ok()
    }
}

/// Serves a worker's stream until it ends. Reports through `answer` if the worker has joined.
async fn session(
    c: Arc<Coordinator>,
    hello: v1::Hello,
    identified: (WorkerIdentity, Vec<u8>),
    inbound: Streaming<v1::WorkerMessage>,
    out: Messages,
    answer: oneshot::Sender<Result<(), Status>>,
) {
    let (identity, shown) = identified;
    let name = hello.name.clone();
    // This coordinator did not grant a lease of another store, so the worker stops its tile.
    let held = hello
        .held
        .iter()
        .filter_map(|lease| c.workers.lease_tags.check(lease, LeaseUse::Hold).ok());
    let intro = Introduction {
        signature: signature(&hello.name, identity),
        name: hello.name,
        version: hello.version,
        instance: hello.instance,
        profiles: hello.profiles,
        held: held.collect(),
        helps: hello.helps,
    };
    let outbox = Box::new(WireOutbox(out.clone(), Arc::clone(&c.telemetry.spans)));
    let joined = match sessions::join(&c, intro, outbox) {
        Ok((joined, follow_ups)) => {
            later(&c, follow_ups);
            joined
        }
        Err(e) => {
            let s = status::of_name(&e);
            tracing::warn!("worker {name} is rejected: {}", s.message());
            // The send fails if the worker has disconnected.
            let _ = answer.send(Err(s));
            return;
        }
    };
    // A worker that has joined must leave, also if the coordinator stops in between.
    let leaving = Leaving {
        c: Arc::clone(&c),
        worker: joined.worker,
        name: name.clone(),
    };
    // The send fails if the worker has disconnected.
    let _ = answer.send(Ok(()));
    listen(&c, &name, &joined, shown, inbound, &out).await;
    drop(leaving);
}

/// A guard that removes a worker from the scheduler when its session ends for any reason.
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

/// Welcomes a worker and handles its messages, until its stream ends or a message is invalid.
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
        lease_millis: c.config.leases.ttl.as_millis() as u32,
        kept: joined
            .kept
            .iter()
            .map(|lease| c.workers.lease_tags.to_wire(lease, LeaseUse::Hold))
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
                    // Only the next message of this worker waits until the failure is recorded.
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
            // The worker reconnects after its stream breaks. It may have disconnected already.
            let _ = out.send(Outgoing::Failure(s)).await;
            return;
        }
    }
}

/// Converts a worker's message. Returns `None` for a message without content.
fn message(c: &Coordinator, message: FromWorker) -> Result<Option<Message>, Status> {
    let given = |lease, to| {
        c.workers
            .lease_tags
            .check(&lease, to)
            .map_err(|e| status::of_forged(&e))
    };
    Ok(Some(match message {
        FromWorker::Hello(_) => {
            return Err(Status::invalid_argument(
                "a worker sent a second Hello on one stream; send only one Hello per stream",
            ));
        }
        FromWorker::Want(w) => Message::Want(w.tiles),
        FromWorker::Draining(_) => Message::Draining,
        FromWorker::Progress(p) => {
            let Some(lease) = p.lease else {
                return Ok(None);
            };
            Message::Progress(Progress {
                lease: given(lease, LeaseUse::Hold)?,
                cells: p.cells,
                samples: p.samples,
            })
        }
        FromWorker::Failed(f) => {
            let Some(lease) = f.lease else {
                return Err(Status::invalid_argument("a failure must name its lease"));
            };
            let lease = given(lease, LeaseUse::Hold)?;
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
            Message::Helped(given(lease, LeaseUse::Help)?)
        }
        FromWorker::Timed(t) => Message::Timed(JobId(t.job), wire::times(t.times)),
    }))
}
