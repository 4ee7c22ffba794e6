//! The `Jobs` service: scenes in, jobs, results out.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures::{Stream, StreamExt as _};
use prost::Message as _;
use sightline_model::JobSpec;
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_scene::Scene;
use tonic::{Request, Response, Status, Streaming};

use crate::core::{Coordinator, now_ms};
use crate::scene_facts::FactsError;
use crate::scheduler::Job;
use crate::status;
use crate::store::{BlobError, Digest, JobPhase, JobState, NewJob, SceneRecord, StoreError};
use crate::streams::{ChunkStream, stream_blob};

/// Chunks of one scene: 64 GiB.
const MAX_CHUNKS: usize = 65_536;
/// Shortest time between two messages of Watch.
const WATCH_EVERY: Duration = Duration::from_millis(250);

/// Serves [`v1::jobs_server::Jobs`].
pub(crate) struct JobsService(pub(crate) Arc<Coordinator>);

type Answer<T> = Result<Response<T>, Status>;

/// Runs what touches the disk off the async threads.
pub(crate) async fn blocking<T: Send + 'static>(
    c: &Arc<Coordinator>,
    f: impl FnOnce(&Arc<Coordinator>) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    let c = Arc::clone(c);
    tokio::task::spawn_blocking(move || f(&c)).await.map_err(|e| match e.is_cancelled() {
        true => Status::unavailable("the coordinator is ending; ask again when it is back"),
        false => status::internal(&format!("a request panicked: {e}")),
    })?
}

/// A digest from the wire.
pub(crate) fn digest(bytes: &[u8]) -> Result<Digest, Status> {
    bytes.try_into().map_err(|_| {
        Status::invalid_argument(format!(
            "a digest of {} bytes was given; give the 32 of BLAKE3",
            bytes.len()
        ))
    })
}

#[tonic::async_trait]
impl v1::jobs_server::Jobs for JobsService {
    async fn missing_chunks(
        &self,
        r: Request<v1::MissingChunksRequest>,
    ) -> Answer<v1::MissingChunksResponse> {
        let asked = r.into_inner().digests;
        if asked.len() > MAX_CHUNKS {
            return Err(Status::invalid_argument(format!(
                "{} digests were asked for; ask for at most {MAX_CHUNKS} at once",
                asked.len()
            )));
        }
        let digests = asked.iter().map(|d| digest(d)).collect::<Result<Vec<_>, _>>()?;
        blocking(&self.0, move |c| {
            let mut missing = Vec::new();
            for d in digests {
                if !c.blobs.has(&d).map_err(|e| status::of_blob(&e))? {
                    missing.push(d.to_vec());
                }
            }
            Ok(Response::new(v1::MissingChunksResponse { digests: missing }))
        })
        .await
    }

    async fn put_chunks(&self, r: Request<Streaming<v1::Chunk>>) -> Answer<v1::PutChunksResponse> {
        let mut stream = r.into_inner();
        let mut count = 0;
        while let Some(chunk) = stream.next().await {
            let chunk = chunk?;
            chunks::check(&chunk).map_err(|e| Status::data_loss(e.to_string()))?;
            blocking(&self.0, move |c| c.blobs.put_unsynced(&chunk.data).map_err(|e| status::of_blob(&e)))
                .await?;
            count += 1;
        }
        Ok(Response::new(v1::PutChunksResponse { chunks: count }))
    }

    async fn put_scene(&self, r: Request<v1::PutSceneRequest>) -> Answer<v1::SceneInfo> {
        let r = r.into_inner();
        let whole = digest(&r.digest)?;
        if r.chunks.len() > MAX_CHUNKS {
            return Err(Status::invalid_argument("the scene has too many chunks; split it"));
        }
        let parts = r.chunks.iter().map(|d| digest(d)).collect::<Result<Vec<_>, _>>()?;
        blocking(&self.0, move |c| c.put_scene(whole, &parts)).await.map(Response::new)
    }

    async fn submit(&self, r: Request<v1::SubmitRequest>) -> Answer<v1::SubmitResponse> {
        let r = r.into_inner();
        if r.request_id.is_empty() {
            return Err(Status::invalid_argument(
                "request_id is empty; choose one, so that submitting again is safe",
            ));
        }
        blocking(&self.0, move |c| {
            let answer = c.submit(&r)?;
            c.pump();
            c.changed();
            Ok(Response::new(answer))
        })
        .await
    }

