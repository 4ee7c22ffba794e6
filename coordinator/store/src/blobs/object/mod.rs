//! Blobs in a bucket of an S3-compatible store. An object's key is the prefix and the digest of its bytes.
//!
//! Every blob passes through a file on the coordinator's disk in both directions. Before an upload, the
//! digest is computed from the file. So no object ever has a wrong or a temporary name, and a blob with a
//! wrong digest causes no upload. S3 shows an upload in parts completely or not at all. After a download, the
//! complete file is checked before the first byte is returned. The file then stays as a [copy](cache::Cache)
//! for later reads.

mod bucket;
mod cache;
mod direct;
mod faults;
mod folder;
mod http;
mod keys;
mod place;

#[cfg(test)]
mod direct_tests;
#[cfg(test)]
pub(super) mod tests;

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

pub use folder::ObjectFolder;
pub use place::{BlobPlace, BucketPlace, PlaceError, Ways};

use self::bucket::Bucket;
use self::cache::Cache;
use super::super::identity::StoreId;
use super::api::{BlobReader, BlobWriter, Blobs, Carried, OWNER, Stored};
use super::direct::Direct;
use super::error::{BlobError, check_announced, fault, parse_owner};
use super::files::FileWriter;
use sightline_records::ids::{Digest, hex};

/// Maximum length of the record of the blobs' owner, in bytes.
const OWNER_BYTES: usize = 64;

/// A blob store in a bucket. Clones share it.
#[derive(Clone)]
pub struct ObjectBlobs(Arc<Inner>);

struct Inner {
    bucket: Bucket,
    cache: Cache,
}

impl ObjectBlobs {
    /// Opens the bucket: writes, reads and deletes one small object.
    ///
    /// `directory` contains copies and unfinished blobs; it must have no other use.
    ///
    /// # Errors
    /// An error that describes the fault of the place, the store or the directory, and a remedy.
    pub fn open(place: &BucketPlace, directory: &Path) -> Result<Self, BlobError> {
        let cache = Cache::open(directory, place.cache)?;
        let bucket = Bucket::open(place)?;
        Ok(Self(Arc::new(Inner { bucket, cache })))
    }

    fn key(&self, digest: &Digest) -> object_store::path::Path {
        let hex = hex(digest);
        self.0.bucket.key(&format!("{}/{hex}", &hex[..2]))
    }

    /// Downloads a blob into a file, which stays in the cache.
    fn fetch(&self, digest: &Digest) -> Result<BlobReader, BlobError> {
        let (key, mut writer) = (self.key(digest), self.0.cache.files().writer()?);
        self.0.bucket.get(&key, |piece| writer.append(piece))?;
        if writer.digest().as_bytes() != digest {
            return Err(BlobError::Damaged {
                path: self.0.bucket.at(&key).into(),
            });
        }
        let length = writer.length();
        let file = self.0.cache.keep(writer, *digest, length)?;
        Ok(BlobReader {
            bytes: Box::new(file),
            length,
        })
    }

    /// Uploads a blob from a file, which stays in the cache.
    fn publish(&self, writer: FileWriter, digest: Digest) -> Result<(), BlobError> {
        let length = writer.length();
        let mut file = File::open(writer.path()).map_err(fault("open", writer.path()))?;
        self.0
            .bucket
            .put_file(&self.key(&digest), &mut file, length)?;
        if let Err(e) = self.0.cache.keep(writer, digest, length) {
            tracing::warn!("{e}; the blob is in the object store, but the cache has no copy");
        }
        Ok(())
    }
}

impl Blobs for ObjectBlobs {
    fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError> {
        self.0.bucket.len(&self.key(digest))
    }

    fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError> {
        let mut reader = self.open_checked(digest)?;
        let mut bytes = Vec::new();
        reader
            .bytes
            .read_to_end(&mut bytes)
            .map_err(|e| self.io_error(e))?;
        Ok(bytes)
    }

    fn open_checked(&self, digest: &Digest) -> Result<BlobReader, BlobError> {
        if let Some(copy) = self.0.cache.get(digest) {
            return Ok(copy);
        }
        self.fetch(digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        // An existing object is also written again: reading it to check for damage would cost as much.
        let mut writer = self.0.cache.files().writer()?;
        writer.append(bytes)?;
        let digest = *writer.digest().as_bytes();
        self.publish(writer, digest)?;
        Ok(digest)
    }

    fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put(bytes)
    }

    fn put_stream(&self) -> Result<Box<dyn BlobWriter>, BlobError> {
        Ok(Box::new(ObjectWriter {
            blobs: self.clone(),
            file: self.0.cache.files().writer()?,
        }))
    }

    fn visit(&self, visit: &mut dyn FnMut(Stored) -> bool) -> Result<(), BlobError> {
        self.0.bucket.list(None, |key, bytes, written| {
            match blake3::Hash::from_hex(key.filename().unwrap_or_default()) {
                Ok(digest) => visit(Stored {
                    digest: *digest.as_bytes(),
                    bytes,
                    written,
                }),
                // Skip objects that are not blobs.
                Err(_) => true,
            }
        })
    }

    fn written(&self, digest: &Digest) -> Result<Option<SystemTime>, BlobError> {
        self.0.bucket.written(&self.key(digest))
    }

    fn remove(&self, digest: &Digest) -> Result<bool, BlobError> {
        self.0.cache.remove(digest);
        let key = self.key(digest);
        // S3 does not report whether a deleted object existed.
        let was_there = self.0.bucket.len(&key)?.is_some();
        if was_there {
            self.0.bucket.delete(&key)?;
        }
        Ok(was_there)
    }

    fn owner(&self) -> Result<Option<StoreId>, BlobError> {
        let key = self.0.bucket.key(OWNER);
        let mut bytes = Vec::new();
        let read = self.0.bucket.get(&key, |piece| {
            // A longer record is damaged; its beginning suffices for the error.
            bytes.extend_from_slice(&piece[..piece.len().min(OWNER_BYTES - bytes.len())]);
            Ok(())
        });
        match read {
            Ok(()) => parse_owner(&bytes, Path::new(&self.0.bucket.at(&key))).map(Some),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    fn claim(&self, store: StoreId) -> Result<(), BlobError> {
        let text = format!("{store}\n");
        self.0
            .bucket
            .put(&self.0.bucket.key(OWNER), text.into_bytes().into())
    }

    fn direct(&self) -> Option<&dyn Direct> {
        self.0.bucket.signs().then_some(self)
    }

    fn carried(&self) -> Option<Carried> {
        Some(self.0.bucket.carried())
    }

    fn scratch(&self) -> Result<Option<File>, BlobError> {
        self.0.cache.files().scratch()
    }

    fn io_error(&self, e: io::Error) -> BlobError {
        self.0.cache.files().io_error(e)
    }
}

/// A writer of a blob that arrives in pieces.
struct ObjectWriter {
    blobs: ObjectBlobs,
    file: FileWriter,
}

impl BlobWriter for ObjectWriter {
    fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError> {
        self.file.append(bytes)
    }

    fn length(&self) -> u64 {
        self.file.length()
    }

    fn finish(self: Box<Self>, expected: Option<&Digest>) -> Result<Digest, BlobError> {
        let Self { blobs, file } = *self;
        let digest = check_announced(file.digest(), expected)?;
        blobs.publish(file, digest)?;
        Ok(digest)
    }
}

impl Write for ObjectWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
