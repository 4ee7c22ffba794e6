//! Stored files as streams of chunks, without holding them in memory.

use std::fs::File;
use std::io::Read as _;
use std::pin::Pin;
use std::sync::Arc;

use futures::Stream;
use sightline_proto::chunks;
use sightline_proto::v1;
use tonic::Status;

use crate::core::Coordinator;
use crate::jobs_service::blocking;
use crate::status;
use crate::store::Digest;

/// Chunks that are read before the last was taken.
const AHEAD: usize = 4;

/// What a client downloads.
pub(crate) type ChunkStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

/// A blob as a stream of chunks.
pub(crate) async fn stream_blob(c: &Arc<Coordinator>, d: Digest) -> Result<ChunkStream, Status> {
    // Checked against its digest once, as a whole, so that nothing damaged is ever sent.
    let (file, length) = blocking(c, move |c| match c.blobs.has(&d) {
        Ok(true) => c.blobs.open_checked(&d).map_err(|e| Status::data_loss(e.to_string())),
        Ok(false) => {
            Err(Status::not_found("nothing with this digest is stored here; it may have been tidied away"))
        }
        Err(e) => Err(status::of_blob(&e)),
    })
    .await?;
    let closed = |_| Status::unavailable("the coordinator is ending; ask again when it is back");
    let permit = Arc::clone(&c.downloads).acquire_owned().await.map_err(closed)?;
    let (send, receive) = tokio::sync::mpsc::channel(AHEAD);
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        // Whoever has gone away wants no more.
        read_chunks(file, length, |chunk| send.blocking_send(chunk).is_ok());
    });
    Ok(Box::pin(tokio_stream::wrappers::ReceiverStream::new(receive)))
}

/// Reads a file of so many bytes and gives its chunks to `send`, until that wants no more.
fn read_chunks(mut file: File, length: u64, mut send: impl FnMut(Result<v1::Chunk, Status>) -> bool) {
    let mut offset = 0;
    loop {
        let mut data = Vec::with_capacity((length - offset).min(chunks::CHUNK_BYTES as u64) as usize);
        let read = (&mut file).take(chunks::CHUNK_BYTES as u64).read_to_end(&mut data);
        let end = offset + data.len() as u64;
        let chunk = match read {
            Ok(0) if length > 0 => Err(Status::data_loss("a stored file became shorter while it was sent")),
            Ok(_) => Ok(chunks::chunk(data, offset, length)),
            Err(e) => Err(Status::data_loss(format!("a stored file cannot be read any more: {e}"))),
        };
        let failed = chunk.is_err();
        if !send(chunk) || failed || end >= length {
            return;
        }
        offset = end;
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Seek as _, Write as _};

    use super::*;

    fn chunks_of(bytes: &[u8], length: u64) -> Vec<Result<v1::Chunk, Status>> {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file.rewind().unwrap();
        let mut out = Vec::new();
        read_chunks(file, length, |chunk| {
            out.push(chunk);
            true
        });
        out
    }

    #[test]
    fn a_file_is_cut_as_bytes_are() {
        for n in [0, 1, chunks::CHUNK_BYTES, 2 * chunks::CHUNK_BYTES + 5] {
            let bytes: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let read: Vec<v1::Chunk> = chunks_of(&bytes, n as u64).into_iter().map(Result::unwrap).collect();
            assert!(read == chunks::cut(&bytes).collect::<Vec<_>>(), "{n} bytes");
        }
    }

    #[test]
    fn a_file_that_became_shorter_is_an_error() {
        let read = chunks_of(&[7; 10], 11);
        assert!(read.last().unwrap().is_err());
        assert!(chunks_of(&[], 1)[0].is_err());
    }
}
