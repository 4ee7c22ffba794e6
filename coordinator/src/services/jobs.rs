//! The `Jobs` service: scenes in, jobs, results out.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures::{Stream, StreamExt as _};
use sightline_model::{JobSpec, PlannedJob, SceneFacts, SpecError};
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_records::ids::{Digest, JobId};
use sightline_scene::{Kind, Rule};
use sightline_store::StoreError;
use sightline_traces::ids::parent_of;
use tokio::sync::{mpsc, watch};
use tonic::{Request, Response, Status, Streaming};

use super::blocking::{blocking, blocking_one_of, in_turn, large};
use super::guard::{caller, own_job};
use super::spooling::filled;
use super::streams::{ChunkStream, stream_blob, stream_bytes};
use super::{Answer, status, wire};
use crate::access::Caller;
use crate::jobs::control::{self, JobError, JobFilter, Summary};
use crate::jobs::delete;
use crate::jobs::estimate;
use crate::jobs::resume;
use crate::jobs::submit::{self, Submission};
use crate::outputs::commit::MAX_LIGHT;
use crate::results::partial;
use crate::state::{Coordinator, MissingBlob};
use crate::uploads::receivers;
use crate::uploads::scene_files;
use crate::uploads::scenes;
use crate::uploads::spool::Spool;

/// Chunks of one scene: 64 GiB.
const MAX_CHUNKS: usize = 65_536;
/// Maximum number of rules of a scene file.
const MAX_RULES: usize = 256;
/// Maximum length of a scene file's name and of the pattern of a rule, in bytes.
const MAX_PATTERN_BYTES: usize = 1024;
/// Most jobs of a page.
const MAX_PAGE: u32 = 1000;
/// The priorities that jobs may have.
const PRIORITIES: std::ops::RangeInclusive<i32> = -1000..=1000;
/// Shortest time between two messages of Watch.
const WATCH_EVERY: Duration = Duration::from_millis(250);

