//! Uploads in chunks, written to the disk as they arrive.

use std::sync::Arc;

use futures::StreamExt as _;
use sightline_proto::v1;
use tonic::{Status, Streaming};

use super::blocking::blocking;
use super::status;
use crate::state::Coordinator;
use crate::uploads::spool::Spool;

/// Fills a spool with the first chunk, if it has come already, and the chunks of a stream up to its end.
///
/// # Errors
/// The errors of the stream and of `chunk_of`; DATA_LOSS and INVALID_ARGUMENT when the chunks differ from the
/// announced ones.
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
        // The disk may block.
        spool = blocking(c, move |c| {
            spool.push(c, &chunk).map_err(|e| status::of_spool(&e))?;
            Ok(spool)
        })
        .await?;
    }
    spool.ended().map_err(|e| status::of_spool(&e))?;
    Ok(spool)
}
