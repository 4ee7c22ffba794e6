//! The outputs of jobs of ambient occlusion: the check of a tile's output, and the assembly of all outputs
//! into one result.

use std::io::{self, Write};

use sightline_model::Ambient;
use sightline_model::openness::{Openness, OpennessError, ResultWriter};
use sightline_model::receivers::Facts;
use sightline_viewcells::TileIndex;

use crate::{OutputState, Outputs};

/// The error of an output that cannot be checked or joined to a result.
#[derive(Debug, thiserror::Error)]
pub enum AnswerError<E> {
    /// An output cannot be read.
    #[error(transparent)]
    Read(E),
    /// An output does not fit its tile.
    #[error(transparent)]
    Openness(OpennessError),
    /// The job has no tile with the requested number.
    #[error("the job has no tile with the requested number")]
    NoTile,
    /// The result cannot be written.
    #[error("the result cannot be written: {0}")]
    Write(io::Error),
}

/// Checks the output of a tile and returns the number of the tile's receivers.
///
/// # Errors
/// [`AnswerError::NoTile`] if the job has no such tile; [`AnswerError::Openness`] if the output does not fit
/// the tile.
pub fn check<E>(
    ambient: &Ambient,
    facts: &Facts,
    tile: TileIndex,
    bytes: &[u8],
) -> Result<u64, AnswerError<E>> {
    let points = facts.receivers_of(tile).ok_or(AnswerError::NoTile)?;
    Openness::decode(bytes, points, ambient.numbers()).map_err(AnswerError::Openness)?;
    Ok(points.into())
}

/// Writes the result of a job and returns its length in bytes. All values of receivers of tiles that are not
/// done or were set aside are NaN. Outputs are read one at a time.
///
/// # Errors
/// [`AnswerError`] if an output cannot be read or decoded, or the result cannot be written.
pub fn write<O: Outputs>(
    ambient: &Ambient,
    facts: &Facts,
    outputs: &O,
    out: &mut impl Write,
) -> Result<u64, AnswerError<O::Error>> {
    let begun = ResultWriter::begin(out, ambient.points, ambient.numbers());
    let mut writer = begun.map_err(AnswerError::Write)?;
    for tile in (0..facts.tiles()).map(TileIndex) {
        let points = facts.receivers_of(tile).ok_or(AnswerError::NoTile)?;
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

/// Encodes the placeholder of a tile: an output without values.
pub(crate) fn placeholder(ambient: &Ambient) -> Result<Vec<u8>, io::Error> {
    Openness {
        numbers: ambient.numbers(),
        values: Vec::new(),
        bound: 0.0,
    }
    .encode()
}
