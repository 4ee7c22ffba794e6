//! The `Workers` service: one stream a worker, scenes and packs out, results in.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::{Stream, StreamExt as _};
use sightline_model::TileOutput;
use sightline_model::codec::{self, MAX_UNPACKED};
use sightline_model::{ALGORITHM_VERSION, Method};
use sightline_proto::chunks::Assembler;
use sightline_proto::v1;
use sightline_proto::v1::worker_message::Message as FromWorker;
use sightline_viewcells::TileKind;
use tokio::sync::mpsc;
use tonic::{Request, Response, Status, Streaming};

use crate::assemble::{AssembleError, Parts, expected_nodes};
use crate::core::{Coordinator, now_ms};
use crate::jobs_service::{blocking, digest};
use crate::scheduler::{MAX_ATTEMPTS, MAX_FAULTS, Scheduler, Slot};
use crate::status;
use crate::store::{
    BlobError, CommitOutcome, Digest, JobPhase, JobRecord, JobState, MAX_IDENTIFIER_BYTES, MAX_WORKER_BYTES,
    TileResult, TileState, TileStats,
};
use crate::streams::stream_blob;

/// Different workers a tile must fail on before it is set aside.
const WORKERS_TO_FAIL: u32 = 3;
/// Time between two attempts to put a result together that the disk has no space for.
const SPACE_EVERY: Duration = Duration::from_secs(10);

/// Serves [`v1::workers_server::Workers`].
pub(crate) struct WorkersService(pub(crate) Arc<Coordinator>);

type Answer<T> = Result<Response<T>, Status>;
type Messages = mpsc::Sender<Result<v1::CoordinatorMessage, Status>>;

#[tonic::async_trait]
impl v1::workers_server::Workers for WorkersService {
    type WorkStream = Pin<Box<dyn Stream<Item = Result<v1::CoordinatorMessage, Status>> + Send>>;

    async fn work(&self, r: Request<Streaming<v1::WorkerMessage>>) -> Answer<Self::WorkStream> {
        let mut inbound = r.into_inner();
        let first = inbound.next().await.transpose()?.and_then(|m| m.message);
        let Some(FromWorker::Hello(hello)) = first else {
            return Err(Status::invalid_argument("a worker's first message must be Hello"));
        };
        check_hello(&hello)?;
        let (out, outbound) = mpsc::channel(64);
        let coordinator = Arc::clone(&self.0);
        tokio::spawn(async move { session(coordinator, hello, inbound, out).await });
        Ok(Response::new(Box::pin(tokio_stream::wrappers::ReceiverStream::new(outbound))))
    }

    type FetchSceneStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

    async fn fetch_scene(&self, r: Request<v1::FetchSceneRequest>) -> Answer<Self::FetchSceneStream> {
        let d = digest(&r.into_inner().digest)?;
        stream_blob(&self.0, d).await.map(Response::new)
    }

    type FetchPackStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

    async fn fetch_pack(&self, r: Request<v1::FetchPackRequest>) -> Answer<Self::FetchPackStream> {
        let d = digest(&r.into_inner().digest)?;
        stream_blob(&self.0, d).await.map(Response::new)
    }

    async fn put_result(&self, r: Request<Streaming<v1::ResultPart>>) -> Answer<v1::PutResultResponse> {
        let mut parts = r.into_inner();
        let first = parts.next().await.transpose()?.and_then(|p| p.part);
        let Some(v1::result_part::Part::Header(header)) = first else {
            return Err(Status::invalid_argument("a result's first part must be its header"));
        };
        let mut whole = Assembler::new(MAX_UNPACKED);
        while let Some(part) = parts.next().await {
            match part?.part {
                Some(v1::result_part::Part::Chunk(chunk)) => {
                    whole.push(&chunk).map_err(|e| Status::data_loss(e.to_string()))?;
                }
                _ => return Err(Status::invalid_argument("after a result's header only chunks may come")),
            }
        }
        let bytes = whole.finish().map_err(|e| Status::data_loss(e.to_string()))?;
        blocking(&self.0, move |c| {
            c.commit(&header, &bytes)?;
            c.assemble_ready();
            c.pump();
            c.changed();
            Ok(Response::new(v1::PutResultResponse {}))
        })
        .await
    }
}

