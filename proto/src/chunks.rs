//! Blobs as streams of chunks of at most 1 MiB, each with a checksum.

use crate::v1::Chunk;

/// Maximum number of data bytes of a chunk.
pub const CHUNK_BYTES: usize = 1 << 20;

/// The reason why a stream of chunks is not a complete blob.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChunkError {
    /// A checksum does not match. Contains the offset of the chunk, in bytes.
    #[error("the chunk at byte {0} arrived damaged; send it again")]
    Checksum(u64),
    /// A chunk is too large, out of order, or beyond the announced length. Contains the offset that the
    /// rejected chunk states, in bytes.
    #[error(
        "the chunk at byte {0} is too large, out of order or beyond the announced length; \
         send all chunks again"
    )]
    Order(u64),
    /// The stream ended early.
    #[error("the stream ended after {got} bytes of {want}; send all chunks again")]
    Short {
        /// The number of received bytes.
        got: u64,
        /// The number of announced bytes.
        want: u64,
    },
    /// The announced length exceeds the limit. Contains the length and the limit, in bytes.
    #[error("{0} bytes were announced; at most {1} are accepted")]
    TooLarge(u64, u64),
}

/// Returns the number of chunks of `bytes`. The number is at least one, so that a length of zero is
/// announced, too.
pub fn count(bytes: &[u8]) -> usize {
    bytes.len().div_ceil(CHUNK_BYTES).max(1)
}

/// Returns chunk `i` of [`count`] chunks, or an empty chunk beyond the end.
pub fn piece(bytes: &[u8], i: usize) -> Chunk {
    let start = i.saturating_mul(CHUNK_BYTES).min(bytes.len());
    let data = &bytes[start..start.saturating_add(CHUNK_BYTES).min(bytes.len())];
    chunk(data.to_vec(), start as u64, bytes.len() as u64)
}

/// Creates the chunk of `data`, which begins at byte `offset` of a blob of `total` bytes.
///
/// All chunks except the last have [`CHUNK_BYTES`] bytes.
pub fn chunk(data: Vec<u8>, offset: u64, total: u64) -> Chunk {
    let total = if offset == 0 { total } else { 0 };
    Chunk {
        crc32c: crc32c::crc32c(&data),
        data,
        offset,
        total,
        address: None,
    }
}

/// Splits `bytes` into chunks.
pub fn cut(bytes: &[u8]) -> impl Iterator<Item = Chunk> + '_ {
    (0..count(bytes)).map(|i| piece(bytes, i))
}

/// A check that chunks arrive completely and in order. The check does not store the chunks.
#[derive(Debug)]
pub struct Sequence {
    got: u64,
    total: Option<u64>,
    limit: u64,
}

impl Sequence {
    /// Starts the check of a blob of at most `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self {
            got: 0,
            total: None,
            limit,
        }
    }

    /// Checks the next chunk.
    ///
    /// # Errors
    /// A [`ChunkError`] if the chunk is damaged, is not the next one, or announces too many bytes.
    pub fn next(&mut self, chunk: &Chunk) -> Result<(), ChunkError> {
        check(chunk)?;
        let total = *self.total.get_or_insert(chunk.total);
        if total > self.limit {
            return Err(ChunkError::TooLarge(total, self.limit));
        }
        let end = chunk.offset.saturating_add(chunk.data.len() as u64);
        if chunk.offset != self.got || end > total {
            return Err(ChunkError::Order(chunk.offset));
        }
        self.got = end;
        Ok(())
    }

    /// Returns the length of the blob after all chunks have arrived.
    ///
    /// # Errors
    /// [`ChunkError::Short`] if chunks are missing.
    pub fn end(&self) -> Result<u64, ChunkError> {
        let (got, want) = (self.got, self.total.unwrap_or(0));
        if self.total.is_some() && got == want {
            Ok(got)
        } else {
            Err(ChunkError::Short { got, want })
        }
    }
}

/// A buffer that checks chunks and assembles them into a blob.
#[derive(Debug)]
pub struct Assembler {
    bytes: Vec<u8>,
    sequence: Sequence,
}

