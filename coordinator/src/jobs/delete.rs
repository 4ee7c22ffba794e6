//! Deletion of ended jobs, with the blobs that no other job references.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError};

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobRecord, JobState, TileState};
use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::jobs::control::{self, JobError, Summary};
use crate::jobs::stored_spec;
use crate::records::{JobChanges, OutputRemoval, Records};
use crate::results::state::PartialCache;
use crate::telemetry::events::{EventKind, LogEvent};

/// Returns the blobs that a job references, apart from its scene. These are its result, the outputs of its
/// tiles, the large parts of its specification, and its receivers.
pub(crate) fn named(records: &Records, job: &JobRecord) -> Result<BTreeSet<Digest>, StoreError> {
    let mut all = BTreeSet::new();
    if let JobState::Done { result, .. } = job.state {
        all.insert(result);
    }
    all.extend(stored_spec::named(&job.spec));
    for tile in records.tiles(job.id)? {
        if let TileState::Done { digest, .. } | TileState::SetAside { digest, .. } = tile.state {
            all.insert(digest);
        }
    }
    Ok(all)
}

/// Removes a deleted job's scene if no job references it and no other user has uploaded it. `changes`
/// prevents submissions in the meantime.
fn forget_scene(changes: &mut JobChanges<'_>, job: &JobRecord) {
    let c = changes.coordinator();
    let record = match c.records.scene(&job.scene) {
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
        // Another job references the scene, or another thread has removed it.
        Err(StoreError::SceneInUse { .. } | StoreError::UnknownScene { .. }) => {}
        Err(e) => tracing::warn!("{e}"),
    }
}

/// Deletes an ended job and the blobs that no other job references. Returns the job's last summary.
pub(crate) fn delete(c: &Arc<Coordinator>, id: JobId) -> Result<Summary, JobError> {
    let mut changes = JobChanges::begin(c);
    // No thread commits outputs during this removal, so a newly committed output is not removed.
    let removal = OutputRemoval::begin(c);
    let was = control::summary(c, id)?;
    let mut free = named(&c.records, &was.record)?;
    changes.delete(id)?;
    for other in c.records.jobs()? {
        if free.is_empty() {
            break;
        }
        // The outputs of a done job are part of its result.
        for digest in named(&c.records, &other)? {
            free.remove(&digest);
        }
    }
    removal.remove(free)?;
    forget_scene(&mut changes, &was.record);
    c.workers.crews.outcomes.sweep(|other, _| other != id);
    *c.results
        .last_partial
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = PartialCache::default();
    *c.results
        .last_queried
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = None;
    c.dispatcher.job_deleted(id);
    tracing::info!("job {id} is deleted");
    c.record_event(LogEvent::of_job(
        EventKind::Job,
        id,
        format!("the job ({}) is deleted", was.record.name),
    ));
    drop(removal);
    changes.finish().run(c);
    Ok(was)
}
