//! A disk on which unreadable sectors read as zeros. A repair can thereby use the bytes around them.
//!
//! A zeroed frame of the journal does not match its check, so that it counts as damaged.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::api::{Access, Attributes, Disk, DiskFile};

/// The size of the parts that are read separately, in bytes. Drives report errors for complete sectors.
const SECTOR: u64 = 512;

/// Returns true if the error indicates an unreadable sector (EIO).
pub(crate) fn is_unreadable(e: &io::Error) -> bool {
    e.raw_os_error() == Some(5)
}

/// Another disk, whose unreadable sectors read as zeros in files opened with [`Access::Read`].
#[derive(Debug)]
pub(crate) struct ZeroUnreadable<'a>(pub(crate) &'a dyn Disk);

struct ZeroedFile {
    file: Box<dyn DiskFile>,
    /// The length of the file when it was opened, in bytes.
    length: u64,
}

impl Read for ZeroedFile {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let at = self.file.stream_position()?;
        match self.file.read(to) {
            Err(e) if is_unreadable(&e) => {}
            other => return other,
        }
        let part = (SECTOR - at % SECTOR).min(self.length.saturating_sub(at));
        // The part is at most one sector.
        let part = to.len().min(part as usize);
        self.file.seek(SeekFrom::Start(at))?;
        match self.file.read(&mut to[..part]) {
            Err(e) if is_unreadable(&e) => {
                to[..part].fill(0);
                self.file.seek(SeekFrom::Start(at + part as u64))?;
                Ok(part)
            }
            other => other,
        }
    }
}

impl Seek for ZeroedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl Write for ZeroedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl DiskFile for ZeroedFile {
    fn sync(&self) -> io::Result<()> {
        self.file.sync()
    }

    fn set_length(&self, length: u64) -> io::Result<()> {
        self.file.set_length(length)
    }
}

impl Disk for ZeroUnreadable<'_> {
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>> {
        let file = self.0.open(path, access)?;
        if access != Access::Read {
            return Ok(file);
        }
        let length = self
            .0
            .attributes(path)?
            .map_or(0, |attributes| attributes.length);
        Ok(Box::new(ZeroedFile { file, length }))
    }

    fn attributes(&self, path: &Path) -> io::Result<Option<Attributes>> {
        self.0.attributes(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.0.create_folder(path)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        self.0.list(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.0.rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.0.link(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.0.remove(path)
    }

    fn date(&self, path: &Path, time: SystemTime) -> io::Result<()> {
        self.0.date(path, time)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.0.sync_folder(folder)
    }
}
