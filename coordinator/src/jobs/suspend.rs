//! Scenes and receivers whose file is lost or damaged: no worker that lacks them can go on with their jobs,
//! so these are paused until somebody sends them again.
//!
//! Which jobs wait is kept in memory. After a restart they are paused as by a person, and go on with
//! `resume`.

use std::collections::BTreeSet;
use std::sync::PoisonError;

use sightline_records::ids::JobId;
use sightline_records::{JobPhase, JobRecord, JobState};
use sightline_store::StoreError;

use crate::dispatch::FollowUps;
use crate::jobs::changes::turned;
use crate::jobs::stored_spec;
use crate::state::{Coordinator, MissingBlob};
use crate::telemetry::events::{Kind, LogEvent};

/// Pauses the jobs of a scene or of receivers that cannot be read. Workers that have them finish their tiles.
/// Nothing happens where no job names them. Returns the jobs that wait for them.
pub(crate) fn lost(
    c: &Coordinator,
    lacks: MissingBlob,
    why: &str,
) -> Result<(BTreeSet<JobId>, FollowUps), StoreError> {
    let _turn = c.lost_turn();
    // Somebody may have sent it since it was found damaged.
    if c.blobs.open_checked(&lacks.digest()).is_ok() {
        return Ok((BTreeSet::new(), FollowUps::default()));
    }
    let mut follow_ups = FollowUps::default();
    let list = || c.lost.lock().unwrap_or_else(PoisonError::into_inner);
    for job in c.store.jobs()? {
        let works = matches!(job.state.phase(), JobPhase::Queued | JobPhase::Running);
        if !works || !needs(&job, lacks) {
            continue;
        }
        // Before the pause: whoever resumes the job after it takes it off the list.
        list().insert(job.id, lacks);
        match turned(
            c,
            job.id,
            &[JobPhase::Queued, JobPhase::Running],
            JobState::Paused,
        ) {
            Ok(more) => follow_ups.extend(more),
            Err(_) => {
                // It has ended, or a person has paused it.
                list().remove(&job.id);
                continue;
            }
        }
        let (name, again) = match lacks {
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
            "job {} is paused, for its {name} cannot be read: {why}",
            job.id
        );
        let text = format!(
            "the job is paused, for its {name} cannot be read: send {again}, and the job goes on"
        );
        c.happened(LogEvent::of_job(Kind::Job, job.id, text));
    }
    let waiting = list()
        .iter()
        .filter(|(_, of)| **of == lacks)
        .map(|(job, _)| *job)
        .collect();
    Ok((waiting, follow_ups))
}

/// Whether a job cannot go on without what is lost.
fn needs(job: &JobRecord, lacks: MissingBlob) -> bool {
    match lacks {
        MissingBlob::Scene(digest) => job.scene == digest,
        MissingBlob::Receivers(digest) => {
            stored_spec::receivers(&job.spec).is_some_and(|ambient| ambient.receivers == digest)
        }
    }
}
