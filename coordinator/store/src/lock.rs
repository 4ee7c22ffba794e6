//! The lock of a directory that belongs to one process.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::sync::Arc;

use super::error::StoreError;
use super::private::create_private;

/// A directory that only this process uses, until the value is dropped.
#[derive(Debug)]
pub struct OwnDirectory(
    #[allow(dead_code, reason = "its lock is released when it is dropped")] File,
);

impl OwnDirectory {
    /// Creates the directory if it is missing, and locks it.
    ///
    /// # Errors
    /// [`StoreError::InUse`] if another process has locked it; [`StoreError::Io`] if a file operation fails.
    pub fn take(directory: &Path) -> Result<Self, StoreError> {
        create_private(directory).map_err(fault("create", directory))?;
        lock(&directory.join("lock")).map(Self)
    }
}

/// Locks the directory. The system releases the lock when the process ends for any reason.
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

/// Locks the file at `path` without changing it. Returns `None` if the file does not exist.
pub(super) fn probe(path: &Path) -> Result<Option<File>, StoreError> {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(fault("open", path)(e)),
    };
    held(file.try_lock(), &mut file, path)?;
    Ok(Some(file))
}

/// Returns an error if another process holds the lock.
fn held(taken: Result<(), TryLockError>, file: &mut File, path: &Path) -> Result<(), StoreError> {
    match taken {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => {
            let mut pid = String::new();
            // The pid is only for the message; the other process may not have written it yet.
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

/// Returns a function that creates the error of an operation (`doing`) on a path of the store.
pub(super) fn fault(doing: &'static str, path: &Path) -> impl Fn(std::io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Io {
        doing,
        path: path.clone(),
        source: Arc::new(source),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probe_finds_lock_and_changes_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        assert!(probe(&path).unwrap().is_none(), "the file does not exist");
        assert!(!path.exists());
        let held = lock(&path).unwrap();
        let pid = std::process::id().to_string();
        match probe(&path).unwrap_err() {
            StoreError::InUse { pid: holder, .. } => assert_eq!(holder, pid),
            other => panic!("{other}"),
        }
        drop(held);
        assert!(probe(&path).unwrap().is_some());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), pid);
        // Other faults are errors.
        let below = path.join("lock");
        assert!(matches!(
            probe(&below).unwrap_err(),
            StoreError::Io { doing: "open", .. }
        ));
    }
}
