//! Scenes whose file is lost or damaged: no worker that lacks the scene can go on with its jobs, so these are
//! paused until somebody sends it again.
//!
//! Which jobs wait is kept in memory. After a restart they are paused as by a person, and go on with
//! `resume`.

use std::sync::{Arc, PoisonError};

use crate::chronicle::{Happening, Kind};
use crate::ids::Digest;
use crate::jobs;
use crate::state::Coordinator;
use crate::store::{JobPhase, StoreError};

/// Pauses the jobs of a scene that cannot be read. Workers that have it finish their tiles.
pub(crate) fn lost(c: &Arc<Coordinator>, scene: &Digest, why: &str) -> Result<(), StoreError> {
    let _turn = c.scenes_turn();
    // Somebody may have sent it since it was found damaged.
    if c.store.scene(scene)?.is_none() || c.blobs.open_checked(scene).is_ok() {
        return Ok(());
    }
    for job in c.store.jobs()? {
        let works = matches!(job.state.phase(), JobPhase::Queued | JobPhase::Running);
        if !works || job.scene != *scene {
            continue;
        }
        // Before the pause: whoever resumes the job after it takes it off the list.
        let list = || c.lost_scenes.lock().unwrap_or_else(PoisonError::into_inner);
        list().insert(job.id, *scene);
        if jobs::park(c, job.id).is_err() {
            // It has ended, or a person has paused it.
            list().remove(&job.id);
            continue;
        }
        tracing::error!("job {} is paused, for its scene cannot be read: {why}", job.id);
        let text = "the job is paused, for its scene cannot be read: send the scene again, with `sightline \
                    submit` and the same file, and the job goes on";
        c.happened(Happening::of_job(Kind::Job, job.id, text));
    }
    Ok(())
}

/// Continues the jobs that have waited for a scene, which is there again.
pub(crate) fn back(c: &Arc<Coordinator>, scene: &Digest) {
    let _turn = c.scenes_turn();
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
