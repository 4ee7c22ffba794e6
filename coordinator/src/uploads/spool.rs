//! The bytes of an upload until it is complete: few of them in memory, more in a file without a name.

use std::fs::File;
use std::io::{Read, Seek as _, Write as _};

use sightline_proto::chunks::{ChunkError, Sequence};
use sightline_proto::v1;
use sightline_records::ids::Digest;
use sightline_store::BlobError;

use crate::quota::{LimitExceeded, Reserved, Sender};
use crate::state::Coordinator;

/// Bytes that stay in memory. Many calls at once hold as much each.
const MAX_IN_MEMORY: usize = 64 << 10;

/// An upload that is not complete.
pub(crate) struct Spool {
    place: Place,
    announced: u64,
    sequence: Sequence,
    length: u64,
    hasher: blake3::Hasher,
    /// Given back when the spool is dropped.
    _reserved: Reserved,
}

enum Place {
    Memory(Vec<u8>),
    File(File),
}

/// An error of an upload that is not what it announces, or cannot be stored.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SpoolError {
    /// The upload is too large for now.
    #[error(transparent)]
    LimitExceeded(#[from] LimitExceeded),
    /// A chunk is damaged or not the next one, or some are missing.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// The length is not the announced one.
    #[error(
        "{got} bytes arrived or were announced by the first chunk; the header announced {announced}"
    )]
    Length {
        /// The announced length.
        announced: u64,
        /// The length of the chunks.
        got: u64,
    },
    /// The disk fails.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

impl Spool {
    /// Begins an upload of `announced` bytes. Reserves the bytes before the first one arrives.
    ///
    /// # Errors
    /// [`SpoolError::LimitExceeded`] when unfinished uploads have too many bytes already.
    pub(crate) fn begin(
        c: &Coordinator,
        sender: Sender<'_>,
        announced: u64,
    ) -> Result<Self, SpoolError> {
        let reserved = c.unfinished.reserve(sender, announced);
        let reserved = reserved.inspect_err(|beyond| c.metrics.refused(beyond.name()))?;
        Ok(Self {
            place: Place::Memory(Vec::new()),
            announced,
            sequence: Sequence::new(announced),
            length: 0,
            hasher: blake3::Hasher::new(),
            _reserved: reserved,
        })
    }

    /// Adds the next chunk.
    ///
    /// # Errors
    /// [`SpoolError`] when the chunk is not the next one, or cannot be written.
    pub(crate) fn push(&mut self, c: &Coordinator, chunk: &v1::Chunk) -> Result<(), SpoolError> {
        if chunk.offset == 0 && chunk.total != self.announced {
            return Err(SpoolError::Length {
                announced: self.announced,
                got: chunk.total,
            });
        }
        self.sequence.next(chunk)?;
        self.append(c, &chunk.data)
    }

    /// Adds the next bytes.
    ///
    /// # Errors
    /// [`SpoolError`] when there are more than announced, or they cannot be written.
    pub(crate) fn append(&mut self, c: &Coordinator, bytes: &[u8]) -> Result<(), SpoolError> {
        let length = self.length.saturating_add(bytes.len() as u64);
        if length > self.announced {
            return Err(SpoolError::Length {
                announced: self.announced,
                got: length,
            });
        }
        if let Place::Memory(few) = &self.place
            && few.len() + bytes.len() > MAX_IN_MEMORY
            // Blobs in memory have no files.
            && let Some(mut file) = c.blobs.scratch()?
        {
            file.write_all(few).map_err(|e| c.blobs.io_error(e))?;
            self.place = Place::File(file);
        }
        match &mut self.place {
            Place::Memory(few) => few.extend_from_slice(bytes),
            Place::File(file) => file.write_all(bytes).map_err(|e| c.blobs.io_error(e))?,
        }
        self.hasher.update(bytes);
        self.length = length;
        Ok(())
    }

