//! The operations of a disk and of its files.

use std::fmt;
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The way in which a file is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// An existing file, for reading.
    Read,
    /// An existing file, for reading and writing.
    Update,
    /// A new file, for reading and writing; an existing file is an error.
    Create,
}

/// The attributes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Attributes {
    /// The length in bytes.
    pub(crate) length: u64,
    /// The time of the last write, or the time that [`Disk::date`] has set.
    pub(crate) modified: SystemTime,
}

/// An open file. Reading and writing move one position, as in [`std::fs::File`].
pub(crate) trait DiskFile: Read + Write + Seek + Send {
    /// Makes the content of the file durable.
    fn sync(&self) -> io::Result<()>;

    /// Cuts or extends the file. The position stays.
    fn set_length(&self, length: u64) -> io::Result<()>;
}

/// A file system. A new, renamed or removed name is durable after [`Disk::sync_folder`] of its folder.
pub(crate) trait Disk: fmt::Debug + Send + Sync {
    /// Opens a file.
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>>;

    /// Returns the attributes of a file, or `None` if the file does not exist.
    fn attributes(&self, path: &Path) -> io::Result<Option<Attributes>>;

    /// Creates a folder and its missing parents.
    fn create_folder(&self, path: &Path) -> io::Result<()>;

    /// Returns the paths in a folder, in ascending order.
    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>>;

    /// Moves a file, and replaces an existing one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Gives a file a second name, if the file system can.
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;

    /// Sets the modification time of a file.
    fn date(&self, path: &Path, time: SystemTime) -> io::Result<()>;

    /// Makes the names in a folder durable.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;
}
