//! The `Jobs` service: uploads of scenes, control of jobs, and downloads of results.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures::{Stream, StreamExt as _};
use sightline_model::{JobSpec, PlannedJob, SceneFacts, SpecError};
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_records::ids::{Digest, JobId};
use sightline_scene::{KindRule, SurfaceKind};
use sightline_store::StoreError;
use sightline_traces::ids::parent_of;
use tokio::sync::{mpsc, watch};
use tonic::{Request, Response, Status, Streaming};

use super::authorize::{caller, own_job};
use super::blocking::{blocking, blocking_one_of, in_turn, large};
use super::spooling::filled;
use super::streams::{ChunkStream, stream_blob, stream_bytes};
use super::{Answer, status, wire};
use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::jobs::control::{self, JobError, JobFilter, Summary};
use crate::jobs::delete;
use crate::jobs::estimate;
use crate::jobs::submit::{self, Submission};
use crate::jobs::suspend;
use crate::jobs::suspensions::MissingBlob;
use crate::outputs::commit::MAX_LIGHT;
use crate::results::partial;
use crate::uploads::receivers;
use crate::uploads::scene_files;
use crate::uploads::scenes;
use crate::uploads::spool::Spool;

/// Maximum number of chunks in a scene: 64 GiB.
const MAX_CHUNKS: usize = 65_536;
/// Maximum number of rules of a scene file.
const MAX_RULES: usize = 256;
/// Maximum length of a scene file's name and of the pattern of a rule, in bytes.
const MAX_PATTERN_BYTES: usize = 1024;
/// Maximum number of jobs on a page.
const MAX_PAGE: u32 = 1000;
/// The priorities that jobs may have.
const PRIORITIES: std::ops::RangeInclusive<i32> = -1000..=1000;
/// Minimum time between two messages of `Watch`.
const WATCH_EVERY: Duration = Duration::from_millis(250);

/// Maximum time for which a watcher may leave a message unread.
const LONGEST_UNREAD: Duration = Duration::from_secs(60);

/// Serves [`v1::jobs_server::Jobs`].
pub(crate) struct JobsService(pub(crate) Arc<Coordinator>);

#[tonic::async_trait]
impl v1::jobs_server::Jobs for JobsService {
    async fn missing_chunks(
        &self,
        r: Request<v1::MissingChunksRequest>,
    ) -> Answer<v1::MissingChunksResponse> {
        let caller = caller(&self.0, &r)?;
        let asked = r.into_inner().digests;
        if asked.len() > MAX_CHUNKS {
            return Err(Status::invalid_argument(format!(
                "{} digests were given; give at most {MAX_CHUNKS} at once",
                asked.len()
            )));
        }
        let digests = asked
            .iter()
            .map(|d| wire::digest(d))
            .collect::<Result<Vec<_>, _>>()?;
        blocking(&self.0, move |c| {
            let missing =
                scenes::missing(c, caller.owner(), digests).map_err(|e| status::of_upload(&e))?;
            let digests = missing.iter().map(|d| d.to_vec()).collect();
            Ok(Response::new(v1::MissingChunksResponse { digests }))
        })
        .await
    }

    async fn put_chunks(&self, r: Request<Streaming<v1::Chunk>>) -> Answer<v1::PutChunksResponse> {
        let caller = caller(&self.0, &r)?;
        let mut stream = r.into_inner();
        let mut count = 0;
        while let Some(chunk) = stream.next().await {
            let chunk = chunk?;
            chunks::check(&chunk).map_err(|e| Status::data_loss(e.to_string()))?;
            let owner = caller.owner().to_owned();
            blocking(&self.0, move |c| {
                scenes::put_chunk(c, &owner, &chunk.data).map_err(|e| status::of_upload(&e))
            })
            .await?;
            count += 1;
        }
        Ok(Response::new(v1::PutChunksResponse { chunks: count }))
    }

    async fn put_scene(&self, r: Request<v1::PutSceneRequest>) -> Answer<v1::SceneInfo> {
        let caller = caller(&self.0, &r)?;
        let r = r.into_inner();
        let whole = wire::digest(&r.digest)?;
        if r.chunks.len() > MAX_CHUNKS {
            return Err(Status::invalid_argument(
                "the scene has too many chunks; split the scene",
            ));
        }
        let parts = r
            .chunks
            .iter()
            .map(|d| wire::digest(d))
            .collect::<Result<Vec<_>, _>>()?;
        let (owner, asked) = (caller.owner().to_owned(), parts.clone());
        blocking(&self.0, move |c| {
            scenes::check_sent(&c.records, &c.uploads, &owner, whole, &asked)
                .map_err(|e| status::of_upload(&e))
        })
        .await?;
        let large = large(&self.0, caller.owner(), is_large(&parts)).await?;
        blocking_one_of(&self.0, &self.0.uploads.files, move |c| {
            let _large = large;
            let record = scenes::put_scene(c, caller.owner(), whole, &parts)
                .map_err(|e| status::of_upload(&e))?;
            suspend::resume_jobs(c, MissingBlob::Scene(whole));
            Ok(Response::new(wire::scene(&record)))
        })
        .await
    }

