//! Large things as files named by their BLAKE3 digest: scenes, their chunks, packs, tile results, `.pvs` files.
//!
//! A file is written aside, synced, moved into place, and its directory synced: under its name it is whole or
//! not there. Two levels of directories keep each of them short. Which blob is still needed is not known here;
//! the store's records say. Open the store first: its lock keeps two coordinators off one directory.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Digest;

/// What can go wrong with a blob.
#[derive(Clone, Debug, thiserror::Error)]
pub enum BlobError {
    /// The disk is full: stop taking in more.
    #[error("no space left to write {}; free some and try again", .path.display())]
    NoSpace {
        /// What was being written.
        path: PathBuf,
    },
    /// Not there.
    #[error("blob {} is missing; it must be uploaded or computed again", .path.display())]
    Missing {
        /// Where it would be.
        path: PathBuf,
    },
    /// Its content is not what its name says.
    #[error("blob {} is damaged; delete it, it must be uploaded or computed again", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
    },
    /// What was written is not what was announced.
    #[error("digest {expected} was announced, {found} arrived; send it again")]
    Mismatch {
        /// The digest announced, in hexadecimal.
        expected: String,
        /// The digest of what arrived.
        found: String,
    },
    /// A file operation failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// What was tried.
        doing: &'static str,
        /// On which file.
        path: PathBuf,
        /// What the system said.
        source: Arc<io::Error>,
    },
}

fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> BlobError {
    let path = path.to_owned();
    move |source| match source.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => BlobError::NoSpace { path: path.clone() },
        ErrorKind::NotFound if doing == "read" => BlobError::Missing { path: path.clone() },
        _ => BlobError::Io { doing, path: path.clone(), source: Arc::new(source) },
    }
}

/// A directory of blobs. Clones share it.
#[derive(Clone, Debug)]
pub struct Blobs {
    root: Arc<PathBuf>,
    written: Arc<AtomicU64>,
}

impl Blobs {
    /// Opens the directory, or makes it; removes what was left unfinished before.
    pub fn open(directory: &Path) -> Result<Self, BlobError> {
        let aside = directory.join("tmp");
        std::fs::create_dir_all(&aside).map_err(fault("create", &aside))?;
        for entry in std::fs::read_dir(&aside).map_err(fault("list", &aside))? {
            let path = entry.map_err(fault("list", &aside))?.path();
            std::fs::remove_file(&path).map_err(fault("remove", &path))?;
        }
        sync_directory(directory)?;
        Ok(Self { root: Arc::new(directory.to_owned()), written: Arc::default() })
    }

    /// Where a blob lies, or would lie. Do not write there.
    pub fn path(&self, digest: &Digest) -> PathBuf {
        let hex = blake3::Hash::from_bytes(*digest).to_hex();
        self.root.join(&hex[..2]).join(&hex[2..4]).join(hex.as_str())
    }

    /// Whether a blob is there. Says nothing of damage; [`Blobs::read`] does.
    pub fn has(&self, digest: &Digest) -> Result<bool, BlobError> {
        Ok(self.len(digest)?.is_some())
    }

    /// A blob's size in bytes, if it is there.
    pub fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError> {
        let path = self.path(digest);
        match std::fs::metadata(&path) {
            Ok(metadata) => Ok(Some(metadata.len())),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(fault("look at", &path)(error)),
        }
    }

    /// Reads a blob and checks it.
    pub fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError> {
        let path = self.path(digest);
        let mut bytes = Vec::new();
        File::open(&path).and_then(|mut file| file.read_to_end(&mut bytes)).map_err(fault("read", &path))?;
        if blake3::hash(&bytes).as_bytes() == digest { Ok(bytes) } else { Err(BlobError::Damaged { path }) }
    }

    /// A blob that is checked but not held in memory, and its length: for what may be large.
    pub fn open_checked(&self, digest: &Digest) -> Result<(File, u64), BlobError> {
        let path = self.path(digest);
        let mut file = File::open(&path).map_err(fault("read", &path))?;
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(&mut file).map_err(fault("read", &path))?;
        if hasher.finalize().as_bytes() != digest {
            return Err(BlobError::Damaged { path });
        }
        let length = file.stream_position().map_err(fault("read", &path))?;
        file.rewind().map_err(fault("read", &path))?;
        Ok((file, length))
    }

    /// A file without a name, gone when it is closed: for what is worked with and does not fit in memory.
    pub fn scratch(&self) -> Result<File, BlobError> {
        let path = self.aside();
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(fault("create", &path))?;
        std::fs::remove_file(&path).map_err(fault("remove", &path))?;
        Ok(file)
    }