/// How long a watcher may leave a message unread.
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
                "the scene has too many chunks; split it",
            ));
        }
        let parts = r
            .chunks
            .iter()
            .map(|d| wire::digest(d))
            .collect::<Result<Vec<_>, _>>()?;
        let (owner, asked) = (caller.owner().to_owned(), parts.clone());
        blocking(&self.0, move |c| {
            scenes::check_sent(c, &owner, whole, &asked).map_err(|e| status::of_upload(&e))
        })
        .await?;
        let large = large(&self.0, caller.owner(), is_large(&parts)).await?;
        blocking_one_of(&self.0, &self.0.files, move |c| {
            let _large = large;
            let record = scenes::put_scene(c, caller.owner(), whole, &parts)
                .map_err(|e| status::of_upload(&e))?;
            resume::back(c, MissingBlob::Scene(whole));
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
        blocking_one_of(&self.0, &self.0.files, move |c| {
            let _large = large;
            let stored = receivers::put(c, caller.owner(), whole, &parts);
            let facts = stored.map_err(|e| status::of_upload(&e))?.facts;
            resume::back(c, MissingBlob::Receivers(whole));
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
                "a file's first part must be its header",
            ));
        };
        let chunk_of = |part: v1::SceneFilePart| match part.part {
            Some(Part::Chunk(chunk)) => Ok(chunk),
            _ => Err(Status::invalid_argument(
                "after a file's header only chunks may come",
            )),
        };
        // From here on the header takes little memory, however long the file takes.
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
        // What is no header of a trace leads to nothing.
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
        in_turn(&self.0, &self.0.lookups, &user, move |c, _| {
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
        let wanted = JobFilter {
            phases,
            name,
            user,
            scene,
        };
        if limit > MAX_PAGE {
            return Err(Status::invalid_argument(format!(
                "a page of {limit} jobs was asked for; ask for at most {MAX_PAGE}"
            )));
        }
        let most = if limit == 0 { MAX_PAGE } else { limit } as usize;
        let before = JobId(if before == 0 { u64::MAX } else { before });
        blocking(&self.0, move |c| {
            let (list, older) = control::list(c, &caller, before, most, &wanted)
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
        let unable = control::unable(&self.0, id)
            .into_iter()
            .map(wire::unable)
            .collect();
        let teams = control::teams(&self.0, id)
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
        // Before the first summary, so that a change between the two is not missed.
        let changes = self.0.watched().subscribe(id);
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
            control::result(c, id).map_err(|e| status::of_job(&e))
        })
        .await?;
        stream_blob(&self.0, result).await.map(Response::new)
    }
}

impl JobsService {
    /// Changes a job and answers with its summary.
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

/// Returns true if chunks make a whole that is checked while no other large upload is in memory.
fn is_large(parts: &[Digest]) -> bool {
    parts.len() as u64 > MAX_LIGHT / chunks::CHUNK_BYTES as u64
}

/// Begins a scene file of the given number of bytes, if its sender may have one.
///
/// # Errors
/// INVALID_ARGUMENT when a file has at most fewer bytes, RESOURCE_EXHAUSTED when the sender or all together
/// would have too many.
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

/// Returns the name of a scene file, if it is short.
pub(super) fn file_name(name: String) -> Result<String, Status> {
    if name.len() > MAX_PATTERN_BYTES {
        return Err(Status::invalid_argument(format!(
            "the name of the file has {} bytes; give one of at most {MAX_PATTERN_BYTES}",
            name.len()
        )));
    }
    Ok(name)
}

/// Returns the rules of a scene file's header.
fn rules(given: Vec<v1::KindRule>) -> Result<Vec<Rule>, Status> {
    if given.len() > MAX_RULES {
        return Err(Status::invalid_argument(format!(
            "{} rules were given; a scene file has at most {MAX_RULES}",
            given.len()
        )));
    }
    let rule = |r: v1::KindRule| {
        if r.glob.len() > MAX_PATTERN_BYTES {
            return Err(Status::invalid_argument(format!(
                "the pattern of a rule has {} bytes; give one of at most {MAX_PATTERN_BYTES}",
                r.glob.len()
            )));
        }
        let kind = Kind::from_name(&r.kind).ok_or_else(|| {
            Status::invalid_argument(format!(
                "{:?} is no kind; give opaque, see-through, occluder-only, moving or doors",
                r.kind
            ))
        })?;
        Rule::new(kind, &r.glob).map_err(|e| Status::invalid_argument(e.to_string()))
    };
    given.into_iter().map(rule).collect()
}

/// Reads a scene from a file.
pub(super) async fn take_file(
    c: &Arc<Coordinator>,
    caller: Caller,
    name: String,
    rules: Vec<Rule>,
    spool: Spool,
) -> Result<v1::SceneFileInfo, Status> {
    let large = large(c, caller.owner(), spool.announced() > MAX_LIGHT).await?;
    blocking_one_of(c, &c.files, move |c| {
        let _large = large;
        let taken = scene_files::take(c, caller.owner(), &name, spool, rules);
        let (record, warnings) = taken.map_err(|e| status::of_file(&e))?;
        resume::back(c, MissingBlob::Scene(record.digest));
        Ok(v1::SceneFileInfo {
            scene: Some(wire::scene(&record)),
            warnings,
        })
    })
    .await
}

/// The result of a job as a stream, or what is done of one that has not ended.
pub(super) async fn so_far(
    c: &Arc<Coordinator>,
    user: &str,
    id: JobId,
) -> Result<ChunkStream, Status> {
    match blocking(c, move |c| {
        control::result(c, id).map(Some).or_else(|e| none_yet(&e))
    })
    .await?
    {
        Some(result) => stream_blob(c, result).await,
        None => {
            let made = move |c: &Arc<Coordinator>, is_gone: &(dyn Fn() -> bool + Sync)| {
                partial::so_far(c, id, is_gone).map_err(|e| status::of_partial(&e))
            };
            let bytes = in_turn(c, &c.questions, user, made).await?;
            stream_bytes(c, bytes).await
        }
    }
}

/// A job without a result is no error.
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

/// A priority from the wire.
fn checked_priority(priority: i32) -> Result<i32, Status> {
    if PRIORITIES.contains(&priority) {
        return Ok(priority);
    }
    let (least, most) = (PRIORITIES.start(), PRIORITIES.end());
    Err(Status::invalid_argument(format!(
        "the priority {priority} is not between {least} and {most}"
    )))
}

/// A submission on a stored scene.
fn submission(
    c: &Coordinator,
    caller: &Caller,
    r: v1::SubmitRequest,
) -> Result<Submission, Status> {
    let submission = draft(c, caller, r)?;
    let scene = submission.job.spec().scene;
    scenes::known(c, caller, scene).map_err(|e| status::of_store(&e))?;
    Ok(submission)
}

/// A submission from the wire. A view box that is left out is the bounds of the scene, which must be stored
/// then.
fn draft(c: &Coordinator, caller: &Caller, r: v1::SubmitRequest) -> Result<Submission, Status> {
    let spec = r
        .spec
        .as_ref()
        .ok_or_else(|| Status::invalid_argument("the job has no specification"))?;
    let scene = wire::digest(&spec.scene)?;
    let record = match scenes::known(c, caller, scene) {
        Ok(record) => Some(record),
        // An estimate may come before the scene.
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
        scenes::known(c, caller, scene).map_err(|e| status::of_store(&e))?;
        // They take a pass over the triangles, so they are found where they are needed.
        facts.bounds = Some(scenes::bounds(c, &scene).map_err(|e| status::of_facts(&e))?);
        read = JobSpec::from_message(&spec, &facts);
    }
    let invalid = |e: &dyn std::fmt::Display| Status::invalid_argument(e.to_string());
    let spec = read.map_err(|e| invalid(&e))?;
    let job = Arc::new(PlannedJob::new(spec).map_err(|e| invalid(&e))?);
    let priority = checked_priority(r.priority)?;
    let owner = caller.owner().to_owned();
    // Users share the workers evenly, so nobody may take another's share.
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

/// Sends a job's summary after every change, until the job ends or nobody reads.
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
        // Nobody reads, or nothing more will come.
        if !matches!(sent, Ok(Ok(()))) || last.ended() {
            return;
        }
        // A change is sent after a while, the end at once. Nothing is computed until then.
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
                    // Fails when nobody reads any more.
                    let _ = out.send(Err(s)).await;
                    return;
                }
            }
        }
    }
}