    async fn put_receivers(
        &self,
        r: Request<v1::PutReceiversRequest>,
    ) -> Answer<v1::ReceiversInfo> {
        let caller = caller(&self.0, &r)?;
        let r = r.into_inner();
        let whole = wire::digest(&r.digest)?;
        if r.chunks.len() > MAX_CHUNKS {
            return Err(Status::invalid_argument(
                "the receivers have too many chunks; use several jobs",
            ));
        }
        let parts = r
            .chunks
            .iter()
            .map(|d| wire::digest(d))
            .collect::<Result<Vec<_>, _>>()?;
        let large = large(&self.0, caller.owner(), is_large(&parts)).await?;
        blocking_one_of(&self.0, &self.0.uploads.files, move |c| {
            let _large = large;
            let stored = receivers::put(c, caller.owner(), whole, &parts);
            let facts = stored.map_err(|e| status::of_upload(&e))?.facts;
            suspend::resume_jobs(c, MissingBlob::Receivers(whole));
            let (points, lights) = (facts.points, facts.lights);
            Ok(Response::new(v1::ReceiversInfo {
                digest: whole.to_vec(),
                points,
                lights,
            }))
        })
        .await
    }

    async fn put_scene_file(
        &self,
        r: Request<Streaming<v1::SceneFilePart>>,
    ) -> Answer<v1::SceneFileInfo> {
        use v1::scene_file_part::Part;
        let caller = caller(&self.0, &r)?;
        let mut parts = r.into_inner();
        let Some(Part::Header(header)) = parts.next().await.transpose()?.and_then(|p| p.part)
        else {
            return Err(Status::invalid_argument(
                "the first part of a file must be its header",
            ));
        };
        let chunk_of = |part: v1::SceneFilePart| match part.part {
            Some(Part::Chunk(chunk)) => Ok(chunk),
            _ => Err(Status::invalid_argument(
                "only chunks may follow the header of a file",
            )),
        };
        // From here on the header requires little memory, however long the upload lasts.
        let (name, rules) = (file_name(header.name)?, rules(header.rules)?);
        let first = parts.next().await.transpose()?.map(chunk_of).transpose()?;
        // The first chunk announces the length.
        let first =
            first.ok_or_else(|| Status::data_loss("the stream ended before the first chunk"))?;
        let spool = begin_file(&self.0, &caller, first.total).await?;
        let spool = filled(&self.0, spool, Some(first), &mut parts, chunk_of).await?;
        take_file(&self.0, caller, name, rules, spool)
            .await
            .map(Response::new)
    }

    async fn submit(&self, r: Request<v1::SubmitRequest>) -> Answer<v1::SubmitResponse> {
        let caller = caller(&self.0, &r)?;
        // An invalid trace header has no effect.
        let cause = r
            .metadata()
            .get("traceparent")
            .and_then(|text| parent_of(text.to_str().ok()?));
        let r = r.into_inner();
        blocking(&self.0, move |c| {
            let submission = Submission {
                cause,
                ..submission(c, &caller, r)?
            };
            let submitted = submit::submit(c, &submission).map_err(|e| status::of_submit(&e))?;
            let job = control::summary(c, submitted.id).map_err(|e| status::of_store(&e))?;
            let answer = v1::SubmitResponse {
                job: Some(wire::job(&job)),
                existing: submitted.existing,
            };
            Ok(Response::new(answer))
        })
        .await
    }

    async fn estimate(&self, r: Request<v1::SubmitRequest>) -> Answer<v1::EstimateResponse> {
        let caller = caller(&self.0, &r)?;
        let (user, r) = (caller.owner().to_owned(), r.into_inner());
        in_turn(&self.0, &self.0.results.lookups, &user, move |c, _| {
            let submission = draft(c, &caller, r)?;
            let estimate =
                estimate::estimate(c, &caller, &submission).map_err(|e| status::of_submit(&e))?;
            Ok(Response::new(wire::estimate(estimate)))
        })
        .await
    }

