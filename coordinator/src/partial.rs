//! A result of what is done of a job: cells that are not done show everything, as undecided.

use std::sync::{Arc, PoisonError};

use crate::assemble::{AssembleError, Parts, write};
use crate::ids::{Digest, JobId};
use crate::kept::Made;
use crate::scheduler::{Job, Output};
use crate::specs;
use crate::state::Coordinator;
use crate::store::{BlobError, JobState, StoreError};

/// A job of which nothing can be shown.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PartialError {
    /// None of its tiles is done.
    #[error("none of the tiles with cells of job {0} is done yet; try again later")]
    Nothing(JobId),
    /// It ended while this was made.
    #[error("job {0} has ended or changed meanwhile; ask again")]
    Changed(JobId),
    /// Another version of the program began the job.
    #[error("{0}")]
    Outdated(String),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The outputs do not fit together.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
}

/// The result of what is done of a job; the result itself once it is done. One is made at a time.
pub(crate) fn so_far(c: &Coordinator, id: JobId) -> Result<Arc<[u8]>, PartialError> {
    let record = c.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
    if let JobState::Done { result, .. } = record.state {
        return Ok(c.blobs.read(&result)?.into());
    }
    let spec = specs::whole(&*c.blobs, &record.spec).map_err(PartialError::Outdated)?;
    let profile = record.profile.clone().unwrap_or_default();
    let job = Job::of(record, &spec, c.store.tiles(id)?).map_err(PartialError::Outdated)?;
    let outputs: Vec<Output> = job.tiles.iter().map(|tile| tile.output).collect();
    if !job.work.plan.leaves().any(|n| matches!(outputs[n as usize], Output::Done(_))) {
        return Err(PartialError::Nothing(id));
    }
    let mut last = c.last_partial.lock().unwrap_or_else(PoisonError::into_inner);
    let names: Vec<Option<Digest>> = outputs.iter().map(Output::digest).collect();
    if let Some(made) = last.0.as_ref().filter(|made| made.job == id && made.of == names) {
        return Ok(Arc::clone(&made.bytes));
    }
    let parts = Parts { work: Arc::clone(&job.work), profile, outputs, samples: job.samples };
    let mut bytes = Vec::new();
    if let Err(e) = write(c, &parts, &mut bytes) {
        // The job may have ended meanwhile, and its tiles' outputs be in its result.
        let ended = c.store.job(id)?.is_none_or(|job| job.state.phase().ended());
        return Err(if ended { PartialError::Changed(id) } else { e.into() });
    }
    let bytes: Arc<[u8]> = bytes.into();
    last.0 = Some(Made { job: id, of: names, bytes: Arc::clone(&bytes) });
    Ok(bytes)
}
