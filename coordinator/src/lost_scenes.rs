//! Scenes whose file is lost or damaged: no worker can go on with their jobs, so these are paused until
//! somebody sends the scene again.
//!
//! Which jobs wait is kept in memory. After a restart they are paused as by a person, and go on with
//! `resume`.

use std::sync::{Arc, PoisonError};

use crate::chronicle::{Happening, Kind};
use crate::ids::Digest;
use crate::jobs;
use crate::state::Coordinator;
use crate::store::{JobPhase, StoreError};

/// Pauses the jobs of a scene that cannot be read.
pub(crate) fn lost(c: &Arc<Coordinator>, scene: &Digest, why: &str) -> Result<(), StoreError> {
    if c.store.scene(scene)?.is_none() {
        return Ok(());
    }
    for job in c.store.jobs()? {
        let works = matches!(job.state.phase(), JobPhase::Queued | JobPhase::Running);
        // It may end or be paused meanwhile; then it waits for nothing.
        if !works || job.scene != *scene || jobs::pause(c, job.id, true).is_err() {
            continue;
        }
        c.lost_scenes.lock().unwrap_or_else(PoisonError::into_inner).insert(job.id, *scene);
        let text = format!(
            "the job is paused, for its scene cannot be read ({why}): send the scene again, with \
             `sightline submit` and the same file, and the job goes on"
        );
        tracing::error!("job {}: {text}", job.id);
        c.happened(Happening::of_job(Kind::Job, job.id, text));
    }
    Ok(())
}

/// Continues the jobs that have waited for a scene, which is there again.
pub(crate) fn back(c: &Arc<Coordinator>, scene: &Digest) {
    let mut waiting = Vec::new();
    c.lost_scenes.lock().unwrap_or_else(PoisonError::into_inner).retain(|job, of| {
        if of == scene {
            waiting.push(*job);
        }
        of != scene
    });
    for job in waiting {
        // Somebody may have resumed, cancelled or deleted it.
        if let Err(e) = jobs::resume(c, job) {
            tracing::info!("job {job} does not go on, though its scene is there again: {e}");
        }
    }
}
