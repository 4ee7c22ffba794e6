//! Scenes that clients send as files: glTF, OBJ and PLY, read by the loader that the program uses.

use std::sync::Arc;

use sightline_scene::load::{Options, load_bytes_with};
use sightline_scene::{Rule, SceneError};

use crate::scenes::TakeError;
use crate::state::Coordinator;
use crate::store::SceneRecord;

/// Most bytes of a file. It is in memory while it is read.
pub(crate) const MOST_BYTES: u64 = 1 << 30;

/// A file that is not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileError {
    /// It is no scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It cannot be stored.
    #[error(transparent)]
    Take(#[from] TakeError),
    /// The store lost it.
    #[error("the scene was stored and is not there; try again")]
    Lost,
}

/// Reads a file and stores its scene; the warnings of the loader come with it. A file is alone: what it names
/// beside itself is refused.
pub(crate) fn take(
    c: &Arc<Coordinator>,
    owner: &str,
    name: &str,
    bytes: &[u8],
    rules: Vec<Rule>,
) -> Result<(SceneRecord, Vec<String>), FileError> {
    let options = Options { rules, ..Options::default() };
    let loaded = load_bytes_with(name, bytes, None, &options)?;
    let digest = c.take_scene_of(owner, &loaded.scene)?;
    let record = c.store.scene(&digest).map_err(TakeError::from)?;
    Ok((record.ok_or(FileError::Lost)?, loaded.warnings))
}