    /// Why a [`Blobs::scratch`] file, or a [`BlobWriter`] as [`Write`], refused.
    pub fn refused(&self, e: io::Error) -> BlobError {
        match e.downcast::<BlobError>() {
            Ok(e) => e,
            Err(e) => fault("write below", &self.root.join("tmp"))(e),
        }
    }

    /// A name of its own for a file that is not in its place yet.
    fn aside(&self) -> PathBuf {
        let number = self.written.fetch_add(1, Ordering::Relaxed);
        self.root.join("tmp").join(format!("{}-{number}", std::process::id()))
    }

    /// Writes a blob; it is on the disk when this returns its digest. A damaged one of that name is replaced.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put_whole(bytes, true)
    }

    /// As [`Blobs::put`], but the blob may be gone or cut short after a power failure; [`Blobs::read`] then says so. For
    /// what its sender still has.
    pub fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put_whole(bytes, false)
    }

    fn put_whole(&self, bytes: &[u8], synced: bool) -> Result<Digest, BlobError> {
        let digest = *blake3::hash(bytes).as_bytes();
        match self.read(&digest) {
            Ok(_) => {
                if synced {
                    self.sync(&digest)?;
                }
                return Ok(digest);
            }
            Err(BlobError::Missing { .. }) => {}
            Err(e @ BlobError::Damaged { .. }) => tracing::warn!("{e}; it is written again now"),
            Err(other) => return Err(other),
        }
        let mut writer = self.put_stream()?;
        writer.append(bytes)?;
        writer.place(Some(&digest), synced)
    }

    /// Brings a blob that is there to the disk, where it may not be yet ([`Blobs::put_unsynced`]).
    fn sync(&self, digest: &Digest) -> Result<(), BlobError> {
        let place = self.path(digest);
        File::open(&place).and_then(|file| file.sync_all()).map_err(fault("sync", &place))?;
        self.sync_directories(&place)
    }

    /// Brings the names on the way to a blob to the disk.
    fn sync_directories(&self, place: &Path) -> Result<(), BlobError> {
        // Both levels lie under the root by construction of `path`.
        let inner = place.parent().unwrap_or(&self.root);
        let outer = inner.parent().unwrap_or(&self.root);
        [inner, outer, &self.root].into_iter().try_for_each(sync_directory)
    }

    /// Begins a blob that arrives in pieces. Nothing is kept of it unless it is finished.
    pub fn put_stream(&self) -> Result<BlobWriter, BlobError> {
        let path = self.aside();
        let file =
            OpenOptions::new().write(true).create_new(true).open(&path).map_err(fault("create", &path))?;
        Ok(BlobWriter { blobs: self.clone(), path, file, hasher: blake3::Hasher::new(), length: 0 })
    }

    /// Removes a blob; answers whether it was there.
    pub fn remove(&self, digest: &Digest) -> Result<bool, BlobError> {
        let path = self.path(digest);
        match std::fs::remove_file(&path) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
            Err(error) => Err(fault("remove", &path)(error)),
        }
    }
}

/// A blob being written. Dropped unfinished, it leaves nothing behind.
#[derive(Debug)]
pub struct BlobWriter {
    blobs: Blobs,
    path: PathBuf,
    file: File,
    hasher: blake3::Hasher,
    length: u64,
}

impl BlobWriter {
    /// Adds the next piece. After an error, drop the writer and begin again.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError> {
        self.file.write_all(bytes).map_err(fault("write", &self.path))?;
        self.hasher.update(bytes);
        self.length = self.length.saturating_add(bytes.len() as u64);
        Ok(())
    }

    /// Bytes added so far.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Puts the blob in its place, if it is what was announced; it is on the disk when this returns its digest.
    pub fn finish(self, expected: Option<&Digest>) -> Result<Digest, BlobError> {
        self.place(expected, true)
    }

    fn place(self, expected: Option<&Digest>, sync: bool) -> Result<Digest, BlobError> {
        let found = self.hasher.finalize();
        if let Some(expected) = expected.map(|expected| blake3::Hash::from_bytes(*expected))
            && expected != found
        {
            return Err(BlobError::Mismatch {
                expected: expected.to_hex().to_string(),
                found: found.to_hex().to_string(),
            });
        }
        if sync {
            self.file.sync_all().map_err(fault("sync", &self.path))?;
        }
        let digest = *found.as_bytes();
        let place = self.blobs.path(&digest);
        let inner = place.parent().unwrap_or(&self.blobs.root);
        std::fs::create_dir_all(inner).map_err(fault("create", inner))?;
        std::fs::rename(&self.path, &place).map_err(fault("move into place", &place))?;
        if sync {
            self.blobs.sync_directories(&place)?;
        }
        Ok(digest)
    }
}

