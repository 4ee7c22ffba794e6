//! Scenes and receivers whose file is lost or damaged: no worker that lacks them can go on with their jobs,
//! so these are paused until somebody sends them again.
//!
//! Which jobs wait is kept in memory. After a restart they are paused as by a person, and go on with
//! `resume`.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError};

use crate::chronicle::{Happening, Kind};
use crate::ids::JobId;
use crate::jobs;
use crate::specs;
use crate::state::{Coordinator, Lacks};
use crate::store::{JobPhase, JobRecord, StoreError};

/// Pauses the jobs of a scene or of receivers that cannot be read. Workers that have them finish their tiles.
/// Nothing happens where no job names them. Returns the jobs that wait for them.
pub(crate) fn lost(c: &Arc<Coordinator>, lacks: Lacks, why: &str) -> Result<BTreeSet<JobId>, StoreError> {
    let _turn = c.lost_turn();
    // Somebody may have sent it since it was found damaged.
    if c.blobs.open_checked(&lacks.digest()).is_ok() {
        return Ok(BTreeSet::new());
    }
    let list = || c.lost.lock().unwrap_or_else(PoisonError::into_inner);
    for job in c.store.jobs()? {
        let works = matches!(job.state.phase(), JobPhase::Queued | JobPhase::Running);
        if !works || !needs(&job, lacks) {
            continue;
        }
        // Before the pause: whoever resumes the job after it takes it off the list.
        list().insert(job.id, lacks);
        if jobs::park(c, job.id).is_err() {
            // It has ended, or a person has paused it.
            list().remove(&job.id);
            continue;
        }
        let (name, again) = match lacks {
            Lacks::Scene(_) => ("scene", "the scene again, with `sightline submit` and the same file"),
            Lacks::Receivers(_) => {
                ("receivers", "the receivers again, with the `sightline ambient` that made the job")
            }
        };
        tracing::error!("job {} is paused, for its {name} cannot be read: {why}", job.id);
        let text =
            format!("the job is paused, for its {name} cannot be read: send {again}, and the job goes on");
        c.happened(Happening::of_job(Kind::Job, job.id, text));
    }
    Ok(list().iter().filter(|(_, of)| **of == lacks).map(|(job, _)| *job).collect())
}

/// Whether a job cannot go on without what is lost.
fn needs(job: &JobRecord, lacks: Lacks) -> bool {
    match lacks {
        Lacks::Scene(digest) => job.scene == digest,
        Lacks::Receivers(digest) => {
            specs::receivers(&job.spec).is_some_and(|ambient| ambient.receivers == digest)
        }
    }
}

/// Continues the jobs that have waited for something, which is there again.
pub(crate) fn back(c: &Arc<Coordinator>, lacks: Lacks) {
    let _turn = c.lost_turn();
    let mut waiting = Vec::new();
    c.lost.lock().unwrap_or_else(PoisonError::into_inner).retain(|job, of| {
        if *of == lacks {
            waiting.push(*job);
        }
        *of != lacks
    });
    for job in waiting {
        // Somebody may have resumed, cancelled or deleted it.
        if let Err(e) = jobs::resume(c, job) {
            tracing::info!("job {job} does not go on, though what it lacked is there again: {e}");
        }
    }
}
