//! The bytes of an incomplete upload: small uploads in memory, larger ones in a file without a name.

use std::fs::File;
use std::io::{Read, Seek as _, Write as _};

use sightline_proto::chunks::{ChunkError, Sequence};
use sightline_proto::v1;
use sightline_records::ids::Digest;
use sightline_store::{BlobError, Blobs};

use crate::quota::{LimitExceeded, Reserved, Sender};
use crate::telemetry::metrics::Metrics;
use crate::uploads::state::UploadState;

/// Maximum size of an upload in memory, in bytes. Each of many simultaneous calls may use as much.
const MAX_IN_MEMORY: usize = 64 << 10;

/// An upload that is not complete.
pub(crate) struct Spool {
    storage: SpoolStorage,
    announced: u64,
    sequence: Sequence,
    length: u64,
    hasher: blake3::Hasher,
    /// The reservation of bytes, which ends when the spool is dropped.
    _reserved: Reserved,
}

enum SpoolStorage {
    Memory(Vec<u8>),
    File(File),
}

/// An error of an upload that differs from its announcement, or cannot be stored.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SpoolError {
    /// The upload exceeds the limit of unfinished uploads.
    #[error(transparent)]
    LimitExceeded(#[from] LimitExceeded),
    /// A chunk is damaged, out of order or missing.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// The length differs from the announced length.
    #[error(
        "{got} bytes arrived or were announced by the first chunk, but the header announced \
         {announced}"
    )]
    Length {
        /// The announced length in bytes.
        announced: u64,
        /// The length of the received chunks in bytes.
        got: u64,
    },
    /// The disk fails.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

impl Spool {
    /// Starts an upload of `announced` bytes, and reserves the bytes before the first one arrives.
    ///
    /// # Errors
    /// [`SpoolError::LimitExceeded`] if unfinished uploads already have too many bytes.
    pub(crate) fn begin(
        uploads: &UploadState,
        metrics: &Metrics,
        sender: Sender<'_>,
        announced: u64,
    ) -> Result<Self, SpoolError> {
        let reserved = uploads.unfinished.reserve(sender, announced);
        let reserved = reserved.inspect_err(|beyond| metrics.refused(beyond.name()))?;
        Ok(Self {
            storage: SpoolStorage::Memory(Vec::new()),
            announced,
            sequence: Sequence::new(announced),
            length: 0,
            hasher: blake3::Hasher::new(),
            _reserved: reserved,
        })
    }

    /// Appends the next chunk.
    ///
    /// # Errors
    /// [`SpoolError`] if the chunk is not the next one, or cannot be written.
    pub(crate) fn push(&mut self, blobs: &dyn Blobs, chunk: &v1::Chunk) -> Result<(), SpoolError> {
        if chunk.offset == 0 && chunk.total != self.announced {
            return Err(SpoolError::Length {
                announced: self.announced,
                got: chunk.total,
            });
        }
        self.sequence.next(chunk)?;
        self.append(blobs, &chunk.data)
    }

    /// Appends the next bytes.
    ///
    /// # Errors
    /// [`SpoolError`] if the upload has more bytes than announced, or the bytes cannot be written.
    pub(crate) fn append(&mut self, blobs: &dyn Blobs, bytes: &[u8]) -> Result<(), SpoolError> {
        let length = self.length.saturating_add(bytes.len() as u64);
        if length > self.announced {
            return Err(SpoolError::Length {
                announced: self.announced,
                got: length,
            });
        }
        if let SpoolStorage::Memory(few) = &self.storage
            && few.len() + bytes.len() > MAX_IN_MEMORY
            // A blob store in memory has no files.
            && let Some(mut file) = blobs.scratch()?
        {
            file.write_all(few).map_err(|e| blobs.io_error(e))?;
            self.storage = SpoolStorage::File(file);
        }
        match &mut self.storage {
            SpoolStorage::Memory(few) => few.extend_from_slice(bytes),
            SpoolStorage::File(file) => file.write_all(bytes).map_err(|e| blobs.io_error(e))?,
        }
        self.hasher.update(bytes);
        self.length = length;
        Ok(())
    }

    /// Checks that an upload in chunks is complete.
    ///
    /// # Errors
    /// [`SpoolError::Chunk`] if chunks are missing.
    pub(crate) fn ended(&self) -> Result<(), SpoolError> {
        Ok(self.sequence.end().map(|_| ())?)
    }

