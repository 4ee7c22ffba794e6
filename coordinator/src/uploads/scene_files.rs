//! Scenes that clients send as files: glTF, OBJ and PLY, read by the loader that the program uses.

use std::sync::Arc;

use sightline_records::SceneRecord;
use sightline_scene::load::{Options, load_bytes_with};
use sightline_scene::{Rule, SceneError};

use crate::quota::{Sender, Usage};
use crate::state::Coordinator;
use crate::uploads::scenes::TakeError;
use crate::uploads::spool::{Spool, SpoolError};
use crate::users::quota_check::{reserve_quota, turn_of};

/// Most bytes of a file. It is in memory while it is read.
const MOST_BYTES: u64 = 1 << 30;

/// A file that is not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileError {
    /// It is no scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The file is too long.
    #[error(
        "{bytes} bytes were announced; a scene file has at most {MOST_BYTES}, so send chunks instead"
    )]
    TooLong {
        /// The announced length.
        bytes: u64,
    },
    /// The bytes of the file cannot be stored until all have arrived.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// It cannot be stored.
    #[error(transparent)]
    Take(#[from] TakeError),
    /// The store lost it.
    #[error("the scene was stored and is not there; try again")]
    Lost,
}

/// Begins a file of the given number of bytes. The quota of its owner and the room for unfinished uploads are
/// checked before the first byte is kept.
///
/// # Errors
/// [`FileError`] when the file is too long, or there is no room for it.
pub(crate) fn begin(c: &Coordinator, owner: &str, bytes: u64) -> Result<Spool, FileError> {
    if bytes > MOST_BYTES {
        return Err(FileError::TooLong { bytes });
    }
    let _turn = turn_of(c, owner);
    reserve_quota(
        c,
        owner,
        Usage {
            bytes,
            scenes: 1,
            ..Usage::default()
        },
        0,
    )
    .map_err(TakeError::from)?;
    Ok(Spool::begin(c, Sender::User(owner), bytes)?)
}

/// Reads a file and stores its scene; the warnings of the loader come with it. A file is alone: what it names
/// beside itself is refused.
pub(crate) fn take(
    c: &Arc<Coordinator>,
    owner: &str,
    name: &str,
    mut spool: Spool,
    rules: Vec<Rule>,
) -> Result<(SceneRecord, Vec<String>), FileError> {
    let options = Options {
        rules,
        ..Options::default()
    };
    // From here on the scene counts, and the file no longer does.
    let bytes = spool.bytes(c).map_err(TakeError::from)?;
    let loaded = load_bytes_with(name, &bytes, None, &options)?;
    drop((bytes, spool));
    let digest = c.take_scene_of(owner, &loaded.scene)?;
    let record = c.store.scene(&digest).map_err(TakeError::from)?;
    Ok((record.ok_or(FileError::Lost)?, loaded.warnings))
}
