//! A result of what is done of a job: cells that are not done show everything, as undecided.

use std::io::{self, Write};
use std::sync::{Arc, PoisonError};

use sightline_records::JobState;
use sightline_records::ids::{Digest, JobId};
use sightline_scheduler::{Job, Output};
use sightline_store::{BlobError, StoreError};

use crate::jobs::stored_spec;
use crate::kept::CachedPartial;
use crate::results::assembly::{AssembleError, AssemblyInput, write};
use crate::state::Coordinator;

/// A job of which nothing can be shown.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PartialError {
    /// None of its tiles is done.
    #[error("none of the tiles with cells of job {0} is done yet; try again later")]
    Nothing(JobId),
    /// It ended while this was made.
    #[error("job {0} has ended or changed meanwhile; ask again")]
    Changed(JobId),
    /// The asker has gone.
    #[error("the caller no longer waits for the result")]
    Gone,
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

/// A file in memory whose writing ends when the caller has gone.
struct WhileAsked<'a> {
    bytes: Vec<u8>,
    is_gone: &'a (dyn Fn() -> bool + Sync),
}

impl Write for WhileAsked<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if (self.is_gone)() {
            return Err(io::Error::other("the caller has gone"));
        }
        self.bytes.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Makes the partial result of a job, or reads the result of a job that is done. One partial result is made
/// at a time. Stops when the asker `is_gone`.
pub(crate) fn so_far(
    c: &Coordinator,
    id: JobId,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<Arc<[u8]>, PartialError> {
    let record = c.store.job(id)?.ok_or(StoreError::UnknownJob { job: id })?;
    if let JobState::Done { result, .. } = record.state {
        return Ok(c.blobs.read(&result)?.into());
    }
    let work = stored_spec::whole(&*c.blobs, &record.spec).map_err(PartialError::Outdated)?;
    let profile = record.profile.clone().unwrap_or_default();
    let job =
        Job::new(record, Arc::new(work), c.store.tiles(id)?).map_err(PartialError::Outdated)?;
    let outputs: Vec<Output> = job.tiles.iter().map(|tile| tile.output).collect();
    if !job
        .work
        .plan()
        .leaves()
        .any(|n| matches!(outputs[n as usize], Output::Done(_)))
    {
        return Err(PartialError::Nothing(id));
    }
    let mut last = c
        .last_partial
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let names: Vec<Option<Digest>> = outputs.iter().map(Output::digest).collect();
    if let Some(made) = last
        .0
        .as_ref()
        .filter(|made| made.job == id && made.of == names)
    {
        return Ok(Arc::clone(&made.bytes));
    }
    let parts = AssemblyInput {
        work: Arc::clone(&job.work),
        profile,
        outputs,
        samples: job.samples,
    };
    let mut made = WhileAsked {
        bytes: Vec::new(),
        is_gone,
    };
    if let Err(e) = write(c, &parts, &mut made) {
        if is_gone() {
            return Err(PartialError::Gone);
        }
        // The job may have ended meanwhile, and its tiles' outputs be in its result.
        let ended = c.store.job(id)?.is_none_or(|job| job.state.phase().ended());
        return Err(if ended {
            PartialError::Changed(id)
        } else {
            e.into()
        });
    }
    let bytes: Arc<[u8]> = made.bytes.into();
    last.0 = Some(CachedPartial {
        job: id,
        of: names,
        bytes: Arc::clone(&bytes),
    });
    Ok(bytes)
}
