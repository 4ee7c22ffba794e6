//! Blobs as files named by their digest, two levels of directories deep.
//!
//! A file is written under `tmp/` (`tmp-NAME/` if processes share the directory), synced, and renamed into
//! place. Then its directories are synced, so a file under its final name is complete. The crate tempfile
//! does not sync, and would replace only the choice of the temporary name. Open the store first: its lock
//! prevents two coordinators from using one data directory. All operations use a [`Disk`], which tests
//! replace.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use sightline_records::ids::{Digest, hex};

use super::super::disk::{self, Access, Disk, DiskFile, SystemDisk};
use super::super::identity::StoreId;
use super::api::{BlobReader, BlobWriter, Blobs, OWNER, Stored};
use super::error::{BlobError, check_announced, fault, parse_owner};

/// A directory of blobs. Clones share it.
#[derive(Clone, Debug)]
pub struct FileBlobs {
    disk: Arc<dyn Disk>,
    root: Arc<PathBuf>,
    /// The folder of unfinished files.
    unfinished: Arc<PathBuf>,
    written: Arc<AtomicU64>,
}

impl FileBlobs {
    /// Opens or creates the directory, and removes unfinished files of an earlier run.
    ///
    /// # Errors
    /// An error if the directory cannot be created, listed or synced.
    pub fn open(directory: &Path) -> Result<Self, BlobError> {
        Self::open_on(Arc::new(SystemDisk), directory, "tmp")
    }

    /// Opens or creates a directory that several processes share, as [`FileBlobs::open`] does.
    ///
    /// Each process has its own permanent `name`. A file is complete before it gets its final name, and files
    /// of one name are equal, so no process sees an unfinished file of another process.
    ///
    /// # Errors
    /// The errors of [`FileBlobs::open`].
    pub fn open_shared(directory: &Path, name: &str) -> Result<Self, BlobError> {
        Self::open_on(Arc::new(SystemDisk), directory, &format!("tmp-{name}"))
    }

    /// Opens an existing directory without changing it, for reading only.
    ///
    /// # Errors
    /// [`BlobError::Io`] if the directory does not exist or cannot be listed.
    pub fn inspect(directory: &Path) -> Result<Self, BlobError> {
        let blobs = Self::at(Arc::new(SystemDisk), directory, "tmp");
        blobs
            .disk
            .list(directory)
            .map_err(fault("list", directory))?;
        Ok(blobs)
    }

    /// Opens a directory on a disk. `unfinished` is the name of the folder for unfinished files.
    pub(crate) fn open_on(
        disk: Arc<dyn Disk>,
        directory: &Path,
        unfinished: &str,
    ) -> Result<Self, BlobError> {
        let blobs = Self::at(disk, directory, unfinished);
        let (disk, unfinished) = (&*blobs.disk, &**blobs.unfinished);
        disk::create_folder(disk, directory).map_err(fault("create", directory))?;
        disk.create_folder(unfinished)
            .map_err(fault("create", unfinished))?;
        for path in disk.list(unfinished).map_err(fault("list", unfinished))? {
            disk.remove(&path).map_err(fault("remove", &path))?;
        }
        blobs.sync_folder(directory)?;
        Ok(blobs)
    }

    fn at(disk: Arc<dyn Disk>, directory: &Path, unfinished: &str) -> Self {
        let unfinished = Arc::new(directory.join(unfinished));
        Self {
            disk,
            root: Arc::new(directory.to_owned()),
            unfinished,
            written: Arc::default(),
        }
    }

    /// Returns the path of a blob, which may be absent. Callers must not write to the path.
    pub fn path(&self, digest: &Digest) -> PathBuf {
        let hex = hex(digest);
        self.root.join(&hex[..2]).join(&hex[2..4]).join(&hex)
    }

    /// Returns an unused path for an unfinished file.
    fn unfinished(&self) -> PathBuf {
        let number = self.written.fetch_add(1, Ordering::Relaxed);
        self.unfinished
            .join(format!("{}-{number}", std::process::id()))
    }

