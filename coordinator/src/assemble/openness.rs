//! The answers of jobs of ambient occlusion: a tile's output is checked, and the outputs of all tiles become
//! one result.

use std::io::Write;

use sightline_model::Ambient;
use sightline_model::openness::{Openness, OpennessError, ResultWriter};

use crate::ids::TileIndex;
use crate::scheduler::Output;
use crate::state::Coordinator;
use crate::store::BlobError;
use crate::uploads::receivers::{self, Fault};

/// An output or a result that cannot be had.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AnswerError {
    /// The receivers of the job cannot be read.
    #[error("the job's receivers: {0}")]
    Receivers(Fault),
    /// An output is not that of its tile.
    #[error(transparent)]
    Openness(#[from] OpennessError),
    /// The job has no such tile.
    #[error("the job has no such tile")]
    NoTile,
    /// A blob cannot be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

impl From<Fault> for AnswerError {
    fn from(e: Fault) -> Self {
        match e {
            Fault::Blob(e) if e.passes() => Self::Blob(e),
            e => Self::Receivers(e),
        }
    }
}

/// The number of receivers of a tile, whose output this is.
pub(crate) fn check(
    c: &Coordinator,
    ambient: &Ambient,
    tile: TileIndex,
    bytes: &[u8],
) -> Result<u64, AnswerError> {
    let stored = receivers::stored(c, ambient.receivers)?;
    let points = stored
        .facts
        .receivers_of(tile.0)
        .ok_or(AnswerError::NoTile)?;
    Openness::decode(bytes, points, ambient.numbers())?;
    Ok(points.into())
}

/// Writes the result of a job and returns its length. Receivers of tiles that are not done or were set aside
/// have no answer. Outputs are read one at a time.
pub(crate) fn write(
    c: &Coordinator,
    ambient: &Ambient,
    outputs: &[Output],
    out: &mut impl Write,
) -> Result<u64, AnswerError> {
    let full = |e| AnswerError::Blob(c.blobs.io_error(e));
    let stored = receivers::stored(c, ambient.receivers)?;
    let mut writer = ResultWriter::begin(out, ambient.points, ambient.numbers()).map_err(full)?;
    for (tile, output) in (0u32..).zip(outputs) {
        let points = stored.facts.receivers_of(tile).ok_or(AnswerError::NoTile)?;
        if let Output::Done(digest) = output {
            let tile = Openness::decode(&c.blobs.read(digest)?, points, ambient.numbers())?;
            writer.push(&tile).map_err(full)?;
        } else {
            writer.push_missing(points).map_err(full)?;
        }
    }
    writer.end().map_err(full)
}

/// The bytes that stand for the output of a tile that was set aside.
///
/// # Errors
/// When compression fails.
pub(crate) fn stand_in(ambient: &Ambient) -> Result<Vec<u8>, std::io::Error> {
    Openness {
        numbers: ambient.numbers(),
        values: Vec::new(),
        bound: 0.0,
    }
    .encode()
}