    async fn list(&self, r: Request<v1::ListRequest>) -> Answer<v1::ListResponse> {
        let caller = caller(&self.0, &r)?;
        let phases = r
            .get_ref()
            .states()
            .map(wire::phase)
            .collect::<Result<Vec<_>, _>>()?;
        let v1::ListRequest {
            limit,
            before,
            name,
            user,
            scene,
            ..
        } = r.into_inner();
        let scene = if scene.is_empty() {
            None
        } else {
            Some(wire::digest(&scene)?)
        };
        let filter = JobFilter {
            phases,
            name,
            user,
            scene,
        };
        if limit > MAX_PAGE {
            return Err(Status::invalid_argument(format!(
                "a page of {limit} jobs was requested; request at most {MAX_PAGE}"
            )));
        }
        let most = if limit == 0 { MAX_PAGE } else { limit } as usize;
        let before = JobId(if before == 0 { u64::MAX } else { before });
        blocking(&self.0, move |c| {
            let (list, older) = control::list(c, &caller, before, most, &filter)
                .map_err(|e| status::of_store(&e))?;
            Ok(Response::new(v1::ListResponse {
                jobs: list.iter().map(wire::job).collect(),
                older,
            }))
        })
        .await
    }

    async fn show(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        let summary = summary(&self.0, id).await?;
        let unable = self
            .0
            .dispatcher
            .read(|s| s.ineligible(id))
            .into_iter()
            .map(wire::ineligible)
            .collect();
        let teams = self
            .0
            .dispatcher
            .read(|s| s.tile_workers(id))
            .into_iter()
            .map(wire::team)
            .collect();
        Ok(Response::new(v1::Job {
            unable,
            teams,
            ..wire::job(&summary)
        }))
    }

    type WatchStream = Pin<Box<dyn Stream<Item = Result<v1::Job, Status>> + Send>>;

    async fn watch(&self, r: Request<v1::ShowRequest>) -> Answer<Self::WatchStream> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        // Subscribe before the first summary, so that the watcher does not miss a change in between.
        let changes = self.0.dispatcher.watch_job(id);
        let first = summary(&self.0, id).await?;
        let (out, stream) = mpsc::channel(4);
        tokio::spawn(follow(Arc::clone(&self.0), id, first, changes, out));
        Ok(Response::new(Box::pin(
            tokio_stream::wrappers::ReceiverStream::new(stream),
        )))
    }

    async fn cancel(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, control::cancel).await
    }

    async fn pause(&self, r: Request<v1::PauseRequest>) -> Answer<v1::Job> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        let now = r.get_ref().now;
        blocking(&self.0, move |c| {
            let job = control::pause(c, id, now).map_err(|e| status::of_job(&e))?;
            Ok(Response::new(wire::job(&job)))
        })
        .await
    }

    async fn resume(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, control::resume).await
    }

    async fn prioritize(&self, r: Request<v1::PrioritizeRequest>) -> Answer<v1::Job> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        let priority = checked_priority(r.get_ref().priority)?;
        blocking(&self.0, move |c| {
            let job = control::prioritize(c, id, priority).map_err(|e| status::of_job(&e))?;
            Ok(Response::new(wire::job(&job)))
        })
        .await
    }

    async fn retry(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, control::retry).await
    }

    async fn delete(&self, r: Request<v1::ShowRequest>) -> Answer<v1::Job> {
        self.turn(r, delete::delete).await
    }

    type FetchPartialStream = ChunkStream;

    async fn fetch_partial(&self, r: Request<v1::ShowRequest>) -> Answer<Self::FetchPartialStream> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        so_far(&self.0, caller(&self.0, &r)?.owner(), id)
            .await
            .map(Response::new)
    }

    type FetchStream = ChunkStream;

    async fn fetch(&self, r: Request<v1::ShowRequest>) -> Answer<Self::FetchStream> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        let result = blocking(&self.0, move |c| {
            control::result(&c.records, id).map_err(|e| status::of_job(&e))
        })
        .await?;
        stream_blob(&self.0, result).await.map(Response::new)
    }
}

impl JobsService {
    /// Changes a job and returns its summary.
    async fn turn(
        &self,
        r: Request<v1::ShowRequest>,
        change: fn(&Arc<Coordinator>, JobId) -> Result<Summary, JobError>,
    ) -> Answer<v1::Job> {
        let id = own_job(&self.0, &r, r.get_ref().job).await?;
        blocking(&self.0, move |c| {
            let job = change(c, id).map_err(|e| status::of_job(&e))?;
            Ok(Response::new(wire::job(&job)))
        })
        .await
    }
}

