//! The submission of jobs: records a checked specification as a new job, or returns the existing job with the
//! same key.

use std::sync::Arc;

use sightline_model::{PlannedJob, SceneFacts, SpecError};
use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobPhase, JobState, NewJob, Submitted, owned_key, owned_request};
use sightline_scheduler::{Event, OpenJob};
use sightline_store::{BlobError, StoreError};
use sightline_traces::SpanTime;

use crate::coordinator::Coordinator;
use crate::jobs::stored_spec;
use crate::quota::Usage;
use crate::records::{OutputRemoval, Records};
use crate::telemetry::events::{EventKind, LogEvent};
use crate::telemetry::spans::Cause;
use crate::uploads::receivers;
use crate::uploads::scenes::{self, FactsError};
use crate::users::quota_check::{QuotaReservation, ReservationError};

/// A checked specification with its submitter.
pub(crate) struct Submission {
    /// The id that the client chose. Another submission with the same id returns the same job.
    pub(crate) request_id: String,
    /// The display name of the job.
    pub(crate) name: String,
    /// The owner of the new job.
    pub(crate) owner: String,
    /// The user who submits the job.
    pub(crate) user: String,
    /// The priority of the job. Workers compute jobs of higher priority first.
    pub(crate) priority: i32,
    /// The planned job.
    pub(crate) job: Arc<PlannedJob>,
    /// The call that caused the submission, for the job's trace.
    pub(crate) cause: Cause,
}

/// The reason why a submission is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SubmitError {
    /// The job does not fit its scene.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A receiver is on a triangle that does not exist in the scene.
    #[error(
        "a receiver lies on triangle {0}, which the scene does not have; submit with the scene that the \
         receivers are for"
    )]
    Receiver(u32),
    /// The job was stored but cannot be scheduled.
    #[error("{0}")]
    Schedule(String),
    /// The submission exceeds the user's quota.
    #[error(transparent)]
    Quota(#[from] ReservationError),
    /// The kinds of the scene's triangles cannot be read.
    #[error(transparent)]
    Facts(#[from] FactsError),
    /// The receivers cannot be read.
    #[error(transparent)]
    Receivers(#[from] receivers::StoredReceiversError),
    /// A lost result cannot be removed, or the viewpoints cannot be stored.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Submits a job on a recorded scene. Returns the job's id, and whether the job existed before. A done job
/// whose result is lost starts again.
pub(crate) fn submit(
    c: &Arc<Coordinator>,
    submission: &Submission,
) -> Result<Submitted, SubmitError> {
    let begun = SpanTime::now();
    let Submission {
        request_id,
        name,
        owner,
        user,
        priority,
        job: planned,
        cause,
    } = submission;
    let (spec, plan) = (planned.spec(), planned.plan());
    let is_asked = spec
        .visibility()
        .is_some_and(|task| task.is_decided() || task.viewpoints().region().is_some());
    if is_asked {
        let facts = scenes::facts(c, &spec.scene)?;
        let scene = SceneFacts {
            triangles: facts.triangles,
            bounds: None,
            has_masks: facts.kinds.any_masked(),
            is_culled: facts.is_culled,
        };
        spec.fits(&scene)?;
    }
    if let Some(ambient) = spec.ambient()
        && let Some(triangle) = c
            .uploads
            .receivers(&*c.blobs, ambient.receivers)?
            .facts
            .greatest_triangle
        && triangle >= scenes::facts(c, &spec.scene)?.triangles
    {
        return Err(SubmitError::Receiver(triangle));
    }
    let quota = QuotaReservation::begin(c, owner);
    let bytes = spec.ambient().map_or(0, |ambient| ambient.bytes);
    // Until now, an upload for this job counts as a chunk of the user.
    let sent = spec
        .ambient()
        .filter(|ambient| c.uploads.chunks.has(owner, &ambient.receivers))
        .map_or(0, |_| bytes);
    let more = Usage {
        bytes,
        jobs: 1,
        tiles: plan.tiles.len() as u64,
        ..Usage::default()
    };
    // An existing job does not add to the usage.
    let known = c
        .records
        .job_by_key(&owned_key(planned.key(), owner))?
        .map(|job| job.state.phase());
    if known.is_none_or(|phase| matches!(phase, JobPhase::Failed | JobPhase::Cancelled)) {
        quota.reserve(more, sent)?;
    }
    // Until the scheduler has the job, no other thread changes it, and no blob that it references is deleted.
    let mut changes = quota.job_changes();
    if let Some(ambient) = spec.ambient() {
        receivers::hold(&changes, ambient.receivers)?;
    }
    let job = NewJob {
        key: owned_key(planned.key(), owner),
        request_id: owned_request(request_id, owner),
        name: name.clone(),
        owner: owner.clone(),
        user: user.clone(),
        priority: *priority,
        scene: spec.scene,
        spec: stored_spec::stored(&*c.blobs, spec)?,
        tiles: plan.tiles.len() as u32,
        submitted_at_ms: c.now().unix_ms,
    };
    let mut submitted = changes.submit(job.clone()).map_err(|e| match e {
        // Report the id that the client gave, not the owned one.
        StoreError::RequestIdReused { job, .. } => StoreError::RequestIdReused {
            request_id: request_id.clone(),
            job,
        },
        e => e,
    })?;
    if submitted.existing
        && let Some(result) = result_of(&c.records, submitted.id)?
    {
        // Reading a large result takes time, so other threads must not wait for it.
        let lost = changes.unlocked(|| c.blobs.open_checked(&result).err());
        if let Some(e) = lost.as_ref().filter(|e| e.passes()) {
            return Err(e.clone().into());
        }
        if let Some(e) = lost
            && result_of(&c.records, submitted.id)? == Some(result)
        {
            // The outputs of the job's tiles were removed, so the job starts from nothing.
            tracing::warn!(
                "the result of job {} is lost ({e}); the job is baked again",
                submitted.id
            );
            {
                let _removal = OutputRemoval::begin(c);
                c.records.may_change()?;
                c.blobs.remove(&result)?;
            }
            changes.delete(submitted.id)?;
            submitted = changes.submit(job)?;
        }
    }
    if let Some(ambient) = spec.ambient() {
        // From now on the job references the receivers, so they no longer count as chunks.
        c.uploads.chunks.forget(owner, &[ambient.receivers]);
    }
    if !submitted.existing {
        let id = submitted.id;
        let record = c
            .records
            .job(id)?
            .ok_or(StoreError::UnknownJob { job: id })?;
        let tiles = c.records.tiles(id)?;
        let job =
            OpenJob::new(record, Arc::clone(planned), tiles).map_err(SubmitError::Schedule)?;
        tracing::info!(
            "job {id} ({name:?}) is submitted; tiles: {}",
            plan.tiles.len()
        );
        let by = if user.is_empty() {
            String::new()
        } else {
            format!(" by {user}")
        };
        let text = format!("{name} is submitted{by}; tiles: {}", plan.tiles.len());
        c.record_event(LogEvent::of_job(EventKind::Submitted, id, text));
        changes.tell(Event::TakenUp(Box::new(job)));
        c.telemetry
            .spans
            .planned(id, begun, plan.tiles.len(), *cause);
    }
    changes.finish().run(c);
    Ok(submitted)
}

fn result_of(records: &Records, id: JobId) -> Result<Option<Digest>, StoreError> {
    Ok(match records.job(id)?.map(|job| job.state) {
        Some(JobState::Done { result, .. }) => Some(result),
        _ => None,
    })
}