fn check_hello(hello: &v1::Hello) -> Result<(), Status> {
    if hello.algorithm != ALGORITHM_VERSION {
        return Err(Status::invalid_argument(format!(
            "this worker ({}) samples by algorithm {}, the coordinator plans for {ALGORITHM_VERSION}; run the same version of sightline on both",
            hello.version, hello.algorithm
        )));
    }
    let printable = |s: &str| s.chars().all(|c| !c.is_control() && c != '"' && c != '\\');
    if hello.name.is_empty() || hello.name.len() > MAX_WORKER_BYTES || !printable(&hello.name) {
        return Err(Status::invalid_argument(format!(
            "a worker's name must have 1 to {MAX_WORKER_BYTES} bytes and no quotes or control characters; give another --name"
        )));
    }
    let fine = |p: &String| p.len() <= MAX_IDENTIFIER_BYTES && printable(p) && p.is_ascii();
    if hello.profiles.is_empty() || hello.profiles.len() > 16 || !hello.profiles.iter().all(fine) {
        return Err(Status::invalid_argument("a worker must name 1 to 16 numerics profiles in plain ASCII"));
    }
    if hello.held.len() > 64 {
        return Err(Status::invalid_argument("a worker names more leases than it can hold"));
    }
    Ok(())
}

/// One worker's stream, until it ends.
async fn session(
    c: Arc<Coordinator>,
    hello: v1::Hello,
    mut inbound: Streaming<v1::WorkerMessage>,
    out: Messages,
) {
    use v1::coordinator_message::Message;
    let (sender, joining) = (out.clone(), hello.clone());
    let joined = blocking(&c, move |c| {
        let mut scheduler = c.lock();
        Ok((scheduler.join(&joining, sender), scheduler.epoch()))
    });
    // Fails only when the coordinator is going down.
    let Ok(((number, kept), epoch)) = joined.await else { return };
    let welcome = v1::Welcome { epoch, lease_millis: c.config.lease.as_millis() as u32, kept };
    tracing::info!("worker {} has come, with {}", hello.name, hello.profiles.join(", "));
    let welcome = v1::CoordinatorMessage { message: Some(Message::Welcome(welcome)) };
    if out.send(Ok(welcome)).await.is_ok() {
        c.changed();
        while let Some(message) = inbound.next().await {
            let message = match message {
                Ok(m) => m.message,
                Err(s) => {
                    tracing::info!("the stream of worker {} broke: {}", hello.name, s.message());
                    break;
                }
            };
            let Some(message) = message else { continue };
            let name = hello.name.clone();
            let handled = blocking(&c, move |c| c.heard(number, &name, message)).await;
            if let Err(s) = handled {
                tracing::error!("worker {}: {}", hello.name, s.message());
                // The worker comes back when its stream breaks.
                let _ = out.send(Err(s)).await;
                break;
            }
        }
    }
    // Fails only when the coordinator is going down.
    let _ = blocking(&c, move |c| {
        c.lock().leave(number, Instant::now());
        Ok(())
    })
    .await;
    tracing::info!("worker {} has gone", hello.name);
    // What a draining worker left goes to another at the next tick of the clock.
    c.changed();
}

impl Coordinator {
    /// Acts on what a worker says.
    fn heard(self: &Arc<Self>, worker: u64, name: &str, message: FromWorker) -> Result<(), Status> {
        match message {
            FromWorker::Hello(_) => return Err(Status::invalid_argument("a second Hello on one stream")),
            FromWorker::Want(w) => self.lock().want(worker, w.tiles),
            FromWorker::Draining(_) => self.lock().drain(worker),
            FromWorker::Progress(p) => {
                // A stale lease was revoked when it became so; the worker will have heard.
                if self.lock().renew(&p).is_ok() {
                    self.changed();
                }
                return Ok(());
            }
            FromWorker::Failed(f) => {
                self.failed(name, &f)?;
                self.assemble_ready();
            }
            FromWorker::Timed(t) => {
                self.lock().timed(worker, &t, &*self.store).map_err(|e| status::of_store(&e))?;
            }
        }
        self.pump();
        self.changed();
        Ok(())
    }