    /// Returns the digest of a complete upload.
    ///
    /// # Errors
    /// [`SpoolError::Length`] if bytes are missing.
    pub(crate) fn digest(&self) -> Result<Digest, SpoolError> {
        if self.length != self.announced {
            return Err(SpoolError::Length {
                announced: self.announced,
                got: self.length,
            });
        }
        Ok(*self.hasher.finalize().as_bytes())
    }

    /// Returns true if all announced bytes have arrived.
    pub(crate) fn is_complete(&self) -> bool {
        self.length == self.announced
    }

    /// Returns the announced length in bytes.
    pub(crate) fn announced(&self) -> u64 {
        self.announced
    }

    /// Reads the upload into memory.
    ///
    /// # Errors
    /// [`BlobError`] if the file cannot be read.
    pub(crate) fn bytes(&mut self, blobs: &dyn Blobs) -> Result<Vec<u8>, BlobError> {
        // The capacity is the number of received bytes, so that a short file needs little memory.
        let mut bytes = Vec::with_capacity(usize::try_from(self.length).unwrap_or(0));
        self.read(blobs, |from| from.read_to_end(&mut bytes))?
            .map_err(|e| blobs.io_error(e))?;
        Ok(bytes)
    }

    /// Calls `with` with a reader of the upload.
    ///
    /// # Errors
    /// [`BlobError`] if the file cannot be read.
    pub(crate) fn read<T>(
        &mut self,
        blobs: &dyn Blobs,
        with: impl FnOnce(&mut dyn Read) -> T,
    ) -> Result<T, BlobError> {
        match &mut self.storage {
            SpoolStorage::Memory(few) => Ok(with(&mut &few[..])),
            SpoolStorage::File(file) => {
                file.rewind().map_err(|e| blobs.io_error(e))?;
                Ok(with(file))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use sightline_proto::chunks;

    use super::*;
    use sightline_store::{FileBlobs, MemoryBlobs};

    /// The state that an upload needs in these tests.
    #[derive(Default)]
    struct Uploading {
        uploads: UploadState,
        metrics: Metrics,
    }

    impl Uploading {
        fn begin(&self, sender: Sender<'_>, announced: u64) -> Result<Spool, SpoolError> {
            Spool::begin(&self.uploads, &self.metrics, sender, announced)
        }

        fn filled(
            &self,
            blobs: &dyn Blobs,
            bytes: &[u8],
            announced: u64,
        ) -> Result<Spool, SpoolError> {
            let mut spool = self.begin(Sender::User("ada"), announced)?;
            chunks::cut(bytes).try_for_each(|chunk| spool.push(blobs, &chunk))?;
            spool.digest().map(|_| spool)
        }
    }

    #[test]
    fn spool_keeps_exactly_announced_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let blobs: [Box<dyn sightline_store::Blobs>; 2] = [
            Box::new(MemoryBlobs::new()),
            Box::new(FileBlobs::open(folder.path()).unwrap()),
        ];
        for blobs in blobs {
            let blobs = &*blobs;
            let c = Uploading::default();
            for n in [0, 1, chunks::CHUNK_BYTES, 3 * chunks::CHUNK_BYTES + 5] {
                let bytes: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
                let mut spool = c.filled(blobs, &bytes, n as u64).unwrap();
                assert!(spool.is_complete() && c.uploads.unfinished.bytes_of("ada") == n as u64);
                assert_eq!(spool.digest().unwrap(), *blake3::hash(&bytes).as_bytes());
                let mut read = Vec::new();
                spool
                    .read(blobs, |from| from.read_to_end(&mut read).unwrap())
                    .unwrap();
                assert!(
                    read == bytes && spool.bytes(blobs).unwrap() == bytes,
                    "{n} bytes"
                );
                drop(spool);
                assert_eq!(c.uploads.unfinished.bytes_of("ada"), 0);
                // More and fewer bytes are announced than sent.
                for announced in [n as u64 + 1, (n as u64).saturating_sub(1)] {
                    let wrong = c.filled(blobs, &bytes, announced).err();
                    assert!(
                        wrong.is_some() == (announced != n as u64),
                        "{n} of {announced} bytes"
                    );
                }
            }
            // Bytes without chunks count, too.
            let mut spool = c.begin(Sender::Worker, 3).unwrap();
            spool.append(blobs, b"ab").unwrap();
            assert!(spool.digest().is_err());
            assert!(matches!(
                spool.append(blobs, b"cd"),
                Err(SpoolError::Length {
                    announced: 3,
                    got: 4
                })
            ));
            assert!(matches!(
                c.begin(Sender::Worker, u64::MAX),
                Err(SpoolError::LimitExceeded(_))
            ));
        }
    }
}