/// Returns true if the chunks form a large upload, which is checked while no other large upload is in memory.
fn is_large(parts: &[Digest]) -> bool {
    parts.len() as u64 > MAX_LIGHT / chunks::CHUNK_BYTES as u64
}

/// Starts a scene file with the given number of bytes, if the limits of its sender permit it.
///
/// # Errors
/// INVALID_ARGUMENT if the file is too long. RESOURCE_EXHAUSTED if the unfinished uploads of the sender, or
/// of all senders, would have too many bytes.
pub(super) async fn begin_file(
    c: &Arc<Coordinator>,
    caller: &Caller,
    bytes: u64,
) -> Result<Spool, Status> {
    let owner = caller.owner().to_owned();
    let begin = move |c: &Arc<Coordinator>| {
        scene_files::begin(c, &owner, bytes).map_err(|e| status::of_file(&e))
    };
    blocking(c, begin).await
}

/// Returns the name of a scene file, or an error if the name is too long.
pub(super) fn file_name(name: String) -> Result<String, Status> {
    if name.len() > MAX_PATTERN_BYTES {
        return Err(Status::invalid_argument(format!(
            "the name of the file has {} bytes; give a name of at most {MAX_PATTERN_BYTES} bytes",
            name.len()
        )));
    }
    Ok(name)
}

/// Returns the rules of a scene file's header.
fn rules(given: Vec<v1::KindRule>) -> Result<Vec<KindRule>, Status> {
    if given.len() > MAX_RULES {
        return Err(Status::invalid_argument(format!(
            "{} rules were given; a scene file has at most {MAX_RULES}",
            given.len()
        )));
    }
    let rule = |r: v1::KindRule| {
        if r.glob.len() > MAX_PATTERN_BYTES {
            return Err(Status::invalid_argument(format!(
                "the pattern of a rule has {} bytes; give a pattern of at most {MAX_PATTERN_BYTES} bytes",
                r.glob.len()
            )));
        }
        let kind = SurfaceKind::from_name(&r.kind).ok_or_else(|| {
            Status::invalid_argument(format!(
                "{:?} is not a kind of triangles; give opaque, see-through, occluder-only, moving or doors",
                r.kind
            ))
        })?;
        KindRule::new(kind, &r.glob).map_err(|e| Status::invalid_argument(e.to_string()))
    };
    given.into_iter().map(rule).collect()
}

/// Reads a scene from a file.
pub(super) async fn take_file(
    c: &Arc<Coordinator>,
    caller: Caller,
    name: String,
    rules: Vec<KindRule>,
    spool: Spool,
) -> Result<v1::SceneFileInfo, Status> {
    let large = large(c, caller.owner(), spool.announced() > MAX_LIGHT).await?;
    blocking_one_of(c, &c.uploads.files, move |c| {
        let _large = large;
        let taken = scene_files::take(c, caller.owner(), &name, spool, rules);
        let (record, warnings) = taken.map_err(|e| status::of_file(&e))?;
        suspend::resume_jobs(c, MissingBlob::Scene(record.digest));
        Ok(v1::SceneFileInfo {
            scene: Some(wire::scene(&record)),
            warnings,
        })
    })
    .await
}

/// Streams the result of a job. If the job has not ended, streams its partial result.
pub(super) async fn so_far(
    c: &Arc<Coordinator>,
    user: &str,
    id: JobId,
) -> Result<ChunkStream, Status> {
    match blocking(c, move |c| {
        control::result(&c.records, id)
            .map(Some)
            .or_else(|e| none_yet(&e))
    })
    .await?
    {
        Some(result) => stream_blob(c, result).await,
        None => {
            let made = move |c: &Arc<Coordinator>, is_gone: &(dyn Fn() -> bool + Sync)| {
                partial::so_far(c, id, is_gone).map_err(|e| status::of_partial(&e))
            };
            let bytes = in_turn(c, &c.results.questions, user, made).await?;
            stream_bytes(c, bytes).await
        }
    }
}

/// Converts the error of a job without a result into `None`.
fn none_yet(e: &JobError) -> Result<Option<Digest>, Status> {
    match e {
        JobError::NoResult { .. } => Ok(None),
        e => Err(status::of_job(e)),
    }
}

async fn summary(c: &Arc<Coordinator>, id: JobId) -> Result<Summary, Status> {
    blocking(c, move |c| {
        control::summary(c, id).map_err(|e| status::of_store(&e))
    })
    .await
}

/// Checks a priority from the wire.
fn checked_priority(priority: i32) -> Result<i32, Status> {
    if PRIORITIES.contains(&priority) {
        return Ok(priority);
    }
    let (least, most) = (PRIORITIES.start(), PRIORITIES.end());
    Err(Status::invalid_argument(format!(
        "the priority {priority} is not between {least} and {most}"
    )))
}