    /// A tile failed: counted, and set aside when it has failed often enough.
    fn failed(&self, worker: &str, f: &v1::TileFailed) -> Result<(), Status> {
        let Some(lease) = f.lease else {
            return Err(Status::invalid_argument("a failure must name its lease"));
        };
        let of_store = |e| status::of_store(&e);
        let mut scheduler = self.lock();
        if !scheduler.release(&lease) {
            return Ok(());
        }
        tracing::warn!("tile {} of job {} failed on {worker}: {}", lease.tile, lease.job, f.reason);
        if f.infrastructure {
            let Some(job) = scheduler.jobs.get_mut(&lease.job) else { return Ok(()) };
            let slot = &mut job.slots[lease.tile as usize];
            slot.faults += 1;
            if slot.faults < MAX_FAULTS {
                let wait = Duration::from_secs(1 << slot.faults.saturating_sub(1).min(6));
                slot.not_before = Some(Instant::now() + wait);
                return Ok(());
            }
        }
        let on = self.store.fail_tile(lease.job, lease.tile, worker, &f.reason).map_err(of_store)?;
        let Some(job) = scheduler.jobs.get_mut(&lease.job) else { return Ok(()) };
        let slot = &mut job.slots[lease.tile as usize];
        slot.attempts += 1;
        if on < WORKERS_TO_FAIL && slot.attempts < MAX_ATTEMPTS {
            return Ok(());
        }
        // Those that need it first: interrupted half-way, the tile is still open and fails again.
        for lost in job.lost_with(lease.tile).into_iter().rev() {
            if !matches!(job.slots[lost as usize].state, TileState::Open) {
                continue;
            }
            let tile = &job.plan.tiles[lost as usize];
            let (digest, bytes) =
                self.stand_in(&job.spec, &job.lattice, tile).map_err(|e| status::internal(&e.to_string()))?;
            let reasons = vec![format!("tile {} failed on {on} workers: {}", lease.tile, f.reason)];
            self.store.set_aside_tile(lease.job, lost, digest, bytes, &reasons).map_err(of_store)?;
            tracing::error!("tile {lost} of job {} is set aside: its cells will show everything", lease.job);
            job.slots[lost as usize].state = TileState::SetAside { digest, bytes, reasons };
            job.slots[lost as usize].lease = None;
        }
        Ok(())
    }

