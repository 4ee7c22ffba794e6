//! The answers of jobs of ambient occlusion: a tile's output is checked, and the outputs of all tiles become
//! one result.

use std::io::{self, Write};

use sightline_model::Ambient;
use sightline_model::openness::{Openness, OpennessError, ResultWriter};
use sightline_model::receivers::Facts;

use crate::{OutputState, Outputs};

/// An answer that cannot be checked or joined.
#[derive(Debug, thiserror::Error)]
pub enum AnswerError<E> {
    /// An output cannot be read.
    #[error(transparent)]
    Read(E),
    /// An output is not that of its tile.
    #[error(transparent)]
    Openness(OpennessError),
    /// The job has no such tile.
    #[error("the job has no such tile")]
    NoTile,
    /// The result cannot be written.
    #[error("the result cannot be written: {0}")]
    Write(io::Error),
}

/// Checks the output of a tile and returns the number of its receivers.
///
/// # Errors
/// [`AnswerError`] for an output that is not that of the tile.
pub fn check<E>(
    ambient: &Ambient,
    of: &Facts,
    tile: u32,
    bytes: &[u8],
) -> Result<u64, AnswerError<E>> {
    let points = of.receivers_of(tile).ok_or(AnswerError::NoTile)?;
    Openness::decode(bytes, points, ambient.numbers()).map_err(AnswerError::Openness)?;
    Ok(points.into())
}

/// Writes the result of a job and returns its length. Receivers of tiles that are not done or were set aside
/// have no answer. Outputs are read one at a time.
///
/// # Errors
/// [`AnswerError`].
pub fn write<O: Outputs>(
    ambient: &Ambient,
    of: &Facts,
    outputs: &O,
    out: &mut impl Write,
) -> Result<u64, AnswerError<O::Error>> {
    let begun = ResultWriter::begin(out, ambient.points, ambient.numbers());
    let mut writer = begun.map_err(AnswerError::Write)?;
    for tile in 0..of.tiles() {
        let points = of.receivers_of(tile).ok_or(AnswerError::NoTile)?;
        let written = match outputs.state(tile) {
            OutputState::Done => {
                let bytes = outputs.read(tile).map_err(AnswerError::Read)?;
                let answers = Openness::decode(&bytes, points, ambient.numbers());
                writer.push(&answers.map_err(AnswerError::Openness)?)
            }
            OutputState::Open | OutputState::SetAside => writer.push_missing(points),
        };
        written.map_err(AnswerError::Write)?;
    }
    writer.end().map_err(AnswerError::Write)
}

/// Encodes the placeholder of a tile.
pub(crate) fn placeholder(ambient: &Ambient) -> Result<Vec<u8>, io::Error> {
    Openness {
        numbers: ambient.numbers(),
        values: Vec::new(),
        bound: 0.0,
    }
    .encode()
}