/// Creates a submission on a stored scene.
fn submission(
    c: &Coordinator,
    caller: &Caller,
    r: v1::SubmitRequest,
) -> Result<Submission, Status> {
    let submission = draft(c, caller, r)?;
    let scene = submission.job.spec().scene;
    scenes::known(&c.records, caller, scene).map_err(|e| status::of_store(&e))?;
    Ok(submission)
}

/// Creates a submission from the wire. Without a view box, uses the bounds of the scene, which must then be
/// stored.
fn draft(c: &Coordinator, caller: &Caller, r: v1::SubmitRequest) -> Result<Submission, Status> {
    let spec = r
        .spec
        .as_ref()
        .ok_or_else(|| Status::invalid_argument("the job has no specification"))?;
    let scene = wire::digest(&spec.scene)?;
    let record = match scenes::known(&c.records, caller, scene) {
        Ok(record) => Some(record),
        // A client may request an estimate before it uploads the scene.
        Err(StoreError::UnknownScene { .. }) => None,
        Err(e) => return Err(status::of_store(&e)),
    };
    let mut spec = spec.clone();
    if let Some(v1::job_spec::Task::Ambient(ambient)) = &mut spec.task {
        let digest = wire::digest(&ambient.receivers)?;
        let stored = receivers::known(c, caller, digest).map_err(|e| status::of_receivers(&e))?;
        let (bytes, points, lights) = (stored.bytes, stored.facts.points, stored.facts.lights);
        let (bytes, points, lights) = (Some(bytes), Some(points), Some(lights));
        *ambient = v1::Ambient {
            receivers: digest.to_vec(),
            bytes,
            points,
            lights,
        };
    }
    let mut facts = SceneFacts {
        triangles: record.map_or(0, |record| record.triangles),
        ..SceneFacts::default()
    };
    let mut read = JobSpec::from_message(&spec, &facts);
    if read == Err(SpecError::NO_VIEW_BOX) {
        scenes::known(&c.records, caller, scene).map_err(|e| status::of_store(&e))?;
        // The bounds require a pass over the triangles, so they are computed only if they are needed.
        facts.bounds = Some(scenes::bounds(c, &scene).map_err(|e| status::of_facts(&e))?);
        read = JobSpec::from_message(&spec, &facts);
    }
    let invalid = |e: &dyn std::fmt::Display| Status::invalid_argument(e.to_string());
    let spec = read.map_err(|e| invalid(&e))?;
    let job = Arc::new(PlannedJob::new(spec).map_err(|e| invalid(&e))?);
    let priority = checked_priority(r.priority)?;
    let owner = caller.owner().to_owned();
    // Users share the workers evenly, so only a caller who sees all data may name another user.
    let user = if caller.sees_all() && !r.user.is_empty() {
        r.user
    } else {
        owner.clone()
    };
    Ok(Submission {
        request_id: r.request_id,
        name: r.name,
        owner,
        user,
        priority,
        job,
        cause: None,
    })
}

/// Sends a job's summary after every change, until the job ends or the client stops reading.
async fn follow(
    c: Arc<Coordinator>,
    id: JobId,
    first: Summary,
    mut changes: watch::Receiver<bool>,
    out: mpsc::Sender<Result<v1::Job, Status>>,
) {
    let mut last = first;
    loop {
        let sent = tokio::time::timeout(LONGEST_UNREAD, out.send(Ok(wire::job(&last)))).await;
        // The client stopped reading, or the job has ended.
        if !matches!(sent, Ok(Ok(()))) || last.ended() {
            return;
        }
        // A change is sent after a pause, the end of the job immediately. No summary is computed during the
        // pause.
        let quiet = tokio::time::sleep(WATCH_EVERY);
        tokio::pin!(quiet);
        let mut quiet_over = false;
        let mut news = false;
        loop {
            tokio::select! {
                () = &mut quiet, if !quiet_over => quiet_over = true,
                () = out.closed() => return,
                changed = changes.changed() => match changed {
                    Ok(()) => news = true,
                    Err(_) => return,
                },
            }
            if !news || !quiet_over && !*changes.borrow_and_update() {
                continue;
            }
            news = false;
            match summary(&c, id).await {
                Ok(now) if now == last => {}
                Ok(now) => {
                    last = now;
                    break;
                }
                Err(s) => {
                    // The send fails if the client stopped reading.
                    let _ = out.send(Err(s)).await;
                    return;
                }
            }
        }
    }
}