    fn put_whole(&self, bytes: &[u8], synced: bool) -> Result<Digest, BlobError> {
        let digest = *blake3::hash(bytes).as_bytes();
        match self.read(&digest) {
            Ok(_) => {
                if synced {
                    self.sync(&digest)?;
                }
                // The client that puts a blob is about to reference it, so the blob must not look like an old
                // blob without references.
                let path = self.path(&digest);
                self.disk
                    .date(&path, SystemTime::now())
                    .map_err(fault("set the time of", &path))?;
                return Ok(digest);
            }
            Err(BlobError::Missing { .. }) => {}
            Err(e) if e.is_broken() => tracing::warn!("{e}; the coordinator writes the blob again"),
            Err(other) => return Err(other),
        }
        let mut writer = self.writer()?;
        writer.append(bytes)?;
        writer.place(Some(&digest), synced)
    }

    /// Syncs a blob that is present but may not be durable yet ([`Blobs::put_unsynced`]).
    fn sync(&self, digest: &Digest) -> Result<(), BlobError> {
        let place = self.path(digest);
        self.disk
            .open(&place, Access::Read)
            .and_then(|file| file.sync())
            .map_err(fault("sync", &place))?;
        self.sync_directories(&place)
    }

    /// Syncs the directories that lead to a blob.
    fn sync_directories(&self, place: &Path) -> Result<(), BlobError> {
        // By construction of `path`, both levels lie under the root.
        let inner = place.parent().unwrap_or(&self.root);
        let outer = inner.parent().unwrap_or(&self.root);
        [inner, outer, &self.root]
            .into_iter()
            .try_for_each(|folder| self.sync_folder(folder))
    }

    fn sync_folder(&self, folder: &Path) -> Result<(), BlobError> {
        self.disk.sync_folder(folder).map_err(fault("sync", folder))
    }

    /// Creates a writer for a blob that arrives in pieces.
    pub(super) fn writer(&self) -> Result<FileWriter, BlobError> {
        let path = self.unfinished();
        let file = self
            .disk
            .open(&path, Access::Create)
            .map_err(fault("create", &path))?;
        Ok(FileWriter {
            blobs: self.clone(),
            path,
            file,
            hasher: blake3::Hasher::new(),
            length: 0,
        })
    }
}

impl Blobs for FileBlobs {
    fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError> {
        let path = self.path(digest);
        let found = self
            .disk
            .attributes(&path)
            .map_err(fault("look at", &path))?;
        Ok(found.map(|found| found.length))
    }

    fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError> {
        let path = self.path(digest);
        let mut bytes = Vec::new();
        self.disk
            .open(&path, Access::Read)
            .and_then(|mut file| file.read_to_end(&mut bytes))
            .map_err(fault("read", &path))?;
        if blake3::hash(&bytes).as_bytes() == digest {
            Ok(bytes)
        } else {
            Err(BlobError::Damaged { path })
        }
    }

    fn open_checked(&self, digest: &Digest) -> Result<BlobReader, BlobError> {
        let path = self.path(digest);
        let mut file = self
            .disk
            .open(&path, Access::Read)
            .map_err(fault("read", &path))?;
        let mut hasher = blake3::Hasher::new();
        hasher
            .update_reader(&mut file)
            .map_err(fault("read", &path))?;
        if hasher.finalize().as_bytes() != digest {
            return Err(BlobError::Damaged { path });
        }
        let length = file.stream_position().map_err(fault("read", &path))?;
        file.rewind().map_err(fault("read", &path))?;
        Ok(BlobReader {
            bytes: file,
            length,
        })
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put_whole(bytes, true)
    }

    fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put_whole(bytes, false)
    }

    fn put_stream(&self) -> Result<Box<dyn BlobWriter>, BlobError> {
        Ok(Box::new(self.writer()?))
    }

    fn visit(&self, visit: &mut dyn FnMut(Stored) -> bool) -> Result<(), BlobError> {
        let list = |path: &Path| self.disk.list(path).map_err(fault("list", path));
        let short = |path: &Path| path.file_name().is_some_and(|name| name.len() == 2);
        for outer in list(&self.root)?.iter().filter(|path| short(path)) {
            for inner in list(outer)?.iter().filter(|path| short(path)) {
                for path in list(inner)? {
                    let name = path
                        .file_name()
                        .and_then(|name| name.to_str())
                        .unwrap_or_default();
                    // Skip files that are not blobs.
                    let Ok(digest) = blake3::Hash::from_hex(name) else {
                        continue;
                    };
                    let Some(bytes) = self.len(digest.as_bytes())? else {
                        continue;
                    };
                    let Some(written) = self.written(digest.as_bytes())? else {
                        continue;
                    };
                    if !visit(Stored {
                        digest: *digest.as_bytes(),
                        bytes,
                        written,
                    }) {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }

    fn written(&self, digest: &Digest) -> Result<Option<SystemTime>, BlobError> {
        let path = self.path(digest);
        let found = self
            .disk
            .attributes(&path)
            .map_err(fault("look at", &path))?;
        Ok(found.map(|found| found.modified))
    }

    fn remove(&self, digest: &Digest) -> Result<bool, BlobError> {
        let path = self.path(digest);
        match self.disk.remove(&path) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
            Err(error) => Err(fault("remove", &path)(error)),
        }
    }

    fn owner(&self) -> Result<Option<StoreId>, BlobError> {
        let path = self.root.join(OWNER);
        match disk::read_up_to(&*self.disk, &path, 64) {
            Ok(bytes) => parse_owner(&bytes, &path).map(Some),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(fault("read", &path)(error)),
        }
    }

    fn claim(&self, store: StoreId) -> Result<(), BlobError> {
        let (path, beside) = (
            self.root.join(OWNER),
            self.root.join(format!("{OWNER}.new")),
        );
        let text = format!("{store}\n");
        disk::replace(&*self.disk, &path, &beside, text.as_bytes()).map_err(fault("write", &path))
    }

    fn scratch(&self) -> Result<Option<File>, BlobError> {
        let path = self.unfinished();
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(fault("create", &path))?;
        std::fs::remove_file(&path).map_err(fault("remove", &path))?;
        Ok(Some(file))
    }

    fn io_error(&self, e: io::Error) -> BlobError {
        e.downcast::<BlobError>()
            .unwrap_or_else(fault("write below", &self.unfinished))
    }
}

/// A blob file that is being written.
pub(super) struct FileWriter {
    blobs: FileBlobs,
    path: PathBuf,
    file: Box<dyn DiskFile>,
    hasher: blake3::Hasher,
    length: u64,
}

impl FileWriter {
    /// Returns the digest of the bytes written so far.
    pub(super) fn digest(&self) -> blake3::Hash {
        self.hasher.finalize()
    }

    /// Returns the path of the unfinished file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Moves the finished file into its place.
    pub(super) fn place(self, expected: Option<&Digest>, sync: bool) -> Result<Digest, BlobError> {
        let digest = check_announced(self.hasher.finalize(), expected)?;
        if sync {
            self.file.sync().map_err(fault("sync", &self.path))?;
        }
        let place = self.blobs.path(&digest);
        let inner = place.parent().unwrap_or(&self.blobs.root);
        let disk = &self.blobs.disk;
        disk.create_folder(inner).map_err(fault("create", inner))?;
        disk.rename(&self.path, &place)
            .map_err(fault("move into place", &place))?;
        if sync {
            self.blobs.sync_directories(&place)?;
        }
        Ok(digest)
    }
}

impl BlobWriter for FileWriter {
    fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError> {
        self.file
            .write_all(bytes)
            .map_err(fault("write", &self.path))?;
        self.hasher.update(bytes);
        self.length = self.length.saturating_add(bytes.len() as u64);
        Ok(())
    }

    fn length(&self) -> u64 {
        self.length
    }

    fn finish(self: Box<Self>, expected: Option<&Digest>) -> Result<Digest, BlobError> {
        self.place(expected, true)
    }
}

impl Write for FileWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.append(bytes).map_err(io::Error::other)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for FileWriter {
    fn drop(&mut self) {
        match self.blobs.disk.remove(&self.path) {
            // Absent: the blob was finished and renamed.
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!(
                    path = %self.path.display(), %error,
                    "an unfinished blob cannot be removed; the next start removes it"
                );
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(directory: &Path) -> usize {
        std::fs::read_dir(directory).unwrap().count()
    }

    #[test]
    fn put_replaces_damaged_blob() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let digest = blobs.put(b"walls").unwrap();
        assert_eq!(digest, *blake3::hash(b"walls").as_bytes());
        assert_eq!(blobs.read(&digest).unwrap(), b"walls");
        assert_eq!(blobs.len(&digest).unwrap(), Some(5));
        std::fs::write(blobs.path(&digest), b"halls").unwrap();
        assert!(matches!(
            blobs.read(&digest),
            Err(BlobError::Damaged { .. })
        ));
        blobs.put(b"walls").unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), b"walls");
        assert!(blobs.remove(&digest).unwrap());
        assert!(!blobs.remove(&digest).unwrap() && !blobs.has(&digest).unwrap());
        assert!(matches!(
            blobs.read(&digest),
            Err(BlobError::Missing { .. })
        ));
        assert_eq!(files(&directory.path().join("tmp")), 0);
    }

    #[test]
    fn put_replaces_unreadable_blob() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let digest = blobs.put(b"walls").unwrap();
        // Page 0 of a process is not mapped, so reading it fails with EIO, like reading a broken sector.
        let break_it = || {
            std::fs::remove_file(blobs.path(&digest)).unwrap();
            std::os::unix::fs::symlink("/proc/self/mem", blobs.path(&digest)).unwrap();
        };
        break_it();
        assert!(matches!(
            blobs.read(&digest),
            Err(BlobError::Unreadable { .. })
        ));
        assert!(matches!(
            blobs.open_checked(&digest),
            Err(BlobError::Unreadable { .. })
        ));
        blobs.put(b"walls").unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), b"walls");
        break_it();
        assert!(blobs.remove(&digest).unwrap() && !blobs.has(&digest).unwrap());
        // An error of the machine does not concern the file.
        let permission = fault("read", directory.path())(ErrorKind::PermissionDenied.into());
        assert!(!permission.is_lost() && !permission.passes());
    }

    #[test]
    fn stream_rejects_wrong_digest() {
        let directory = tempfile::tempdir().unwrap();
        let unfinished = directory.path().join("tmp");
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let digest = *blake3::hash(b"floor and roof").as_bytes();
        let mut wrong = blobs.put_stream().unwrap();
        wrong.append(b"floor").unwrap();
        assert!(matches!(
            wrong.finish(Some(&digest)),
            Err(BlobError::Mismatch { .. })
        ));
        assert!(!blobs.has(&digest).unwrap());
        assert_eq!(files(&unfinished), 0);
        let mut right = blobs.put_stream().unwrap();
        for piece in [b"floor".as_slice(), b" and ", b"roof"] {
            right.append(piece).unwrap();
        }
        assert_eq!(right.length(), 14);
        assert_eq!(right.finish(Some(&digest)).unwrap(), digest);
        assert_eq!(blobs.read(&digest).unwrap(), b"floor and roof");
    }

    #[test]
    fn open_rejects_damaged_blob_and_scratch_files_are_unnamed() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let digest = blobs.put(b"walls").unwrap();
        let mut opened = blobs.open_checked(&digest).unwrap();
        let mut read = Vec::new();
        opened.bytes.read_to_end(&mut read).unwrap();
        assert_eq!((read.as_slice(), opened.length), (b"walls".as_slice(), 5));
        std::fs::write(blobs.path(&digest), b"halls").unwrap();
        assert!(matches!(
            blobs.open_checked(&digest),
            Err(BlobError::Damaged { .. })
        ));
        blobs.remove(&digest).unwrap();
        assert!(matches!(
            blobs.open_checked(&digest),
            Err(BlobError::Missing { .. })
        ));
        let mut scratch = blobs.scratch().unwrap().unwrap();
        scratch.write_all(b"doors").unwrap();
        scratch.rewind().unwrap();
        read.clear();
        scratch.read_to_end(&mut read).unwrap();
        assert_eq!(read, b"doors");
        assert_eq!(files(&directory.path().join("tmp")), 0);
    }

    #[test]
    fn shared_directory_keeps_unfinished_files_of_other_processes() {
        let directory = tempfile::tempdir().unwrap();
        let first = FileBlobs::open_shared(directory.path(), "first").unwrap();
        let mut writing = first.put_stream().unwrap();
        writing.append(b"wal").unwrap();
        // Another process starts and writes the same blob.
        let second = FileBlobs::open_shared(directory.path(), "second").unwrap();
        let digest = second.put(b"walls").unwrap();
        writing.append(b"ls").unwrap();
        assert_eq!(writing.finish(Some(&digest)).unwrap(), digest);
        assert_eq!(
            (first.read(&digest).unwrap(), second.read(&digest).unwrap()),
            (b"walls".to_vec(), b"walls".to_vec())
        );
    }

    #[test]
    fn next_start_removes_unfinished_files() {
        let directory = tempfile::tempdir().unwrap();
        let unfinished = directory.path().join("tmp");
        let kept = FileBlobs::open(directory.path())
            .unwrap()
            .put(b"kept")
            .unwrap();
        std::fs::write(unfinished.join("1-0"), b"half").unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        assert_eq!(files(&unfinished), 0);
        assert_eq!(blobs.read(&kept).unwrap(), b"kept");
    }
}
