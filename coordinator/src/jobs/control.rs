//! Control of submitted jobs: summaries, cancel, pause, resume, retry, and the digests of results.

use std::sync::Arc;

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobPhase, JobRecord, JobState, TileRecord, TileState};
use sightline_scheduler::{Event, OpenJob, cells_total};
use sightline_store::StoreError;
use sightline_traces::TraceId;

use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::jobs::stored_spec;
use crate::jobs::suspensions::MissingBlob;
use crate::records::{JobChanges, Records};
use crate::telemetry::events::{EventKind, LogEvent};

/// An error of a request to change a job or to download its result.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobError {
    /// Another version of the program created the job.
    #[error("{0}")]
    Outdated(String),
    /// The job has no result.
    #[error("job {job} is {phase} and has no result yet; follow it with `sightline watch {job}`")]
    NoResult {
        /// The job.
        job: JobId,
        /// The job's state.
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
    /// The number of cells. 0 if the number is not known.
    pub(crate) cells_total: u64,
    /// The number of samples of finished and of running tiles.
    pub(crate) samples: u64,
    /// The time that workers spent on finished tiles, in milliseconds.
    pub(crate) tile_millis: u64,
    /// The number of connected workers.
    pub(crate) workers: u32,
    /// The coordinator's clock, in milliseconds since 1970.
    pub(crate) now_ms: u64,
    /// The expected time until the job is done, in milliseconds. `None` if it is not known.
    pub(crate) left_millis: Option<u64>,
    /// The missing blob because of which the job is paused. `None` if the job does not wait for a blob.
    pub(crate) missing: Option<MissingBlob>,
    /// The trace of the job, if the coordinator sends traces.
    pub(crate) trace: Option<TraceId>,
}

impl Summary {
    fn of_ended(
        record: JobRecord,
        tiles: &[TileRecord],
        cells_total: u64,
        workers: u32,
        now_ms: u64,
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
            missing: None,
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

    /// Returns true if the job has ended.
    pub(crate) fn ended(&self) -> bool {
        self.record.state.phase().ended()
    }
}

/// Returns the summary of a job.
pub(crate) fn summary(c: &Coordinator, id: JobId) -> Result<Summary, StoreError> {
    if let Some(summary) = live(c, id) {
        return Ok(summary);
    }
    let record = c.records.existing_job(id)?;
    let workers = c.dispatcher.read(|scheduler| scheduler.workers());
    let tiles = c.records.tiles(id)?;
    // The specification of another version cannot be planned, so the number of its cells is unknown.
    let total =
        stored_spec::without_viewpoints(&*c.blobs, &record.spec).map_or(0, |job| cells_total(&job));
    let trace = c.telemetry.spans.trace_of(&record);
    Ok(Summary::of_ended(
        record,
        &tiles,
        total,
        workers,
        c.now().unix_ms,
        trace,
    ))
}

/// Returns the summary of a job that has not ended, from the scheduler's totals. Returns `None` if the
/// scheduler does not have the job.
pub(crate) fn live(c: &Coordinator, id: JobId) -> Option<Summary> {
    let now = c.scheduler_now();
    let missing = c.suspensions.missing_blob(id);
    c.dispatcher.read(|scheduler| {
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
            missing,
            trace: c.telemetry.spans.trace_of(&job.record),
        })
    })
}