    /// Checks that an upload in chunks is complete.
    ///
    /// # Errors
    /// [`SpoolError::Chunk`] when chunks are missing.
    pub(crate) fn ended(&self) -> Result<(), SpoolError> {
        Ok(self.sequence.end().map(|_| ())?)
    }

    /// Returns the digest of an upload that is complete.
    ///
    /// # Errors
    /// [`SpoolError::Length`] when bytes are missing.
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

    /// Returns the announced length.
    pub(crate) fn announced(&self) -> u64 {
        self.announced
    }

    /// Reads the upload into memory.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn bytes(&mut self, c: &Coordinator) -> Result<Vec<u8>, BlobError> {
        // As many as have arrived, so that a short file needs little memory.
        let mut bytes = Vec::with_capacity(usize::try_from(self.length).unwrap_or(0));
        self.read(c, |from| from.read_to_end(&mut bytes))?
            .map_err(|e| c.blobs.io_error(e))?;
        Ok(bytes)
    }

    /// Calls `with` with a reader of the upload.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn read<T>(
        &mut self,
        c: &Coordinator,
        with: impl FnOnce(&mut dyn Read) -> T,
    ) -> Result<T, BlobError> {
        match &mut self.place {
            Place::Memory(few) => Ok(with(&mut &few[..])),
            Place::File(file) => {
                file.rewind().map_err(|e| c.blobs.io_error(e))?;
                Ok(with(file))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use sightline_proto::chunks;

    use super::*;
    use crate::clock::SystemClock;
    use crate::state::Leases;
    use sightline_store::{FileBlobs, MemoryBlobs, MemoryStore};

    fn filled(c: &Coordinator, bytes: &[u8], announced: u64) -> Result<Spool, SpoolError> {
        let mut spool = Spool::begin(c, Sender::User("ada"), announced)?;
        chunks::cut(bytes).try_for_each(|chunk| spool.push(c, &chunk))?;
        spool.digest().map(|_| spool)
    }

    #[test]
    fn spool_keeps_exactly_announced_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let blobs: [Box<dyn sightline_store::Blobs>; 2] = [
            Box::new(MemoryBlobs::new()),
            Box::new(FileBlobs::open(folder.path()).unwrap()),
        ];
        for blobs in blobs {
            let (store, clock) = (Box::new(MemoryStore::new()), Box::new(SystemClock));
            let c = Coordinator::new(Leases::default(), store, blobs, clock).unwrap();
            for n in [0, 1, chunks::CHUNK_BYTES, 3 * chunks::CHUNK_BYTES + 5] {
                let bytes: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
                let mut spool = filled(&c, &bytes, n as u64).unwrap();
                assert!(spool.is_complete() && c.unfinished.of("ada") == n as u64);
                assert_eq!(spool.digest().unwrap(), *blake3::hash(&bytes).as_bytes());
                let mut read = Vec::new();
                spool
                    .read(&c, |from| from.read_to_end(&mut read).unwrap())
                    .unwrap();
                assert!(
                    read == bytes && spool.bytes(&c).unwrap() == bytes,
                    "{n} bytes"
                );
                drop(spool);
                assert_eq!(c.unfinished.of("ada"), 0);
                // Fewer and more than were announced.
                for announced in [n as u64 + 1, (n as u64).saturating_sub(1)] {
                    let wrong = filled(&c, &bytes, announced).err();
                    assert!(
                        wrong.is_some() == (announced != n as u64),
                        "{n} of {announced} bytes"
                    );
                }
            }
            // Bytes without chunks are counted, too.
            let mut spool = Spool::begin(&c, Sender::Worker, 3).unwrap();
            spool.append(&c, b"ab").unwrap();
            assert!(spool.digest().is_err());
            assert!(matches!(
                spool.append(&c, b"cd"),
                Err(SpoolError::Length {
                    announced: 3,
                    got: 4
                })
            ));
            assert!(matches!(
                Spool::begin(&c, Sender::Worker, u64::MAX),
                Err(SpoolError::LimitExceeded(_))
            ));
        }
    }
}