    async fn list(&self, _: Request<v1::ListRequest>) -> Answer<v1::ListResponse> {
        blocking(&self.0, |c| {
            let jobs = c.store.jobs().map_err(|e| status::of_store(&e))?;
            let jobs = jobs.iter().map(|j| c.summary(j.id)).collect::<Result<_, _>>();
            Ok(Response::new(v1::ListResponse { jobs: jobs.map_err(|e| status::of_store(&e))? }))
        })
        .await
    }

    async fn show(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        let id = r.into_inner().job;
        blocking(&self.0, move |c| c.summary(id).map_err(|e| status::of_store(&e))).await.map(Response::new)
    }

    type WatchStream = Pin<Box<dyn Stream<Item = Result<v1::Job, Status>> + Send>>;

    async fn watch(&self, r: Request<v1::ShowRequest>) -> Answer<Self::WatchStream> {
        let id = r.into_inner().job;
        // Before the first look, so that a change between the two is not missed.
        let mut changes = self.0.changes.subscribe();
        let first = blocking(&self.0, move |c| c.summary(id).map_err(|e| status::of_store(&e))).await?;
        let (out, stream) = tokio::sync::mpsc::channel(4);
        let c = Arc::clone(&self.0);
        tokio::spawn(async move {
            let mut last = first;
            let ended = |j: &v1::Job| {
                matches!(j.state(), v1::JobState::Done | v1::JobState::Failed | v1::JobState::Cancelled)
            };
            loop {
                if out.send(Ok(last.clone())).await.is_err() || ended(&last) {
                    return;
                }
                // News is told at most every so often, the end at once.
                let quiet = tokio::time::sleep(WATCH_EVERY);
                tokio::pin!(quiet);
                let (mut quiet_over, mut news) = (false, false);
                while !(quiet_over && news) {
                    tokio::select! {
                        () = &mut quiet, if !quiet_over => {
                            quiet_over = true;
                            continue;
                        }
                        () = out.closed() => return,
                        changed = changes.changed() => if changed.is_err() { return },
                    }
                    let c = Arc::clone(&c);
                    match blocking(&c, move |c| c.summary(id).map_err(|e| status::of_store(&e))).await {
                        Ok(now) => {
                            news |= now != last;
                            last = now;
                            if ended(&last) {
                                break;
                            }
                        }
                        Err(s) => {
                            // Nobody listens any more when this fails.
                            let _ = out.send(Err(s)).await;
                            return;
                        }
                    }
                }
            }
        });
        Ok(Response::new(Box::pin(tokio_stream::wrappers::ReceiverStream::new(stream))))
    }

    async fn cancel(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        use JobPhase::{Paused, Queued, Running};
        self.turn(r, &[Queued, Running, Paused], JobState::Cancelled).await
    }

    async fn pause(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, &[JobPhase::Queued, JobPhase::Running], JobState::Paused).await
    }

    async fn resume(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, &[JobPhase::Paused], JobState::Queued).await
    }

    async fn retry(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        let id = r.into_inner().job;
        blocking(&self.0, move |c| {
            let of_store = |e: StoreError| status::of_store(&e);
            // Under the scheduler's lock, so that the job does not end in between.
            let mut scheduler = c.lock();
            let job = || c.store.job(id).and_then(|r| r.ok_or(StoreError::UnknownJob { job: id }));
            let before = job().map_err(of_store)?;
            if !before.state.phase().ended() {
                // It is at work; asking twice is no mistake.
                drop(scheduler);
                return c.summary(id).map_err(of_store);
            }
            // Or it would be open in the store, and nobody would work on it.
            let tiles = c.store.tiles(id).map_err(of_store)?;
            Job::of(before, tiles).map_err(Status::failed_precondition)?;
            c.store.reopen_tiles(id).map_err(of_store)?;
            let record = job().map_err(of_store)?;
            if !record.state.phase().ended() {
                let tiles = c.store.tiles(id).map_err(of_store)?;
                scheduler.take_up(record, tiles).map_err(Status::failed_precondition)?;
                tracing::info!("job {id} is tried again");
            }
            drop(scheduler);
            c.pump();
            c.assemble_ready();
            c.changed();
            c.summary(id).map_err(of_store)
        })
        .await
        .map(Response::new)
    }

    type FetchStream = ChunkStream;

    async fn fetch(&self, r: Request<v1::ShowRequest>) -> Answer<Self::FetchStream> {
        let id = r.into_inner().job;
        let result = blocking(&self.0, move |c| {
            let job = c.store.job(id).map_err(|e| status::of_store(&e))?;
            match job.ok_or(StoreError::UnknownJob { job: id }).map_err(|e| status::of_store(&e))?.state {
                JobState::Done { result, .. } => Ok(result),
                state => Err(Status::failed_precondition(format!(
                    "job {id} is {} and has no result yet; `sightline watch {id}` follows it",
                    state.phase()
                ))),
            }
        })
        .await?;
        stream_blob(&self.0, result).await.map(Response::new)
    }
}

