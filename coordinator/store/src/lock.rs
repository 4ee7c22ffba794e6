//! The lock of a directory that belongs to one process.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::sync::Arc;

use super::error::StoreError;
use super::private::create_private;

/// A directory of which this process is the only user, until this is dropped.
#[derive(Debug)]
pub struct OwnDirectory(
    #[allow(dead_code, reason = "its lock is released when it is dropped")] File,
);

impl OwnDirectory {
    /// Creates the directory if it is missing and takes its lock.
    ///
    /// # Errors
    /// [`StoreError::InUse`] when another process has it, [`StoreError::Io`].
    pub fn take(directory: &Path) -> Result<Self, StoreError> {
        create_private(directory).map_err(fault("create", directory))?;
        lock(&directory.join("lock")).map(Self)
    }
}

/// Takes the directory's lock, which the system releases when the process ends, however it ends.
pub(super) fn lock(path: &Path) -> Result<File, StoreError> {
    let mut file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
        .map_err(fault("open", path))?;
    held(file.try_lock(), &mut file, path)?;
    file.set_len(0)
        .and_then(|()| file.write_all(std::process::id().to_string().as_bytes()))
        .map_err(fault("write", path))?;
    Ok(file)
}

/// Locks the file at `path` without changing it. Returns `None` if there is no such file.
pub(super) fn probe(path: &Path) -> Result<Option<File>, StoreError> {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(fault("open", path)(e)),
    };
    held(file.try_lock(), &mut file, path)?;
    Ok(Some(file))
}

/// Returns the error of a lock that another process holds.
fn held(taken: Result<(), TryLockError>, file: &mut File, path: &Path) -> Result<(), StoreError> {
    match taken {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => {
            let mut pid = String::new();
            // Only for the message; its holder may not have written it yet.
            let known = file.read_to_string(&mut pid).is_ok() && !pid.trim().is_empty();
            let pid = if known {
                pid.trim().to_owned()
            } else {
                "not known".to_owned()
            };
            Err(StoreError::InUse {
                path: path.to_owned(),
                pid,
            })
        }
        Err(TryLockError::Error(source)) => Err(fault("lock", path)(source)),
    }
}

/// What failed while `doing` something to a path of the store.
pub(super) fn fault(doing: &'static str, path: &Path) -> impl Fn(std::io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Io {
        doing,
        path: path.clone(),
        source: Arc::new(source),
    }
}
