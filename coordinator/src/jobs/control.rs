//! Jobs after their submission: summaries, cancel, pause, resume, retry, and where their results are.

use std::sync::{Arc, PoisonError};

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobPhase, JobRecord, JobState, TileRecord, TileState};
use sightline_scheduler::{Event, Job, Team, Unable, cells_total};
use sightline_store::StoreError;
use sightline_traces::TraceId;

use crate::access::Caller;
use crate::dispatch::tell;
use crate::jobs::changes::turned;
use crate::jobs::stored_spec;
use crate::records::JobChanges;
use crate::state::{Coordinator, MissingBlob};
use crate::telemetry::events::{Kind, LogEvent};

/// A job that cannot be changed or fetched.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobError {
    /// Another version of the program began the job.
    #[error("{0}")]
    Outdated(String),
    /// The job has no result yet, or will have none.
    #[error("job {job} is {phase} and has no result yet; `sightline watch {job}` follows it")]
    NoResult {
        /// The job.
        job: JobId,
        /// Its state.
        phase: JobPhase,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A job with the totals of its tiles. Derived from its record and its tiles, never stored.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Summary {
    pub(crate) record: JobRecord,
    pub(crate) tiles_total: u32,
    pub(crate) tiles_done: u32,
    pub(crate) tiles_set_aside: u32,
    pub(crate) tiles_running: u32,
    pub(crate) cells_done: u64,
    /// 0 while unknown.
    pub(crate) cells_total: u64,
    /// Samples of finished and of running tiles.
    pub(crate) samples: u64,
    /// Time that workers spent on finished tiles, in milliseconds.
    pub(crate) tile_millis: u64,
    /// Connected workers.
    pub(crate) workers: u32,
    /// The coordinator's clock, in milliseconds since 1970.
    pub(crate) now_ms: u64,
    /// Milliseconds until the job is done, while that is known.
    pub(crate) left_millis: Option<u64>,
    /// What cannot be read, so that it is paused.
    pub(crate) lacks: Option<MissingBlob>,
    /// Its trace, where traces are sent.
    pub(crate) trace: Option<TraceId>,
}

impl Summary {
    fn of_ended(
        record: JobRecord,
        tiles: &[TileRecord],
        cells_total: u64,
        (workers, now_ms): (u32, u64),
        trace: Option<TraceId>,
    ) -> Self {
        let mut sum = Self {
            record,
            tiles_total: tiles.len() as u32,
            tiles_done: 0,
            tiles_set_aside: 0,
            tiles_running: 0,
            cells_done: 0,
            cells_total,
            samples: 0,
            tile_millis: 0,
            workers,
            now_ms,
            left_millis: None,
            lacks: None,
            trace,
        };
        for tile in tiles {
            match &tile.state {
                TileState::Open => {}
                TileState::Done { stats, .. } => {
                    sum.tiles_done += 1;
                    sum.cells_done = sum.cells_done.saturating_add(stats.cells);
                    sum.samples = sum.samples.saturating_add(stats.samples);
                    sum.tile_millis = sum.tile_millis.saturating_add(stats.millis);
                }
                TileState::SetAside { .. } => sum.tiles_set_aside += 1,
            }
        }
        sum
    }

    /// Whether the job has ended.
    pub(crate) fn ended(&self) -> bool {
        self.record.state.phase().ended()
    }
}

/// A job's record.
///
/// # Errors
/// [`StoreError::UnknownJob`], or the store's.
pub(crate) fn record(c: &Coordinator, job: JobId) -> Result<JobRecord, StoreError> {
    c.store.job(job)?.ok_or(StoreError::UnknownJob { job })
}

/// The summary of a job.
pub(crate) fn summary(c: &Coordinator, id: JobId) -> Result<Summary, StoreError> {
    if let Some(summary) = live(c, id) {
        return Ok(summary);
    }
    let record = record(c, id)?;
    let workers = c.lock().scheduler.workers();
    let tiles = c.store.tiles(id)?;
    // The specification of another version cannot be planned; the number of its cells is unknown then.
    let total =
        stored_spec::without_viewpoints(&*c.blobs, &record.spec).map_or(0, |job| cells_total(&job));
    let trace = c.spans.trace_of(&record);
    Ok(Summary::of_ended(
        record,
        &tiles,
        total,
        (workers, c.now().unix_ms),
        trace,
    ))
}

/// The summary of a job that has not ended, from the scheduler's totals.
pub(crate) fn live(c: &Coordinator, id: JobId) -> Option<Summary> {
    let now = c.now_plain();
    let lacks = c
        .lost
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .get(&id)
        .copied();
    let scheduling = c.lock();
    let scheduler = &scheduling.scheduler;
    let job = scheduler.job(id)?;
    Some(Summary {
        record: job.record.clone(),
        tiles_total: job.tiles.len() as u32,
        tiles_done: job.done,
        tiles_set_aside: job.set_aside,
        tiles_running: job.running,
        cells_done: job.cells.saturating_add(job.running_cells),
        cells_total: job.cells_total,
        samples: job.samples.saturating_add(job.running_samples),
        tile_millis: job.millis,
        workers: scheduler.workers(),
        now_ms: now.unix_ms,
        left_millis: job.left(now),
        lacks,
        trace: c.spans.trace_of(&job.record),
    })
}

/// Which jobs are wanted: those to which all of it applies.
#[derive(Clone, Debug, Default)]
pub(crate) struct JobFilter {
    /// In one of these states; empty for all.
    pub(crate) phases: Vec<JobPhase>,
    /// A part of the name.
    pub(crate) name: String,
    /// The user; empty for all.
    pub(crate) user: String,
    pub(crate) scene: Option<Digest>,
}

impl JobFilter {
    fn is_all(&self) -> bool {
        self.phases.is_empty()
            && self.name.is_empty()
            && self.user.is_empty()
            && self.scene.is_none()
    }

    fn matches(&self, job: &JobRecord) -> bool {
        (self.phases.is_empty() || self.phases.contains(&job.state.phase()))
            && job.name.contains(&self.name)
            && (self.user.is_empty() || job.user == self.user || job.owner == self.user)
            && self.scene.is_none_or(|scene| scene == job.scene)
    }
}

/// The summaries of the newest `most` jobs below `before`, in the order of their submission, and whether
/// there are older ones.
pub(crate) fn list(
    c: &Coordinator,
    caller: &Caller,
    before: JobId,
    most: usize,
    wanted: &JobFilter,
) -> Result<(Vec<Summary>, bool), StoreError> {
    let (page, older) = own_before(c, caller, before, most, wanted)?;
    let summary_if_present = |job: &JobRecord| match summary(c, job.id) {
        // It was deleted in between.
        Err(StoreError::UnknownJob { .. }) => None,
        summary => Some(summary),
    };
    Ok((
        page.iter()
            .filter_map(summary_if_present)
            .collect::<Result<_, _>>()?,
        older,
    ))
}

/// The newest jobs before one that a caller may see and wants, ascending, and whether there are older ones.
fn own_before(
    c: &Coordinator,
    caller: &Caller,
    mut before: JobId,
    most: usize,
    wanted: &JobFilter,
) -> Result<(Vec<JobRecord>, bool), StoreError> {
    if caller.sees_all() && wanted.is_all() {
        return c.store.jobs_before(before, most);
    }
    // From the newest on, and one more than is wanted: what others have is not told of, even as older jobs.
    let mut own = Vec::new();
    loop {
        let (page, older) = c.store.jobs_before(before, most)?;
        let first = page.first().map(|job| job.id);
        own.extend(
            page.into_iter()
                .rev()
                .filter(|job| caller.sees(&job.owner) && wanted.matches(job)),
        );
        match first.filter(|_| older && own.len() <= most) {
            Some(first) => before = first,
            None => {
                let older = own.len() > most;
                own.truncate(most);
                own.reverse();
                return Ok((own, older));
            }
        }
    }
}

/// The connected workers that cannot work on a job, by reason.
pub(crate) fn unable(c: &Coordinator, job: JobId) -> Vec<Unable> {
    c.lock().scheduler.unable(job)
}

/// Who works on a job's tiles.
pub(crate) fn teams(c: &Coordinator, job: JobId) -> Vec<Team> {
    c.lock().scheduler.teams(job)
}

/// The digest of a done job's result.
pub(crate) fn result(c: &Coordinator, job: JobId) -> Result<Digest, JobError> {
    match record(c, job)?.state {
        JobState::Done { result, .. } => Ok(result),
        state => Err(JobError::NoResult {
            job,
            phase: state.phase(),
        }),
    }
}

/// Ends a job that has not ended.
pub(crate) fn cancel(c: &Arc<Coordinator>, job: JobId) -> Result<Summary, JobError> {
    waits_no_more(c, job);
    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
    let cancelled = turn(c, job, &from, JobState::Cancelled)?;
    // Submitted again, the job begins from nothing.
    c.crews.outcomes.sweep(|other| other != job);
    Ok(cancelled)
}

/// Stops granting tiles of a job; takes back those that are leased if they are to stop `now`.
pub(crate) fn pause(c: &Arc<Coordinator>, job: JobId, now: bool) -> Result<Summary, JobError> {
    waits_no_more(c, job);
    // A paused job can still be told to stop now.
    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
    let paused = turn(c, job, &from, JobState::Paused)?;
    if !now {
        return Ok(paused);
    }
    tell(c, Event::Stopped(job)).run(c);
    c.happened(LogEvent::of_job(
        Kind::Job,
        job,
        "tiles at work are stopped",
    ));
    Ok(summary(c, job)?)
}

/// Continues a paused job.
pub(crate) fn resume(c: &Arc<Coordinator>, job: JobId) -> Result<Summary, JobError> {
    waits_no_more(c, job);
    turn(c, job, &[JobPhase::Paused], JobState::Queued)
}

/// What a person does with a job counts more than that it waits for its scene or its receivers.
fn waits_no_more(c: &Coordinator, job: JobId) {
    c.lost
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .remove(&job);
}

/// Gives a job that has not ended another priority.
pub(crate) fn prioritize(
    c: &Arc<Coordinator>,
    id: JobId,
    priority: i32,
) -> Result<Summary, JobError> {
    let follow_ups = {
        let mut changes = JobChanges::begin(c);
        let record = changes.prioritize(id, priority)?;
        tracing::info!("job {id} has priority {priority}");
        c.happened(LogEvent::of_job(
            Kind::Job,
            id,
            format!("the job has priority {priority}"),
        ));
        changes.tell(Event::JobChanged(Box::new(record)));
        changes.finish()
    };
    follow_ups.run(c);
    Ok(summary(c, id)?)
}

/// Moves a job to another state.
fn turn(
    c: &Arc<Coordinator>,
    id: JobId,
    from: &[JobPhase],
    to: JobState,
) -> Result<Summary, JobError> {
    let follow_ups = turned(c, id, from, to)?;
    follow_ups.run(c);
    Ok(summary(c, id)?)
}

/// Continues a failed or cancelled job, or a done one with tiles set aside, with the tiles that it has. A job
/// that has not ended stays as it is.
pub(crate) fn retry(c: &Arc<Coordinator>, id: JobId) -> Result<Summary, JobError> {
    let mut changes = JobChanges::begin(c);
    let retried = reopen(&mut changes, id);
    changes.finish().run(c);
    retried?;
    Ok(summary(c, id)?)
}

/// Reopens the tiles of an ended job, and gives the job to the scheduler.
fn reopen(changes: &mut JobChanges<'_>, id: JobId) -> Result<(), JobError> {
    let c = changes.coordinator();
    let before = record(c, id)?;
    if !before.state.phase().ended() {
        return Ok(());
    }
    // Checked first: otherwise the job would be open in the store and absent from the scheduler.
    let work = stored_spec::whole(&*c.blobs, &before.spec).map_err(JobError::Outdated)?;
    let work = Arc::new(work);
    Job::new(before, Arc::clone(&work), c.store.tiles(id)?).map_err(JobError::Outdated)?;
    changes.reopen_tiles(id)?;
    let after = record(c, id)?;
    if !after.state.phase().ended() {
        let job = Job::new(after, work, c.store.tiles(id)?).map_err(JobError::Outdated)?;
        changes.tell(Event::TakenUp(Box::new(job)));
        tracing::info!("job {id} is tried again");
        c.happened(LogEvent::of_job(Kind::Job, id, "the job is tried again"));
    }
    Ok(())
}