    /// Checks a tile's output and commits it: done if not done.
    fn commit(&self, header: &v1::ResultHeader, bytes: &[u8]) -> Result<(), Status> {
        let lease = header.lease.ok_or_else(|| Status::invalid_argument("a result must name its lease"))?;
        let offered: Digest = digest(&header.digest)?;
        if *blake3::hash(bytes).as_bytes() != offered {
            return Err(Status::data_loss("the result that arrived is not the one announced; send it again"));
        }
        if header.bytes != bytes.len() as u64 {
            return Err(Status::invalid_argument("the result has another length than announced"));
        }
        let (triangles, kind, expected, exact) = {
            let scheduler = self.lock();
            let job = scheduler.jobs.get(&lease.job).ok_or_else(|| {
                Status::failed_precondition(format!("job {} has ended or is not known here", lease.job))
            })?;
            let tile = job.plan.tiles.get(lease.tile as usize);
            let tile = tile.ok_or_else(|| Status::invalid_argument("the job has no such tile"))?;
            let scene = self.store.scene(&job.spec.scene).map_err(|e| status::of_store(&e))?;
            let nodes = expected_nodes(&job.spec.division, &job.lattice, &tile.cell, tile.depth);
            (scene.map_or(0, |s| s.triangles), tile.kind, nodes, job.spec.method != Method::Aggressive)
        };
        let output = codec::check(bytes, triangles).map_err(|e| Status::invalid_argument(e.to_string()))?;
        let cells = match (&output, kind) {
            (TileOutput::Cells(sets), TileKind::Leaf) => {
                if expected.is_some_and(|nodes| nodes != sets.nodes) {
                    return Err(Status::invalid_argument(
                        "the output's cells are not those of the tile's grid",
                    ));
                }
                if sets.cells.iter().any(|c| c.decision.is_some() != exact) {
                    return Err(Status::invalid_argument(
                        "the output's cells are not decided by the job's method",
                    ));
                }
                sets.cells.len() as u64
            }
            (TileOutput::Pack(_), TileKind::Face(_) | TileKind::Separator(_)) => 0,
            _ => return Err(Status::invalid_argument("the output is not of the tile's kind")),
        };
        drop(output);
        // The blob first: a record may only name what is there.
        self.blobs.put(bytes).map_err(|e| {
            if matches!(e, BlobError::NoSpace { .. }) {
                self.lock().pause_leasing(Instant::now());
            }
            status::of_blob(&e)
        })?;
        let mut scheduler = self.lock();
        // A job with the same output that ended a moment ago may have taken it away again.
        if !self.blobs.has(&offered).map_err(|e| status::of_blob(&e))? {
            self.blobs.put(bytes).map_err(|e| status::of_blob(&e))?;
        }
        let worker = scheduler.jobs.get(&lease.job).and_then(|j| {
            let held = j.slots[lease.tile as usize].lease.as_ref()?;
            scheduler.workers.get(&held.worker).map(|w| w.name.clone())
        });
        let stats = TileStats {
            samples: header.samples,
            cells,
            millis: header.millis,
            worker: worker.unwrap_or_default(),
        };
        let result = TileResult { digest: offered, bytes: header.bytes, stats: stats.clone() };
        let outcome = self.store.commit_tile(lease.job, lease.tile, result);
        match outcome.map_err(|e| status::of_store(&e))? {
            CommitOutcome::Committed => {
                if let Some(job) = scheduler.jobs.get_mut(&lease.job) {
                    let slot = &mut job.slots[lease.tile as usize];
                    slot.state = TileState::Done { digest: offered, bytes: header.bytes, stats };
                    slot.lease = None;
                }
                Ok(())
            }
            CommitOutcome::AlreadySame => {
                scheduler.release(&lease);
                Ok(())
            }
            CommitOutcome::Conflict { kept, offered } => {
                scheduler.release(&lease);
                let hex = |d: Digest| blake3::Hash::from_bytes(d).to_hex();
                tracing::error!(
                    "TWO RESULTS for tile {} of job {}: {} stays, {} is kept out. A worker's memory, driver or program \
                     differs from its profile; find out which before trusting this job",
                    lease.tile,
                    lease.job,
                    hex(kept),
                    hex(offered)
                );
                Err(Status::aborted(
                    "another result for this tile is already there; this worker's machine needs a look",
                ))
            }
        }
    }

    /// Starts putting together every job whose tiles are all there.
    pub(crate) fn assemble_ready(self: &Arc<Self>) {
        let mut ready = Vec::new();
        {
            let mut scheduler = self.lock();
            for (id, job) in &mut scheduler.jobs {
                let runs = matches!(job.record.state, JobState::Queued | JobState::Running);
                let waits = job.no_space_until.is_some_and(|until| Instant::now() < until);
                if runs && !job.assembling && !waits && job.complete() {
                    job.assembling = true;
                    ready.push((
                        *id,
                        Parts {
                            spec: job.spec.clone(),
                            lattice: job.lattice,
                            plan: job.plan.clone(),
                            profile: job.record.profile.clone().unwrap_or_default(),
                            slots: job.slots.clone(),
                        },
                    ));
                }
            }
        }
        for (id, parts) in ready {
            let this = Arc::clone(self);
            std::thread::spawn(move || this.finish(id, &parts));
        }
    }

