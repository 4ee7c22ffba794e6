//! Scenes that clients upload as glTF, OBJ or PLY files, which the program's scene loader reads.

use std::sync::Arc;

use sightline_records::SceneRecord;
use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_scene::{KindRule, SceneError};

use crate::coordinator::Coordinator;
use crate::quota::{Sender, Usage};
use crate::uploads::scenes::TakeError;
use crate::uploads::spool::{Spool, SpoolError};
use crate::users::quota_check::QuotaReservation;

/// Maximum size of a file in bytes. The file is in memory while it is read.
const MOST_BYTES: u64 = 1 << 30;

/// The reason why a scene file is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileError {
    /// The file is not a valid scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The file is too long.
    #[error(
        "{bytes} bytes were announced; a scene file has at most {MOST_BYTES}, so send chunks \
         instead"
    )]
    TooLong {
        /// The announced length in bytes.
        bytes: u64,
    },
    /// The bytes of the incomplete file cannot be stored.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// The scene cannot be stored.
    #[error(transparent)]
    Take(#[from] TakeError),
    /// The store has lost the scene.
    #[error("the stored scene is missing; try again")]
    Lost,
}

/// Starts an upload of a file. Checks the quota of its owner and the space for unfinished uploads before the
/// first byte is stored.
///
/// # Errors
/// [`FileError`] if the file is too long, or no space is available.
pub(crate) fn begin(c: &Coordinator, owner: &str, bytes: u64) -> Result<Spool, FileError> {
    if bytes > MOST_BYTES {
        return Err(FileError::TooLong { bytes });
    }
    let quota = QuotaReservation::begin(c, owner);
    quota
        .reserve(
            Usage {
                bytes,
                scenes: 1,
                ..Usage::default()
            },
            0,
        )
        .map_err(TakeError::from)?;
    Ok(Spool::begin(
        &c.uploads,
        &c.telemetry.metrics,
        Sender::User(owner),
        bytes,
    )?)
}

/// Reads a file and stores its scene. Returns the record of the scene and the warnings of the loader. A file
/// that references other files is rejected.
pub(crate) fn take(
    c: &Arc<Coordinator>,
    owner: &str,
    name: &str,
    mut spool: Spool,
    rules: Vec<KindRule>,
) -> Result<(SceneRecord, Vec<String>), FileError> {
    let options = LoadOptions {
        rules,
        ..LoadOptions::default()
    };
    // From here on the scene counts, and the file no longer counts.
    let bytes = spool.bytes(&*c.blobs).map_err(TakeError::from)?;
    let loaded = load_bytes_with(name, &bytes, None, &options)?;
    drop((bytes, spool));
    let digest = c.take_scene_of(owner, &loaded.scene)?;
    let record = c.records.scene(&digest).map_err(TakeError::from)?;
    Ok((record.ok_or(FileError::Lost)?, loaded.warnings))
}
