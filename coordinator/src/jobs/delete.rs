//! Deleting a job that has ended, with the blobs that it alone needs.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError};

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobRecord, JobState, TileState};
use sightline_store::StoreError;

use crate::jobs::control::{self, JobError, Summary};
use crate::jobs::stored_spec;
use crate::kept::PartialCache;
use crate::records::{JobChanges, OutputRemoval};
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};

/// The blobs that a job names, apart from its scene: its result, the outputs of its tiles, the large parts of
/// its specification, and its receivers.
pub(crate) fn named(c: &Coordinator, job: &JobRecord) -> Result<BTreeSet<Digest>, StoreError> {
    let mut all = BTreeSet::new();
    if let JobState::Done { result, .. } = job.state {
        all.insert(result);
    }
    all.extend(stored_spec::named(&job.spec));
    for tile in c.store.tiles(job.id)? {
        if let TileState::Done { digest, .. } | TileState::SetAside { digest, .. } = tile.state {
            all.insert(digest);
        }
    }
    Ok(all)
}

/// Removes a deleted job's scene if no job names it and no other user has sent it. No job is submitted in the
/// meantime.
fn forget_scene(changes: &mut JobChanges<'_>, job: &JobRecord) {
    let c = changes.coordinator();
    let record = match c.store.scene(&job.scene) {
        Ok(Some(record)) => record,
        Ok(None) => return,
        Err(e) => return tracing::warn!("{e}"),
    };
    if record.owners.iter().any(|owner| *owner != job.owner) {
        return;
    }
    match changes.delete_scene(job.scene) {
        Ok(_) => {
            if let Err(e) = c.blobs.remove(&job.scene) {
                tracing::warn!("{e}");
            }
        }
        // Another job's, or somebody was faster.
        Err(StoreError::SceneInUse { .. } | StoreError::UnknownScene { .. }) => {}
        Err(e) => tracing::warn!("{e}"),
    }
}

/// Deletes a job that has ended, with all that no other job needs; returns what it was.
pub(crate) fn delete(c: &Arc<Coordinator>, id: JobId) -> Result<Summary, JobError> {
    let mut changes = JobChanges::begin(c);
    // No output is committed meanwhile, so none that is committed is removed.
    let removal = OutputRemoval::begin(c);
    let was = control::summary(c, id)?;
    let mut free = named(c, &was.record)?;
    changes.delete(id)?;
    for other in c.store.jobs()? {
        if free.is_empty() {
            break;
        }
        // A done job's outputs are in its result.
        for digest in named(c, &other)? {
            free.remove(&digest);
        }
    }
    removal.remove(free)?;
    forget_scene(&mut changes, &was.record);
    c.crews.outcomes.sweep(|other| other != id);
    *c.last_partial
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = PartialCache::default();
    *c.last_asked.lock().unwrap_or_else(PoisonError::into_inner) = None;
    c.watched().changed(id, true);
    tracing::info!("job {id} is deleted");
    c.happened(LogEvent::of_job(
        Kind::Job,
        id,
        format!("the job ({}) is deleted", was.record.name),
    ));
    drop(removal);
    changes.finish().run(c);
    Ok(was)
}
