//! Uploads in chunks, written to the disk as they arrive.

use std::sync::Arc;

use futures::StreamExt as _;
use sightline_proto::v1;
use tonic::{Status, Streaming};

use super::blocking::blocking;
use super::status;
use crate::coordinator::Coordinator;
use crate::uploads::spool::Spool;

/// Appends the first chunk, if it was already received, and all chunks of a stream to a spool.
///
/// # Errors
/// The errors of the stream and of `chunk_of`; DATA_LOSS or INVALID_ARGUMENT if the chunks differ from the
/// announcement.
pub(super) async fn filled<P>(
    c: &Arc<Coordinator>,
    mut spool: Spool,
    first: Option<v1::Chunk>,
    parts: &mut Streaming<P>,
    chunk_of: impl Fn(P) -> Result<v1::Chunk, Status>,
) -> Result<Spool, Status> {
    let mut next = first;
    loop {
        let chunk = match next.take() {
            Some(chunk) => chunk,
            None => match parts.next().await {
                Some(part) => chunk_of(part?)?,
                None => break,
            },
        };
        // Writing may block on the disk.
        spool = blocking(c, move |c| {
            spool
                .push(&*c.blobs, &chunk)
                .map_err(|e| status::of_spool(&e))?;
            Ok(spool)
        })
        .await?;
    }
    spool.ended().map_err(|e| status::of_spool(&e))?;
    Ok(spool)
}
