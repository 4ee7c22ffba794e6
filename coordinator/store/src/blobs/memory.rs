//! Blobs in memory, for tests and for coordinators whose jobs need not survive them.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use sightline_records::ids::{Digest, hex};

use super::super::identity::StoreId;
use super::api::{BlobReader, BlobWriter, Blobs, Stored};
use super::error::{BlobError, check_announced, fault};

type Map = BTreeMap<Digest, (Arc<[u8]>, SystemTime)>;

/// A blob store without a disk. Clones share the blobs.
#[derive(Clone, Debug, Default)]
pub struct MemoryBlobs {
    blobs: Arc<Mutex<Map>>,
    owner: Arc<Mutex<Option<StoreId>>>,
}

impl MemoryBlobs {
    /// Creates a store without blobs.
    pub fn new() -> Self {
        Self::default()
    }

    fn map(&self) -> MutexGuard<'_, Map> {
        // Every change is one insertion or removal, so a panic cannot leave a blob half written.
        self.blobs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        let path = || PathBuf::from(format!("{} in memory", hex(digest)));
        self.map()
            .get(digest)
            .map(|(bytes, _)| Arc::clone(bytes))
            .ok_or_else(|| BlobError::Missing { path: path() })
    }
}

impl Blobs for MemoryBlobs {
    fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError> {
        Ok(self.map().get(digest).map(|(bytes, _)| bytes.len() as u64))
    }

    fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError> {
        Ok(self.get(digest)?.to_vec())
    }

    fn open_checked(&self, digest: &Digest) -> Result<BlobReader, BlobError> {
        let bytes = self.get(digest)?;
        let length = bytes.len() as u64;
        Ok(BlobReader {
            bytes: Box::new(Cursor::new(bytes)),
            length,
        })
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        let digest = *blake3::hash(bytes).as_bytes();
        let now = SystemTime::now();
        self.map()
            .entry(digest)
            .or_insert_with(|| (bytes.into(), now))
            .1 = now;
        Ok(digest)
    }

    fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        self.put(bytes)
    }

    fn visit(&self, visit: &mut dyn FnMut(Stored) -> bool) -> Result<(), BlobError> {
        let to_stored = |(digest, (bytes, written)): (&Digest, &(Arc<[u8]>, SystemTime))| Stored {
            digest: *digest,
            bytes: bytes.len() as u64,
            written: *written,
        };
        let all: Vec<Stored> = self.map().iter().map(to_stored).collect();
        all.into_iter().all(visit);
        Ok(())
    }

    fn written(&self, digest: &Digest) -> Result<Option<SystemTime>, BlobError> {
        Ok(self.map().get(digest).map(|(_, written)| *written))
    }

    fn put_stream(&self) -> Result<Box<dyn BlobWriter>, BlobError> {
        Ok(Box::new(MemoryWriter {
            blobs: self.clone(),
            bytes: Vec::new(),
        }))
    }

    fn remove(&self, digest: &Digest) -> Result<bool, BlobError> {
        Ok(self.map().remove(digest).is_some())
    }

    fn owner(&self) -> Result<Option<StoreId>, BlobError> {
        Ok(*self.owner.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn claim(&self, store: StoreId) -> Result<(), BlobError> {
        *self.owner.lock().unwrap_or_else(PoisonError::into_inner) = Some(store);
        Ok(())
    }

    fn scratch(&self) -> Result<Option<std::fs::File>, BlobError> {
        Ok(None)
    }

    fn io_error(&self, e: io::Error) -> BlobError {
        e.downcast::<BlobError>()
            .unwrap_or_else(fault("write", Path::new("memory")))
    }
}

/// A writer that collects the bytes of a blob.
struct MemoryWriter {
    blobs: MemoryBlobs,
    bytes: Vec<u8>,
}

impl BlobWriter for MemoryWriter {
    fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError> {
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    fn length(&self) -> u64 {
        self.bytes.len() as u64
    }

    fn finish(self: Box<Self>, expected: Option<&Digest>) -> Result<Digest, BlobError> {
        check_announced(blake3::hash(&self.bytes), expected)?;
        self.blobs.put(&self.bytes)
    }
}

impl Write for MemoryWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
