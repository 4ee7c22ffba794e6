//! The assembly of a job's result from the store's blobs.

use std::io::{BufWriter, Write};
use std::sync::Arc;

use sightline_assemble::openness::{self, AnswerError};
use sightline_assemble::{Assembly, OutputState, Outputs};
use sightline_model::{Granularity, PlannedJob, Task};
use sightline_pvs::{Items, PvsError};
use sightline_records::ids::{Digest, TileIndex};
use sightline_scene::{Scene, SceneError};
use sightline_scheduler::Output;
use sightline_store::{BlobError, Blobs};

use crate::coordinator::Coordinator;
use crate::uploads::receivers::StoredReceiversError;
use crate::uploads::scenes::{FactsError, facts};

/// A result that cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AssembleError {
    /// A blob could not be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The scene cannot be read.
    #[error(transparent)]
    Facts(#[from] FactsError),
    /// The scene's blob is not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The receivers of the job cannot be read.
    #[error("the job's receivers: {0}")]
    Receivers(StoredReceiversError),
    /// The outputs cannot be joined.
    #[error(transparent)]
    Outputs(sightline_assemble::AssembleError<BlobError>),
    /// The answers of an ambient occlusion job cannot be joined.
    #[error(transparent)]
    Answers(AnswerError<BlobError>),
}

impl From<StoredReceiversError> for AssembleError {
    fn from(e: StoredReceiversError) -> Self {
        match e {
            StoredReceiversError::Blob(e) if e.passes() => Self::Blob(e),
            e => Self::Receivers(e),
        }
    }
}

impl AssembleError {
    /// Returns true if the same assembly may succeed later.
    pub(crate) fn passes(&self) -> bool {
        self.of_blob().is_some_and(BlobError::passes)
    }

    /// Returns true if an input of the result must be uploaded or computed again.
    pub(crate) fn is_lost(&self) -> bool {
        self.of_blob().is_some_and(BlobError::is_lost)
    }

    fn of_blob(&self) -> Option<&BlobError> {
        match self {
            Self::Blob(e)
            | Self::Facts(FactsError::Blob(e))
            | Self::Receivers(StoredReceiversError::Blob(e)) => Some(e),
            _ => None,
        }
    }
}

/// Converts an error of the outputs. A full disk is a blob error, because the coordinator waits for space.
fn of_outputs(blobs: &dyn Blobs, e: sightline_assemble::AssembleError<BlobError>) -> AssembleError {
    match e {
        sightline_assemble::AssembleError::Read(e) => e.into(),
        sightline_assemble::AssembleError::Pvs(PvsError::Write(e)) => blobs.io_error(e).into(),
        e => AssembleError::Outputs(e),
    }
}

/// Converts an error of the answers of an ambient occlusion job.
fn of_answers(blobs: &dyn Blobs, e: AnswerError<BlobError>) -> AssembleError {
    match e {
        AnswerError::Read(e) => e.into(),
        AnswerError::Write(e) => blobs.io_error(e).into(),
        e => AssembleError::Answers(e),
    }
}

/// The number of bytes of a result that are hashed and written at a time.
const WRITTEN_AT_ONCE: usize = 1 << 20;

/// The inputs of the assembly of a job's result.
pub(crate) struct AssemblyInput {
    pub(crate) planned: Arc<PlannedJob>,
    pub(crate) profile: String,
    /// The output of each tile.
    pub(crate) outputs: Vec<Output>,
    /// The number of samples of done tiles.
    pub(crate) samples: u64,
}

/// The outputs of a job's tiles, in blobs.
struct StoredOutputs<'a> {
    blobs: &'a dyn Blobs,
    outputs: &'a [Output],
}

impl Outputs for StoredOutputs<'_> {
    type Error = BlobError;

    fn state(&self, tile: TileIndex) -> OutputState {
        match self.outputs[tile.at()] {
            Output::Open => OutputState::Open,
            Output::Done(_) => OutputState::Done,
            Output::SetAside(_) => OutputState::SetAside,
        }
    }

    fn read(&self, tile: TileIndex) -> Result<Vec<u8>, BlobError> {
        match self.outputs[tile.at()].digest() {
            Some(digest) => self.blobs.read(&digest),
            // An open tile has no output, and `Outputs` permits no read of it.
            None => Ok(Vec::new()),
        }
    }
}

/// Builds the result of a complete job and stores it. Returns the blob's digest and length in bytes.
pub(crate) fn assemble(
    c: &Coordinator,
    input: &AssemblyInput,
) -> Result<(Digest, u64), AssembleError> {
    let mut file = c.blobs.put_stream()?;
    let mut buffered = BufWriter::with_capacity(WRITTEN_AT_ONCE, &mut file);
    let bytes = write(c, input, &mut buffered)?;
    buffered.flush().map_err(|e| c.blobs.io_error(e))?;
    drop(buffered);
    Ok((file.finish(None)?, bytes))
}

/// Writes the result of a job and returns its length in bytes. Cells of tiles that are open or set aside show
/// all triangles, as undecided.
pub(crate) fn write(
    c: &Coordinator,
    input: &AssemblyInput,
    out: &mut impl Write,
) -> Result<u64, AssembleError> {
    let blobs = &*c.blobs;
    let outputs = StoredOutputs {
        blobs,
        outputs: &input.outputs,
    };
    let task = match &input.planned.spec().task {
        Task::Ambient(ambient) => {
            let stored = c.uploads.receivers(&*c.blobs, ambient.receivers)?;
            let written = openness::write(ambient, &stored.facts, &outputs, out);
            return written.map_err(|e| of_answers(blobs, e));
        }
        Task::Visibility(task) => task,
    };
    let digest = &input.planned.spec().scene;
    let scene = facts(c, digest)?;
    let assembly = Assembly {
        job: &input.planned,
        profile: &input.profile,
        samples: input.samples,
        scene: &scene,
        items: items(blobs, digest, task.items())?,
        outputs: &outputs,
        scratch: match task.has_certificates() {
            true => blobs.scratch()?,
            false => None,
        },
    };
    sightline_assemble::write(assembly, task, out).map_err(|e| of_outputs(blobs, e))
}

/// Returns the items of a stored scene, or `None` if the items are triangles.
fn items(
    blobs: &dyn Blobs,
    scene: &Digest,
    items: Granularity,
) -> Result<Option<Items>, AssembleError> {
    if items == Granularity::Triangles {
        return Ok(None);
    }
    let scene = Scene::from_blob("stored scene", &blobs.read(scene)?)?;
    Ok(sightline_assemble::items(&scene, items))
}
