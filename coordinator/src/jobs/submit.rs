//! Submission: a checked specification becomes a job, or finds the job that has the same result.

use std::sync::Arc;

use sightline_model::{PlannedJob, SceneFacts, SpecError};
use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobPhase, JobState, NewJob, Submitted, owned_key, owned_request};
use sightline_scheduler::{Event, Job};
use sightline_store::{BlobError, StoreError};
use sightline_traces::Begun;

use crate::jobs::stored_spec;
use crate::quota::Usage;
use crate::records::{JobChanges, OutputRemoval};
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};
use crate::telemetry::spans::Cause;
use crate::uploads::receivers;
use crate::uploads::scenes::{self, FactsError};
use crate::users::quota_check::{HavingError, reserve_quota, turn_of};

/// A specification to be submitted.
pub(crate) struct Submission {
    /// Chosen by the client; submitting again with the same one gives the same job.
    pub(crate) request_id: String,
    /// For people.
    pub(crate) name: String,
    /// Whose it will be.
    pub(crate) owner: String,
    /// Who submits it.
    pub(crate) user: String,
    /// Jobs of higher priority come first.
    pub(crate) priority: i32,
    /// The job.
    pub(crate) job: Arc<PlannedJob>,
    /// What led to it, for its trace.
    pub(crate) cause: Cause,
}

/// A submission that is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SubmitError {
    /// The job does not fit its scene.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A receiver is on a triangle that the scene does not have.
    #[error(
        "a receiver lies on triangle {0}, which the scene does not have; submit with the scene that the \
         receivers are for"
    )]
    Receiver(u32),
    /// The job was stored but cannot be scheduled.
    #[error("{0}")]
    Schedule(String),
    /// The user may not have more.
    #[error(transparent)]
    Having(#[from] HavingError),
    /// The kinds of the scene's triangles cannot be read.
    #[error(transparent)]
    Facts(#[from] FactsError),
    /// The receivers cannot be had.
    #[error(transparent)]
    Receivers(#[from] receivers::Fault),
    /// A lost result cannot be removed, or the viewpoints cannot be stored.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Submits a job on a recorded scene; returns its id and whether it existed before. A done job whose result
/// is lost is begun again.
pub(crate) fn submit(
    c: &Arc<Coordinator>,
    submission: &Submission,
) -> Result<Submitted, SubmitError> {
    let begun = Begun::now();
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
        && let Some(triangle) = receivers::stored(c, ambient.receivers)?
            .facts
            .greatest_triangle
        && triangle >= scenes::facts(c, &spec.scene)?.triangles
    {
        return Err(SubmitError::Receiver(triangle));
    }
    let _having = turn_of(c, owner);
    let bytes = spec.ambient().map_or(0, |ambient| ambient.bytes);
    // What was sent for this job counts until now as a chunk.
    let sent = spec
        .ambient()
        .filter(|ambient| c.uploads.has(owner, &ambient.receivers))
        .map_or(0, |_| bytes);
    let more = Usage {
        bytes,
        jobs: 1,
        tiles: plan.tiles.len() as u64,
        ..Usage::default()
    };
    // A job that is there already is no more.
    let known = c
        .store
        .job_by_key(&owned_key(planned.key(), owner))?
        .map(|job| job.state.phase());
    if known.is_none_or(|phase| matches!(phase, JobPhase::Failed | JobPhase::Cancelled)) {
        reserve_quota(c, owner, more, sent)?;
    }
    // Nobody else changes the job until the scheduler has it, and no blob that it will name is deleted.
    let mut changes = JobChanges::begin(c);
    if let Some(ambient) = spec.ambient() {
        receivers::hold(c, ambient.receivers)?;
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
        // By the id that the client gave.
        StoreError::RequestIdReused { job, .. } => StoreError::RequestIdReused {
            request_id: request_id.clone(),
            job,
        },
        e => e,
    })?;
    if submitted.existing
        && let Some(result) = result_of(c, submitted.id)?
    {
        // Reading a large result takes time; nobody else waits for it.
        let lost = changes.unlocked(|| c.blobs.open_checked(&result).err());
        if let Some(e) = lost.as_ref().filter(|e| e.passes()) {
            return Err(e.clone().into());
        }
        if let Some(e) = lost
            && result_of(c, submitted.id)? == Some(result)
        {
            // The outputs of its tiles were removed, so the job begins from nothing.
            tracing::warn!(
                "the result of job {} is lost ({e}); it is baked again",
                submitted.id
            );
            {
                let _removal = OutputRemoval::begin(c);
                c.store.may_change()?;
                c.blobs.remove(&result)?;
            }
            changes.delete(submitted.id)?;
            submitted = changes.submit(job)?;
        }
    }
    if let Some(ambient) = spec.ambient() {
        // From now on it is the job that names them.
        c.uploads.forget(owner, &[ambient.receivers]);
    }
    if !submitted.existing {
        let id = submitted.id;
        let record = c.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
        let tiles = c.store.tiles(id)?;
        let job = Job::new(record, Arc::clone(planned), tiles).map_err(SubmitError::Schedule)?;
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
        c.happened(LogEvent::of_job(Kind::Submitted, id, text));
        changes.tell(Event::TakenUp(Box::new(job)));
        c.spans.planned(id, begun, plan.tiles.len(), *cause);
    }
    changes.finish().run(c);
    Ok(submitted)
}

fn result_of(c: &Coordinator, id: JobId) -> Result<Option<Digest>, StoreError> {
    Ok(match c.store.job(id)?.map(|job| job.state) {
        Some(JobState::Done { result, .. }) => Some(result),
        _ => None,
    })
}
