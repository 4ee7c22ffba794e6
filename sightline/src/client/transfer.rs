//! Uploads of scenes and receivers in chunks, and downloads of results.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::sync::Arc;

use futures::StreamExt as _;
use sightline_proto::chunks::{CHUNK_BYTES, Sequence};
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;

use super::job::Job;
use crate::error::Error;
use crate::output::Output;

/// Maximum size of a downloaded result, in bytes.
const MAX_RESULT: u64 = 64 << 30;

/// Uploads a scene, unless the coordinator has it.
pub(crate) async fn upload(
    client: &mut JobsClient<Connection>,
    scene: &Scene,
) -> Result<(), Error> {
    let blob = Blob::new(scene.to_blob());
    let put = v1::PutSceneRequest {
        chunks: blob.chunks.clone(),
        digest: blob.digest.clone(),
    };
    let calls = client.clone();
    let put = async || calls.clone().put_scene(put.clone()).await.map(drop);
    blob.upload(client, put)
        .await
        .map_err(|s| Error::status(&s))
}

/// The bytes of an upload in chunks.
pub(crate) struct Blob {
    bytes: Arc<Vec<u8>>,
    /// The BLAKE3 digest of all bytes.
    pub(crate) digest: Vec<u8>,
    /// The BLAKE3 digests of the chunks, in order.
    pub(crate) chunks: Vec<Vec<u8>>,
}

/// Returns the BLAKE3 digest of bytes.
fn digest(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes().to_vec()
}

impl Blob {
    /// Divides bytes into chunks.
    pub(crate) fn new(bytes: Vec<u8>) -> Self {
        Self {
            digest: digest(&bytes),
            chunks: bytes.chunks(CHUNK_BYTES).map(digest).collect(),
            bytes: Arc::new(bytes),
        }
    }

    /// Returns the bytes of the chunk with this index.
    fn chunk(&self, index: usize) -> &[u8] {
        let start = index * CHUNK_BYTES;
        &self.bytes[start..self.bytes.len().min(start + CHUNK_BYTES)]
    }

    /// Returns the number of bytes that an upload would send. A completely stored blob is no longer stored in
    /// chunks, so the request includes the digest of the whole.
    pub(crate) async fn upload_bytes(
        &self,
        client: &mut JobsClient<Connection>,
    ) -> Result<u64, tonic::Status> {
        let digests = self.chunks.iter().chain([&self.digest]).cloned().collect();
        let request = v1::MissingChunksRequest { digests };
        let missing = client.missing_chunks(request).await?.into_inner().digests;
        if !missing.contains(&self.digest) {
            return Ok(0);
        }
        let needed = (0..self.chunks.len()).filter(|i| missing.contains(&self.chunks[*i]));
        Ok(needed.map(|i| self.chunk(i).len() as u64).sum())
    }

    /// Uploads the chunks that the coordinator lacks, until `put` has joined them.
    pub(crate) async fn upload(
        &self,
        client: &mut JobsClient<Connection>,
        put: impl AsyncFn() -> Result<(), tonic::Status>,
    ) -> Result<(), tonic::Status> {
        // If the coordinator has the whole blob, only its digest is needed.
        match put().await {
            Err(s) if s.code() == tonic::Code::FailedPrecondition => {}
            done => return done,
        }
        // Another client that uploads the same bytes at the same time may cause the removal of the chunks
        // once, so try twice.
        for is_last in [false, true] {
            let request = v1::MissingChunksRequest {
                digests: self.chunks.clone(),
            };
            let missing = client.missing_chunks(request).await?.into_inner().digests;
            let missing: BTreeSet<Vec<u8>> = missing.into_iter().collect();
            let needed: Vec<usize> = (0..self.chunks.len())
                .filter(|i| missing.contains(&self.chunks[*i]))
                .collect();
            // Each chunk is copied only when it is sent.
            let whole = Self {
                bytes: Arc::clone(&self.bytes),
                digest: Vec::new(),
                chunks: Vec::new(),
            };
            let chunks = needed.into_iter().map(move |i| {
                let data = whole.chunk(i).to_vec();
                v1::Chunk {
                    crc32c: crc32c::crc32c(&data),
                    offset: 0,
                    total: data.len() as u64,
                    data,
                    address: None,
                }
            });
            client.put_chunks(tokio_stream::iter(chunks)).await?;
            match put().await {
                Err(s) if s.code() == tonic::Code::FailedPrecondition && !is_last => {}
                done => return done,
            }
        }
        Ok(())
    }
}

/// Downloads the partial result of a job to `output`. Returns the size of the file in bytes.
pub(crate) async fn fetch_partial(
    client: &mut JobsClient<Connection>,
    job: &Job,
    output: &Output,
) -> Result<u64, Error> {
    let request = v1::ShowRequest { job: job.id() };
    let answer = client.fetch_partial(request).await;
    let mut stream = answer.map_err(|s| Error::status(&s))?.into_inner();
    let (mut part, mut sequence) = (output.begin()?, Sequence::new(MAX_RESULT));
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| Error::status(&s))?;
        sequence.next(&chunk).map_err(Error::internal)?;
        part.write_all(&chunk.data)
            .map_err(|e| Error::writing(output.path(), &e))?;
    }
    let bytes = sequence.end().map_err(Error::internal)?;
    part.place()?;
    Ok(bytes)
}

/// Downloads a result to `output`. Returns the size of the file in bytes. The function replaces an existing
/// file only after it received all bytes, and their digest is the digest in the job.
pub(crate) async fn fetch(
    client: &mut JobsClient<Connection>,
    job: &Job,
    output: &Output,
) -> Result<u64, Error> {
    // Bytes are written as they arrive, because a result with certificates may exceed the memory.
    let mut part = output.begin()?;
    let write = |data: &[u8]| {
        part.write_all(data)
            .map_err(|e| Error::writing(output.path(), &e))
    };
    let bytes = fetch_to(client, job, write).await?;
    part.place()?;
    Ok(bytes)
}

/// Downloads a result and passes its bytes to `take` in order. Returns the number of bytes. The passed bytes
/// are the result only if this function succeeds.
pub(crate) async fn fetch_to(
    client: &mut JobsClient<Connection>,
    job: &Job,
    mut take: impl FnMut(&[u8]) -> Result<(), Error>,
) -> Result<u64, Error> {
    let request = v1::ShowRequest { job: job.id() };
    let answer = client.fetch(request).await;
    let mut stream = answer.map_err(|s| Error::status(&s))?.into_inner();
    let (mut sequence, mut hasher) = (Sequence::new(MAX_RESULT), blake3::Hasher::new());
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| Error::status(&s))?;
        sequence.next(&chunk).map_err(Error::internal)?;
        hasher.update(&chunk.data);
        take(&chunk.data)?;
    }
    let bytes = sequence.end().map_err(Error::internal)?;
    if hasher.finalize().as_bytes().as_slice() != job.message().result {
        return Err(Error::internal(
            "the digest of the received bytes differs from the digest of the job's result; fetch the \
             result again",
        ));
    }
    Ok(bytes)
}