impl Assembler {
    /// Starts a blob of at most `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self {
            bytes: Vec::new(),
            sequence: Sequence::new(limit),
        }
    }

    /// Appends the next chunk. Memory grows with the received bytes, not with the announced length.
    ///
    /// # Errors
    /// The errors of [`Sequence::next`].
    pub fn push(&mut self, chunk: &Chunk) -> Result<(), ChunkError> {
        self.sequence.next(chunk)?;
        self.bytes.extend_from_slice(&chunk.data);
        Ok(())
    }

    /// Returns the complete blob.
    ///
    /// # Errors
    /// The errors of [`Sequence::end`].
    pub fn finish(self) -> Result<Vec<u8>, ChunkError> {
        self.sequence.end().map(|_| self.bytes)
    }
}

/// A buffer that assembles consecutive blobs in one stream.
#[derive(Debug)]
pub struct Blobs {
    limit: u64,
    open: Option<Assembler>,
}

impl Blobs {
    /// Starts a stream of blobs of at most `limit` bytes each.
    pub fn new(limit: u64) -> Self {
        Self { limit, open: None }
    }

    /// Appends the next chunk. Returns the blob that the chunk completes, if any.
    ///
    /// # Errors
    /// The errors of [`Sequence::next`].
    pub fn push(&mut self, chunk: &Chunk) -> Result<Option<Vec<u8>>, ChunkError> {
        let blob = self.open.get_or_insert_with(|| Assembler::new(self.limit));
        blob.push(chunk)?;
        match blob.sequence.end() {
            Ok(_) => self.open.take().map(Assembler::finish).transpose(),
            Err(_) => Ok(None),
        }
    }
}

/// Checks the size and the checksum of a chunk.
///
/// # Errors
/// A [`ChunkError`] with the chunk's offset.
pub fn check(chunk: &Chunk) -> Result<(), ChunkError> {
    if chunk.data.len() > CHUNK_BYTES {
        return Err(ChunkError::Order(chunk.offset));
    }
    if crc32c::crc32c(&chunk.data) == chunk.crc32c {
        Ok(())
    } else {
        Err(ChunkError::Checksum(chunk.offset))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blobs_survive_chunks() {
        for n in [0, 1, CHUNK_BYTES, CHUNK_BYTES * 2 + 5] {
            let bytes: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let mut a = Assembler::new(1 << 30);
            cut(&bytes).for_each(|c| a.push(&c).unwrap());
            assert_eq!(cut(&bytes).count(), count(&bytes));
            assert_eq!(a.finish().unwrap(), bytes);
        }
    }

    #[test]
    fn damaged_missing_and_excess_chunks_are_rejected() {
        let bytes = vec![3u8; CHUNK_BYTES + 9];
        let chunks: Vec<_> = cut(&bytes).collect();
        let mut a = Assembler::new(1 << 30);
        assert_eq!(
            a.push(&chunks[1]),
            Err(ChunkError::Order(CHUNK_BYTES as u64))
        );
        let mut a = Assembler::new(1 << 30);
        a.push(&chunks[0]).unwrap();
        assert!(matches!(a.finish(), Err(ChunkError::Short { .. })));
        let mut bad = chunks[0].clone();
        bad.data[7] ^= 1;
        assert_eq!(
            Assembler::new(1 << 30).push(&bad),
            Err(ChunkError::Checksum(0))
        );
        assert!(matches!(
            Assembler::new(10).push(&chunks[0]),
            Err(ChunkError::TooLarge(..))
        ));
        assert!(matches!(
            Assembler::new(10).finish(),
            Err(ChunkError::Short { .. })
        ));
    }

    #[test]
    fn blobs_follow_each_other_in_one_stream() {
        let all = [vec![1u8; CHUNK_BYTES + 9], Vec::new(), vec![2u8; 5]];
        let mut blobs = Blobs::new(1 << 21);
        let ends: Vec<Vec<u8>> = all
            .iter()
            .flat_map(|b| cut(b))
            .filter_map(|chunk| blobs.push(&chunk).unwrap())
            .collect();
        assert!(ends == all);
        assert_eq!(blobs.push(&chunk(vec![3; 4], 0, 9)), Ok(None));
        assert_eq!(
            blobs.push(&chunk(vec![3; 4], 5, 9)),
            Err(ChunkError::Order(5))
        );
        assert_eq!(
            Blobs::new(8).push(&chunk(vec![3; 4], 0, 9)),
            Err(ChunkError::TooLarge(9, 8))
        );
    }
}
