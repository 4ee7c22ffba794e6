//! Partial results: the results of the done tiles of a job. Cells of other tiles show all triangles, as
//! undecided.

use std::io::{self, Write};
use std::sync::{Arc, PoisonError};

use sightline_records::JobState;
use sightline_records::ids::{Digest, JobId};
use sightline_scheduler::{OpenJob, Output};
use sightline_store::{BlobError, StoreError};

use crate::coordinator::Coordinator;
use crate::jobs::stored_spec;
use crate::results::assembly::{AssembleError, AssemblyInput, write};
use crate::results::state::CachedPartial;

/// The reason why no partial result of a job exists.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PartialError {
    /// No tile with cells is done.
    #[error("job {0} has no finished tile with cells yet; try again later")]
    Nothing(JobId),
    /// The job ended or changed during the assembly.
    #[error("job {0} ended or changed during the assembly; send the request again")]
    Changed(JobId),
    /// The caller no longer waits.
    #[error("the caller no longer waits for the result")]
    Gone,
    /// Another version of the program created the job.
    #[error("{0}")]
    Outdated(String),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The outputs cannot be assembled.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
}

/// A file in memory, whose writes fail after the caller has gone.
struct WhileAsked<'a> {
    bytes: Vec<u8>,
    is_gone: &'a (dyn Fn() -> bool + Sync),
}

impl Write for WhileAsked<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if (self.is_gone)() {
            return Err(io::Error::other("the caller has disconnected"));
        }
        self.bytes.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Assembles the partial result of a job, or reads the result of a done job. The coordinator assembles one
/// partial result at a time, and stops if `is_gone` returns true.
pub(crate) fn so_far(
    c: &Coordinator,
    id: JobId,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<Arc<[u8]>, PartialError> {
    let record = c
        .records
        .job(id)?
        .ok_or(StoreError::UnknownJob { job: id })?;
    if let JobState::Done { result, .. } = record.state {
        return Ok(c.blobs.read(&result)?.into());
    }
    let planned = stored_spec::whole(&*c.blobs, &record.spec).map_err(PartialError::Outdated)?;
    let profile = record.profile.clone().unwrap_or_default();
    let job = OpenJob::new(record, Arc::new(planned), c.records.tiles(id)?)
        .map_err(PartialError::Outdated)?;
    let outputs: Vec<Output> = job.tiles.iter().map(|tile| tile.output).collect();
    if !job
        .planned
        .plan()
        .leaves()
        .any(|n| matches!(outputs[n as usize], Output::Done(_)))
    {
        return Err(PartialError::Nothing(id));
    }
    let mut last = c
        .results
        .last_partial
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let names: Vec<Option<Digest>> = outputs.iter().map(Output::digest).collect();
    if let Some(made) = last
        .0
        .as_ref()
        .filter(|made| made.job == id && made.outputs == names)
    {
        return Ok(Arc::clone(&made.bytes));
    }
    let input = AssemblyInput {
        planned: Arc::clone(&job.planned),
        profile,
        outputs,
        samples: job.samples,
    };
    let mut made = WhileAsked {
        bytes: Vec::new(),
        is_gone,
    };
    if let Err(e) = write(c, &input, &mut made) {
        if is_gone() {
            return Err(PartialError::Gone);
        }
        // The job may have ended in the meantime, so that its outputs are now part of its result.
        let ended = c
            .records
            .job(id)?
            .is_none_or(|job| job.state.phase().ended());
        return Err(if ended {
            PartialError::Changed(id)
        } else {
            e.into()
        });
    }
    let bytes: Arc<[u8]> = made.bytes.into();
    last.0 = Some(CachedPartial {
        job: id,
        outputs: names,
        bytes: Arc::clone(&bytes),
    });
    Ok(bytes)
}
