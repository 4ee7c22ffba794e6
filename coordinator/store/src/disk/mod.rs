//! The disk under the journal, its watermark and the blobs: the file operations that durability depends on.
//!
//! [`SystemDisk`] passes each operation to the operating system. Tests replace it by a simulated disk that
//! loses, reorders, tears and misdirects unsynced writes (`simulated.rs`).

mod api;
mod system;
mod unreadable;

#[cfg(any(test, feature = "simulation"))]
pub(crate) mod simulated;

use std::io::{self, Read as _, Write as _};
use std::path::Path;

pub(crate) use api::{Access, Disk, DiskFile};
pub(crate) use system::SystemDisk;
pub(crate) use unreadable::{ZeroUnreadable, is_unreadable};

/// Writes a file in one atomic step. After a crash, the path names the old content or the new content.
///
/// `beside` is a path in the same folder that has no other use.
pub(crate) fn replace(
    disk: &dyn Disk,
    path: &Path,
    beside: &Path,
    content: &[u8],
) -> io::Result<()> {
    remove_if_present(disk, beside)?;
    let mut file = disk.open(beside, Access::Create)?;
    file.write_all(content)?;
    file.sync()?;
    drop(file);
    disk.rename(beside, path)?;
    disk.sync_folder(path.parent().unwrap_or(Path::new(".")))
}

/// Creates a folder and its missing parents, and makes their names durable.
pub(crate) fn create_folder(disk: &dyn Disk, path: &Path) -> io::Result<()> {
    let mut unsynced = Vec::new();
    for folder in path.ancestors().skip(1) {
        // The last ancestor of a relative path is empty and means the current folder.
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        unsynced.push(folder);
        // If the folder exists, its name was made durable earlier.
        if disk.list(folder).is_ok() {
            break;
        }
    }
    disk.create_folder(path)?;
    unsynced
        .into_iter()
        .try_for_each(|folder| disk.sync_folder(folder))
}

/// Removes a file that a crash may have left.
pub(crate) fn remove_if_present(disk: &dyn Disk, path: &Path) -> io::Result<()> {
    match disk.remove(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

/// Reads at most the first `limit` bytes of a file.
pub(crate) fn read_up_to(disk: &dyn Disk, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    disk.open(path, Access::Read)?
        .take(limit)
        .read_to_end(&mut bytes)?;
    Ok(bytes)
}