    /// Puts a job's result together and ends it.
    fn finish(&self, id: u64, parts: &Parts) {
        let leaf = |n: u32| &parts.slots[n as usize].state;
        let assembled = if parts.plan.leaves().all(|n| matches!(leaf(n), TileState::SetAside { .. })) {
            Err("every tile failed; `sightline show` and the workers' logs say why".to_owned())
        } else {
            // A panic must not leave the job half ended.
            match catch_unwind(AssertUnwindSafe(|| self.assemble(parts))) {
                Ok(Err(AssembleError::Blob(e @ BlobError::NoSpace { .. }))) => {
                    tracing::error!(
                        "the result of job {id} waits for space and is tried again every 10 s: {e}"
                    );
                    let mut scheduler = self.lock();
                    if let Some(job) = scheduler.jobs.get_mut(&id) {
                        job.assembling = false;
                        job.no_space_until = Some(Instant::now() + SPACE_EVERY);
                    }
                    // There is none for what workers would send, either.
                    scheduler.pause_leasing(Instant::now());
                    return;
                }
                Ok(r) => r.map_err(|e| e.to_string()),
                Err(_) => Err("putting it together panicked; the coordinator's log says where".to_owned()),
            }
        };
        let mut scheduler = self.lock();
        // Cancelled or paused in the meantime: the result stays as a blob and is found again by its content.
        let Some(job) = scheduler.jobs.get_mut(&id) else { return };
        job.assembling = false;
        if !matches!(job.record.state, JobState::Queued | JobState::Running) {
            return;
        }
        let ended = match assembled {
            Ok((digest, bytes)) => self.store.finish_job(id, digest, bytes, now_ms()),
            Err(e) => {
                tracing::error!("job {id} has no result: {e}");
                let failed = JobState::Failed { reason: e };
                self.store.set_job_state(id, &[JobPhase::Queued, JobPhase::Running], failed, now_ms())
            }
        };
        match ended {
            Ok(record) => {
                if let JobState::Done { bytes, .. } = record.state {
                    tracing::info!("job {id} is done, {bytes} bytes");
                }
                scheduler.jobs.remove(&id);
                let whole = matches!(record.state, JobState::Done { .. })
                    && parts.slots.iter().all(|s| matches!(s.state, TileState::Done { .. }));
                if whole {
                    self.tidy(&scheduler, id, &parts.slots);
                }
            }
            Err(e) => tracing::error!("job {id} cannot be ended: {e}"),
        }
        drop(scheduler);
        self.changed();
    }

    /// Removes the tile outputs of a finished job that no job shares which may still need them: one that has not ended,
    /// or that can be retried. The result has all that is in them.
    fn tidy(&self, scheduler: &Scheduler, finished: u64, slots: &[Slot]) {
        let digest = |s: &TileState| match s {
            TileState::Done { digest, .. } | TileState::SetAside { digest, .. } => Some(*digest),
            TileState::Open => None,
        };
        let mut kept: BTreeSet<Digest> =
            scheduler.jobs.values().flat_map(|j| &j.slots).filter_map(|s| digest(&s.state)).collect();
        let ended = self.store.jobs().and_then(|jobs| {
            let retriable = |j: &JobRecord| {
                j.id != finished && matches!(j.state.phase(), JobPhase::Cancelled | JobPhase::Failed)
            };
            for job in jobs.iter().filter(|j| retriable(j)) {
                kept.extend(self.store.tiles(job.id)?.iter().filter_map(|t| digest(&t.state)));
            }
            Ok(())
        });
        if let Err(e) = ended {
            tracing::warn!("the tile outputs of job {finished} are kept: {e}");
            return;
        }
        for d in slots.iter().filter_map(|s| digest(&s.state)).filter(|d| !kept.contains(d)) {
            if let Err(e) = self.blobs.remove(&d) {
                tracing::warn!("{e}");
            }
        }
    }
}
