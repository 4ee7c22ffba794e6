//! Suspension of jobs whose scene or receivers are lost.
//!
//! A worker that lacks the blob cannot continue such a job, so the job pauses until a client uploads the blob
//! again. The list of these jobs is only in memory. After a restart they are paused as if by a user, and
//! continue with `resume`.

use std::collections::BTreeSet;
use std::sync::{Arc, MutexGuard};

use sightline_records::ids::JobId;
use sightline_records::{JobPhase, JobRecord, JobState};
use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::jobs::control;
use crate::jobs::stored_spec;
use crate::jobs::suspensions::MissingBlob;
use crate::locks::{self, Rank, Ranked};
use crate::records::JobChanges;
use crate::telemetry::events::{EventKind, LogEvent};

/// The lock for suspending and continuing jobs whose scene or receivers are lost. Only this type adds jobs to
/// the list of waiting jobs.
pub(crate) struct SuspensionLock<'c> {
    c: &'c Coordinator,
    _lock: Ranked<MutexGuard<'c, ()>>,
}

impl<'c> SuspensionLock<'c> {
    /// Waits for the lock. A thread that holds [`JobChanges`] must not call this.
    pub(crate) fn begin(c: &'c Coordinator) -> Self {
        Self {
            c,
            _lock: locks::lock(Rank::Suspension, &c.suspensions.lock),
        }
    }

    /// Pauses an open job, and adds it to the list of waiting jobs. Returns the follow-ups, or `None` if the
    /// job has ended or is paused.
    fn suspend(&self, job: JobId, blob: MissingBlob) -> Option<FollowUps> {
        let waiting = &self.c.suspensions;
        // The insertion precedes the pause, so that a later resumption removes the job from the list.
        waiting.waiting().insert(job, blob);
        let mut changes = JobChanges::begin(self.c);
        let works = [JobPhase::Queued, JobPhase::Running];
        match changes.move_to(job, &works, JobState::Paused) {
            Ok(()) => Some(changes.finish()),
            Err(_) => {
                waiting.forget(job);
                drop(changes.finish());
                None
            }
        }
    }

    /// Removes the jobs that wait for `blob` from the list, and returns them.
    fn end_waits(&self, blob: MissingBlob) -> Vec<JobId> {
        let mut waiting = self.c.suspensions.waiting();
        let jobs = waiting.iter().filter(|(_, missing)| **missing == blob);
        let jobs: Vec<JobId> = jobs.map(|(job, _)| *job).collect();
        for job in &jobs {
            waiting.remove(job);
        }
        jobs
    }
}

/// Suspends the jobs that need `blob`, if it cannot be read. Workers that have the blob finish their tiles.
/// Returns the jobs that wait for the blob, and the follow-ups.
///
/// # Errors
/// [`StoreError`] if the store cannot be read.
pub(crate) fn suspend_jobs(
    c: &Coordinator,
    blob: MissingBlob,
    why: &str,
) -> Result<(BTreeSet<JobId>, FollowUps), StoreError> {
    let lock = SuspensionLock::begin(c);
    // A client may have uploaded the blob since it was found damaged.
    if c.blobs.open_checked(&blob.digest()).is_ok() {
        return Ok((BTreeSet::new(), FollowUps::default()));
    }
    let mut follow_ups = FollowUps::default();
    for job in c.records.jobs()? {
        let works = matches!(job.state.phase(), JobPhase::Queued | JobPhase::Running);
        if !works || !needs(&job, blob) {
            continue;
        }
        let Some(more) = lock.suspend(job.id, blob) else {
            continue;
        };
        follow_ups.extend(more);
        let (name, again) = match blob {
            MissingBlob::Scene(_) => (
                "scene",
                "the scene again, with `sightline submit` and the same file",
            ),
            MissingBlob::Receivers(_) => (
                "receivers",
                "the receivers again, with the `sightline ambient` that made the job",
            ),
        };
        tracing::error!(
            "job {} is paused, because its {name} cannot be read: {why}",
            job.id
        );
        let text = format!(
            "the job is paused, because its {name} cannot be read: send {again}, and the job \
             continues"
        );
        c.record_event(LogEvent::of_job(EventKind::Job, job.id, text));
    }
    let waiting = c.suspensions.waiting();
    let jobs = waiting.iter().filter(|(_, missing)| **missing == blob);
    let jobs = jobs.map(|(job, _)| *job).collect();
    Ok((jobs, follow_ups))
}

/// Continues the jobs that waited for `blob`, which is stored again.
pub(crate) fn resume_jobs(c: &Arc<Coordinator>, blob: MissingBlob) {
    let lock = SuspensionLock::begin(c);
    for job in lock.end_waits(blob) {
        // A client may have resumed, cancelled or deleted the job.
        if let Err(e) = control::resume(c, job) {
            tracing::info!(
                "job {job} cannot continue, although its missing input was uploaded again: {e}"
            );
        }
    }
}

/// Returns true if a job needs a blob.
fn needs(job: &JobRecord, blob: MissingBlob) -> bool {
    match blob {
        MissingBlob::Scene(digest) => job.scene == digest,
        MissingBlob::Receivers(digest) => {
            stored_spec::receivers(&job.spec).is_some_and(|ambient| ambient.receivers == digest)
        }
    }
}