impl JobsService {
    /// Moves a job to another state.
    async fn turn(
        &self,
        r: Request<v1::ShowRequest>,
        from: &'static [JobPhase],
        to: JobState,
    ) -> Answer<v1::Job> {
        let id = r.into_inner().job;
        blocking(&self.0, move |c| {
            // Under the scheduler's lock, so that no tile is leased or committed in between.
            let mut scheduler = c.lock();
            let record = c.store.set_job_state(id, from, to, now_ms()).map_err(|e| status::of_store(&e))?;
            tracing::info!("job {id} is {}", record.state.phase());
            if !matches!(record.state, JobState::Queued | JobState::Running) {
                scheduler.revoke_job(id);
            }
            if record.state.phase().ended() {
                scheduler.jobs.remove(&id);
            } else if let Some(job) = scheduler.jobs.get_mut(&id) {
                job.record = record;
            }
            drop(scheduler);
            c.pump();
            c.assemble_ready();
            c.changed();
            c.summary(id).map_err(|e| status::of_store(&e))
        })
        .await
        .map(Response::new)
    }
}

impl Coordinator {
    fn put_scene(&self, whole: Digest, parts: &[Digest]) -> Result<v1::SceneInfo, Status> {
        let info = |r: &SceneRecord| v1::SceneInfo {
            digest: r.digest.to_vec(),
            triangles: r.triangles,
            objects: r.objects,
        };
        let of_blob = |e| status::of_blob(&e);
        // A scene of one chunk has its chunk's digest, and chunks are not synced: it is written again below.
        if let Some(known) = self.store.scene(&whole).map_err(|e| status::of_store(&e))?
            && parts != [whole]
            && self.blobs.has(&whole).map_err(of_blob)?
        {
            match self.blobs.read(&whole) {
                Ok(_) => return Ok(info(&known)),
                // Removed, so that its chunks are missing and the client sends them again: workers would ask for the
                // damaged scene for ever.
                Err(e @ BlobError::Damaged { .. }) => {
                    tracing::warn!("{e}; it is uploaded again now");
                    self.blobs.remove(&whole).map_err(of_blob)?;
                }
                Err(e) => return Err(of_blob(e)),
            }
        }
        let mut writer = self.blobs.put_stream().map_err(of_blob)?;
        for part in parts {
            if !self.blobs.has(part).map_err(of_blob)? {
                return Err(Status::failed_precondition(
                    "a chunk of the scene is not here yet; ask MissingChunks which, put it, and try again",
                ));
            }
            match self.blobs.read(part) {
                Ok(bytes) => writer.append(&bytes).map_err(of_blob)?,
                // Chunks are not synced to the disk: after a power failure one may be there in part.
                Err(e @ BlobError::Damaged { .. }) => {
                    tracing::warn!("{e}; it is uploaded again now");
                    self.blobs.remove(part).map_err(of_blob)?;
                    return Err(Status::failed_precondition(
                        "a chunk of the scene was damaged and is gone; ask MissingChunks which, put it, and try again",
                    ));
                }
                Err(e) => return Err(of_blob(e)),
            }
        }
        writer.finish(Some(&whole)).map_err(|e| match e {
            e @ BlobError::NoSpace { .. } => status::of_blob(&e),
            e => Status::invalid_argument(e.to_string()),
        })?;
        let bytes = self.blobs.read(&whole).map_err(of_blob)?;
        let scene = Scene::from_blob("uploaded scene", &bytes).map_err(|e| {
            // What is not a scene is not kept.
            if let Err(e) = self.blobs.remove(&whole) {
                tracing::warn!("{e}");
            }
            Status::invalid_argument(e.to_string())
        })?;
        self.remember(whole, &scene);
        let record = SceneRecord {
            digest: whole,
            bytes: bytes.len() as u64,
            triangles: scene.len(),
            objects: scene.objects().len() as u32,
        };
        let answer = info(&record);
        self.store.record_scene(record).map_err(|e| status::of_store(&e))?;
        // The whole is kept; its chunks have done their work. One chunk alone is the whole.
        for part in parts.iter().filter(|p| **p != whole) {
            if let Err(e) = self.blobs.remove(part) {
                tracing::warn!("{e}");
            }
        }
        Ok(answer)
    }