/// A filter of jobs. A job has to match all its conditions.
#[derive(Clone, Debug, Default)]
pub(crate) struct JobFilter {
    /// The accepted states. Empty for all states.
    pub(crate) phases: Vec<JobPhase>,
    /// A text that the job's name must contain. Empty for all names.
    pub(crate) name: String,
    /// The user or the owner of the job. Empty for all users.
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

/// Returns the summaries of at most `most` jobs: the newest ones with numbers below `before`, in ascending
/// order. The second value is true if older jobs exist.
///
/// Only jobs that match `filter` and that `caller` may see count.
pub(crate) fn list(
    c: &Coordinator,
    caller: &Caller,
    before: JobId,
    most: usize,
    filter: &JobFilter,
) -> Result<(Vec<Summary>, bool), StoreError> {
    let (page, older) = own_before(&c.records, caller, before, most, filter)?;
    let summary_if_present = |job: &JobRecord| match summary(c, job.id) {
        // Another call deleted the job in between.
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

/// Returns at most `most` jobs that `caller` may see and that match `filter`: the newest ones with numbers
/// below `before`, in ascending order. The second value is true if older jobs exist.
fn own_before(
    records: &Records,
    caller: &Caller,
    mut before: JobId,
    most: usize,
    filter: &JobFilter,
) -> Result<(Vec<JobRecord>, bool), StoreError> {
    if caller.sees_all() && filter.is_all() {
        return records.jobs_before(before, most);
    }
    // The search starts at the newest job and collects one more than `most`, to find out if older jobs exist.
    // Jobs of other users do not count, so that the answer does not reveal them.
    let mut own = Vec::new();
    loop {
        let (page, older) = records.jobs_before(before, most)?;
        let first = page.first().map(|job| job.id);
        own.extend(
            page.into_iter()
                .rev()
                .filter(|job| caller.sees(&job.owner) && filter.matches(job)),
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

/// Returns the digest of a done job's result.
pub(crate) fn result(records: &Records, job: JobId) -> Result<Digest, JobError> {
    match records.existing_job(job)?.state {
        JobState::Done { result, .. } => Ok(result),
        state => Err(JobError::NoResult {
            job,
            phase: state.phase(),
        }),
    }
}

/// Cancels a job that has not ended.
pub(crate) fn cancel(c: &Arc<Coordinator>, job: JobId) -> Result<Summary, JobError> {
    c.suspensions.forget(job);
    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
    let cancelled = move_job(c, job, &from, JobState::Cancelled)?;
    // If a client submits the job again, the new job must not continue from these outcomes.
    c.workers.crews.outcomes.sweep(|other, _| other != job);
    Ok(cancelled)
}

/// Stops granting tiles of a job. If `now` is true, also revokes the active leases of the job.
pub(crate) fn pause(c: &Arc<Coordinator>, job: JobId, now: bool) -> Result<Summary, JobError> {
    c.suspensions.forget(job);
    // A client can still pause a paused job again with `now`.
    let from = [JobPhase::Queued, JobPhase::Running, JobPhase::Paused];
    let paused = move_job(c, job, &from, JobState::Paused)?;
    if !now {
        return Ok(paused);
    }
    c.tell(Event::Stopped(job)).run(c);
    c.record_event(LogEvent::of_job(
        EventKind::Job,
        job,
        "tiles at work are stopped",
    ));
    Ok(summary(c, job)?)
}

/// Continues a paused job.
pub(crate) fn resume(c: &Arc<Coordinator>, job: JobId) -> Result<Summary, JobError> {
    c.suspensions.forget(job);
    move_job(c, job, &[JobPhase::Paused], JobState::Queued)
}

/// Changes the priority of a job that has not ended.
pub(crate) fn prioritize(
    c: &Arc<Coordinator>,
    id: JobId,
    priority: i32,
) -> Result<Summary, JobError> {
    let follow_ups = {
        let mut changes = JobChanges::begin(c);
        let record = changes.prioritize(id, priority)?;
        tracing::info!("job {id} has priority {priority}");
        c.record_event(LogEvent::of_job(
            EventKind::Job,
            id,
            format!("the job has priority {priority}"),
        ));
        changes.tell(Event::JobChanged(Box::new(record)));
        changes.finish()
    };
    follow_ups.run(c);
    Ok(summary(c, id)?)
}

/// Changes the state of a job and runs the follow-ups.
fn move_job(
    c: &Arc<Coordinator>,
    id: JobId,
    from: &[JobPhase],
    to: JobState,
) -> Result<Summary, JobError> {
    let mut changes = JobChanges::begin(c);
    let moved = changes.move_to(id, from, to);
    changes.finish().run(c);
    moved?;
    Ok(summary(c, id)?)
}

/// Continues an ended job with its existing tiles: a failed or cancelled job, or a done job with tiles set
/// aside. A job that has not ended does not change.
pub(crate) fn retry(c: &Arc<Coordinator>, id: JobId) -> Result<Summary, JobError> {
    let mut changes = JobChanges::begin(c);
    let retried = reopen(&mut changes, id);
    changes.finish().run(c);
    retried?;
    Ok(summary(c, id)?)
}

/// Reopens the tiles of an ended job, and passes the job to the scheduler.
fn reopen(changes: &mut JobChanges<'_>, id: JobId) -> Result<(), JobError> {
    let c = changes.coordinator();
    let before = c.records.existing_job(id)?;
    if !before.state.phase().ended() {
        return Ok(());
    }
    // Plan the job first. If planning failed later, the job would be open in the store and absent from the
    // scheduler.
    let planned = stored_spec::whole(&*c.blobs, &before.spec).map_err(JobError::Outdated)?;
    let planned = Arc::new(planned);
    OpenJob::new(before, Arc::clone(&planned), c.records.tiles(id)?).map_err(JobError::Outdated)?;
    changes.reopen_tiles(id)?;
    let after = c.records.existing_job(id)?;
    if !after.state.phase().ended() {
        let job = OpenJob::new(after, planned, c.records.tiles(id)?).map_err(JobError::Outdated)?;
        changes.tell(Event::TakenUp(Box::new(job)));
        tracing::info!("job {id} is retried");
        c.record_event(LogEvent::of_job(EventKind::Job, id, "the job is retried"));
    }
    Ok(())
}
