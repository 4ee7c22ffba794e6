//! Downloads of stored blobs as streams of chunks, with bounded memory.

use std::io::Read;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures::Stream;
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_records::ids::Digest;
use sightline_store::BlobReader;
use tokio::sync::mpsc::Sender;
use tonic::Status;

use super::blocking::blocking;
use super::{status, wire};
use crate::coordinator::Coordinator;
use crate::outputs::presigned;

/// The number of chunks that are read before the client has received the last one.
const AHEAD: usize = 4;

/// Maximum time for which a client may leave the next chunk unread.
const LONGEST_UNREAD: Duration = Duration::from_secs(60);

/// Sends a chunk from a thread that may block. Returns true if the client accepted the chunk within
/// `longest`.
fn send_to(
    to: &Sender<Result<v1::Chunk, Status>>,
    chunk: Result<v1::Chunk, Status>,
    longest: Duration,
) -> bool {
    let runtime = tokio::runtime::Handle::current();
    let sent = runtime.block_on(tokio::time::timeout(longest, to.send(chunk)));
    matches!(sent, Ok(Ok(())))
}

/// The chunks of a download.
pub(super) type ChunkStream = Pin<Box<dyn Stream<Item = Result<v1::Chunk, Status>> + Send>>;

/// Returns the length of a blob in bytes.
fn length(c: &Coordinator, d: &Digest) -> Result<u64, Status> {
    let none = "no blob with this digest is stored; retention may have removed the blob";
    c.blobs
        .len(d)
        .map_err(|e| status::of_blob(&e))?
        .ok_or_else(|| Status::not_found(none))
}

/// Opens a blob. The whole blob is checked against its digest first, so that no damaged byte is sent.
fn open(c: &Coordinator, d: &Digest) -> Result<BlobReader, Status> {
    c.blobs.open_checked(d).map_err(|e| match e {
        e if e.is_lost() => Status::data_loss(e.to_string()),
        // A failure of the disk or of the store does not mean that the blob is damaged.
        e => status::of_blob(&e),
    })
}

/// Streams a blob in chunks.
///
/// # Errors
/// NOT_FOUND if the blob is absent, DATA_LOSS if it is damaged.
pub(super) async fn stream_blob(c: &Arc<Coordinator>, d: Digest) -> Result<ChunkStream, Status> {
    let blob = blocking(c, move |c| length(c, &d).and_then(|_| open(c, &d))).await?;
    stream(c, blob).await
}

/// Streams a blob in chunks, or returns one chunk with the blob's address.
///
/// # Errors
/// As for [`stream_blob`].
pub(super) async fn stream_or_address(
    c: &Arc<Coordinator>,
    d: Digest,
) -> Result<ChunkStream, Status> {
    let found = blocking(c, move |c| {
        let bytes = length(c, &d)?;
        match presigned::reading(c, &d, bytes) {
            Some(address) => Ok(Ok((bytes, address))),
            None => open(c, &d).map(Err),
        }
    });
    match found.await? {
        Ok((total, address)) => {
            let address = Some(wire::address(address));
            let chunk = v1::Chunk {
                total,
                address,
                ..v1::Chunk::default()
            };
            Ok(Box::pin(futures::stream::iter([Ok(chunk)])))
        }
        Err(blob) => stream(c, blob).await,
    }
}

async fn stream(c: &Arc<Coordinator>, blob: BlobReader) -> Result<ChunkStream, Status> {
    let closed =
        |_| Status::unavailable("the coordinator is stopping; try again after its restart");
    let permit = Arc::clone(&c.results.downloads)
        .acquire_owned()
        .await
        .map_err(closed)?;
    let (send, receive) = tokio::sync::mpsc::channel(AHEAD);
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        // A client that disconnects or stops reading receives no further chunks.
        read_chunks(blob.bytes, blob.length, |chunk| {
            send_to(&send, chunk, LONGEST_UNREAD)
        });
    });
    Ok(Box::pin(tokio_stream::wrappers::ReceiverStream::new(
        receive,
    )))
}

/// Streams bytes in memory in chunks.
///
/// # Errors
/// UNAVAILABLE if the coordinator is stopping.
pub(super) async fn stream_bytes(
    c: &Arc<Coordinator>,
    bytes: Arc<[u8]>,
) -> Result<ChunkStream, Status> {
    let closed =
        |_| Status::unavailable("the coordinator is stopping; try again after its restart");
    let permit = Arc::clone(&c.results.downloads)
        .acquire_owned()
        .await
        .map_err(closed)?;
    let (send, receive) = tokio::sync::mpsc::channel(AHEAD);
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        // A client that disconnects or stops reading receives no further chunks.
        read_chunks(&*bytes, bytes.len() as u64, |chunk| {
            send_to(&send, chunk, LONGEST_UNREAD)
        });
    });
    Ok(Box::pin(tokio_stream::wrappers::ReceiverStream::new(
        receive,
    )))
}

/// Reads `length` bytes and passes them to `send` in chunks, until `send` returns false.
fn read_chunks(
    mut bytes: impl Read,
    length: u64,
    mut send: impl FnMut(Result<v1::Chunk, Status>) -> bool,
) {
    let mut offset = 0;
    loop {
        let mut data =
            Vec::with_capacity((length - offset).min(chunks::CHUNK_BYTES as u64) as usize);
        let read = (&mut bytes)
            .take(chunks::CHUNK_BYTES as u64)
            .read_to_end(&mut data);
        let end = offset + data.len() as u64;
        let chunk = match read {
            Ok(0) if length > 0 => Err(Status::data_loss(
                "a stored file became shorter while it was sent",
            )),
            Ok(_) => Ok(chunks::chunk(data, offset, length)),
            Err(e) => Err(Status::data_loss(format!(
                "a stored file is no longer readable: {e}"
            ))),
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
    use super::*;

    fn chunks_of(bytes: &[u8], length: u64) -> Vec<Result<v1::Chunk, Status>> {
        let mut out = Vec::new();
        read_chunks(bytes, length, |chunk| {
            out.push(chunk);
            true
        });
        out
    }

    #[test]
    fn blob_and_bytes_have_same_chunks() {
        for n in [0, 1, chunks::CHUNK_BYTES, 2 * chunks::CHUNK_BYTES + 5] {
            let bytes: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let read: Vec<v1::Chunk> = chunks_of(&bytes, n as u64)
                .into_iter()
                .map(Result::unwrap)
                .collect();
            assert!(read == chunks::cut(&bytes).collect::<Vec<_>>(), "{n} bytes");
        }
    }

    #[tokio::test]
    async fn client_that_does_not_read_is_disconnected() {
        let (send, mut receive) = tokio::sync::mpsc::channel(1);
        let sent = tokio::task::spawn_blocking(move || {
            let mut sent = 0;
            read_chunks(
                &[7; 10 * chunks::CHUNK_BYTES][..],
                10 * chunks::CHUNK_BYTES as u64,
                |chunk| {
                    sent += 1;
                    send_to(&send, chunk, Duration::from_millis(20))
                },
            );
            sent
        });
        // One chunk waits in the channel, and the next one does not fit.
        assert_eq!(sent.await.unwrap(), 2);
        assert!(receive.recv().await.is_some() && receive.recv().await.is_none());
    }

    #[test]
    fn shortened_blob_is_error() {
        let read = chunks_of(&[7; 10], 11);
        assert!(read.last().unwrap().is_err());
        assert!(chunks_of(&[], 1)[0].is_err());
    }
}