    fn submit(&self, r: &v1::SubmitRequest) -> Result<v1::SubmitResponse, Status> {
        let of_store = |e: StoreError| status::of_store(&e);
        let wire = r.spec.as_ref().ok_or_else(|| Status::invalid_argument("the job has no specification"))?;
        let scene = digest(&wire.scene)?;
        self.store
            .scene(&scene)
            .and_then(|s| s.ok_or(StoreError::UnknownScene { scene }))
            .map_err(of_store)?;
        let bounds = if wire.view_box.is_empty() {
            let facts = self.facts(&scene).map_err(|e| match e {
                FactsError::Blob(e) => status::of_blob(&e),
                FactsError::Scene(e) => status::internal(&e.to_string()),
            })?;
            Some([facts.bounds.min, facts.bounds.max])
        } else {
            None
        };
        let bad = |e: &dyn std::fmt::Display| Status::invalid_argument(e.to_string());
        let spec = JobSpec::from_proto(wire, bounds).map_err(|e| bad(&e))?;
        let (_, plan) = spec.plan().map_err(|e| bad(&e))?;
        spec.moved_by_rounding().map_err(|e| bad(&e))?;
        let job = NewJob {
            key: spec.key(),
            request_id: r.request_id.clone(),
            name: r.name.clone(),
            scene,
            spec: spec.to_proto().encode_to_vec(),
            tiles: plan.tiles.len() as u32,
            submitted_at_ms: now_ms(),
        };
        // Under the lock, so that a job is in the scheduler before anybody can ask for it.
        let mut scheduler = self.lock();
        let mut submitted = self.store.submit_job(job.clone()).map_err(of_store)?;
        let result_of = |id: u64| {
            let state = self.store.job(id).map_err(of_store)?.map(|j| j.state);
            Ok::<_, Status>(if let Some(JobState::Done { result, .. }) = state { Some(result) } else { None })
        };
        if submitted.existing
            && let Some(result) = result_of(submitted.id)?
        {
            // Reading all of a large result takes its time, in which everybody else goes on.
            drop(scheduler);
            let lost = self.blobs.open_checked(&result).err();
            scheduler = self.lock();
            if let Some(e) = lost
                && result_of(submitted.id)? == Some(result)
            {
                // Its tile outputs are gone, so the job is begun again from nothing.
                tracing::warn!("the result of job {} is lost ({e}); it is baked again", submitted.id);
                self.blobs.remove(&result).map_err(|e| status::of_blob(&e))?;
                self.store.delete_job(submitted.id).map_err(of_store)?;
                submitted = self.store.submit_job(job).map_err(of_store)?;
            }
        }
        if !submitted.existing {
            let record = self
                .store
                .job(submitted.id)
                .and_then(|r| r.ok_or(StoreError::UnknownJob { job: submitted.id }));
            let tiles = self.store.tiles(submitted.id).map_err(of_store)?;
            scheduler.take_up(record.map_err(of_store)?, tiles).map_err(|e| status::internal(&e))?;
            tracing::info!("job {} ({:?}) is submitted, {} tiles", submitted.id, r.name, plan.tiles.len());
        }
        drop(scheduler);
        let job = self.summary(submitted.id).map_err(of_store)?;
        Ok(v1::SubmitResponse { job: Some(job), existing: submitted.existing })
    }
}