impl Write for BlobWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.append(bytes).map_err(io::Error::other)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for BlobWriter {
    fn drop(&mut self) {
        match std::fs::remove_file(&self.path) {
            // Gone: it was finished.
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!(path = %self.path.display(), %error, "an unfinished blob stays until the next start");
            }
            _ => {}
        }
    }
}

fn sync_directory(directory: &Path) -> Result<(), BlobError> {
    File::open(directory).and_then(|opened| opened.sync_all()).map_err(fault("sync", directory))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(directory: &Path) -> usize {
        std::fs::read_dir(directory).unwrap().count()
    }

    #[test]
    fn what_is_put_is_read_and_damage_is_seen_and_healed() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(directory.path()).unwrap();
        let digest = blobs.put(b"walls").unwrap();
        assert_eq!(digest, *blake3::hash(b"walls").as_bytes());
        assert_eq!(blobs.read(&digest).unwrap(), b"walls");
        assert_eq!(blobs.len(&digest).unwrap(), Some(5));
        std::fs::write(blobs.path(&digest), b"halls").unwrap();
        assert!(matches!(blobs.read(&digest), Err(BlobError::Damaged { .. })));
        blobs.put(b"walls").unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), b"walls");
        assert!(blobs.remove(&digest).unwrap());
        assert!(!blobs.remove(&digest).unwrap() && !blobs.has(&digest).unwrap());
        assert!(matches!(blobs.read(&digest), Err(BlobError::Missing { .. })));
        assert_eq!(files(&directory.path().join("tmp")), 0);
    }

    #[test]
    fn a_stream_is_kept_only_if_it_is_what_was_announced() {
        let directory = tempfile::tempdir().unwrap();
        let aside = directory.path().join("tmp");
        let blobs = Blobs::open(directory.path()).unwrap();
        let digest = *blake3::hash(b"floor and roof").as_bytes();
        let mut wrong = blobs.put_stream().unwrap();
        wrong.append(b"floor").unwrap();
        assert!(matches!(wrong.finish(Some(&digest)), Err(BlobError::Mismatch { .. })));
        assert!(!blobs.has(&digest).unwrap());
        assert_eq!(files(&aside), 0);
        let mut right = blobs.put_stream().unwrap();
        for piece in [b"floor".as_slice(), b" and ", b"roof"] {
            right.append(piece).unwrap();
        }
        assert_eq!(right.length(), 14);
        assert_eq!(right.finish(Some(&digest)).unwrap(), digest);
        assert_eq!(blobs.read(&digest).unwrap(), b"floor and roof");
    }

    #[test]
    fn what_is_large_is_checked_without_being_held_and_scratch_has_no_name() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(directory.path()).unwrap();
        let digest = blobs.put(b"walls").unwrap();
        let (mut file, length) = blobs.open_checked(&digest).unwrap();
        let mut read = Vec::new();
        file.read_to_end(&mut read).unwrap();
        assert_eq!((read.as_slice(), length), (b"walls".as_slice(), 5));
        std::fs::write(blobs.path(&digest), b"halls").unwrap();
        assert!(matches!(blobs.open_checked(&digest), Err(BlobError::Damaged { .. })));
        blobs.remove(&digest).unwrap();
        assert!(matches!(blobs.open_checked(&digest), Err(BlobError::Missing { .. })));
        let mut scratch = blobs.scratch().unwrap();
        scratch.write_all(b"doors").unwrap();
        let full = |e| matches!(blobs.refused(e), BlobError::NoSpace { .. });
        assert!(full(ErrorKind::StorageFull.into()) && !full(ErrorKind::PermissionDenied.into()));
        assert!(full(io::Error::other(BlobError::NoSpace { path: PathBuf::new() })));
        scratch.rewind().unwrap();
        read.clear();
        scratch.read_to_end(&mut read).unwrap();
        assert_eq!(read, b"doors");
        assert_eq!(files(&directory.path().join("tmp")), 0);
    }

    #[test]
    fn what_was_left_unfinished_goes_at_the_next_start() {
        let directory = tempfile::tempdir().unwrap();
        let aside = directory.path().join("tmp");
        let kept = Blobs::open(directory.path()).unwrap().put(b"kept").unwrap();
        std::fs::write(aside.join("1-0"), b"half").unwrap();
        let blobs = Blobs::open(directory.path()).unwrap();
        assert_eq!(files(&aside), 0);
        assert_eq!(blobs.read(&kept).unwrap(), b"kept");
    }
}
