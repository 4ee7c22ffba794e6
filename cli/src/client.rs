//! The client's side of a coordinator: connect, upload a scene, follow a job, fetch a result.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::chunks::{CHUNK_BYTES, Sequence};
use sightline_proto::connecting::{Connection, Credentials};
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;

use crate::error::CliError;
use crate::output::Output;
use crate::progress::say;
use crate::remote_args::RemoteArgs;

/// Most bytes of a downloaded result.
const MAX_RESULT: u64 = 64 << 30;

/// Time between two attempts to reach a coordinator again.
const RECONNECT: Duration = Duration::from_secs(1);

/// Connects to a coordinator.
pub async fn channel(remote: &RemoteArgs) -> Result<Connection, CliError> {
    connect(&remote.coordinator, &remote.credentials()?).await
}

/// Connects to the coordinator at `url`.
pub async fn connect(url: &str, credentials: &Credentials) -> Result<Connection, CliError> {
    credentials
        .endpoint(url)
        .map_err(|e| {
            CliError::Usage(format!(
                "{url} cannot be the coordinator's address: {e}; give one such as http://127.0.0.1:7600"
            ))
        })?
        .connect()
        .await
        .map(|channel| credentials.over(channel))
        .map_err(|e| {
            let reason = causes(&e);
            if reason.contains("certificate") {
                return CliError::Coordinator(format!(
                    "{url} is not trusted ({reason}); --ca names the authority that signed the coordinator's \
                     certificate, and the address must be one that the certificate names"
                ));
            }
            CliError::Coordinator(format!(
                "no coordinator answers at {url} ({reason}); start one with `sightline coordinator`, or name \
                 another with --coordinator"
            ))
        })
}

/// Returns the causes of an error, outermost first, or the error itself where it has no cause.
fn causes(error: &dyn std::error::Error) -> String {
    let all = std::iter::successors(error.source(), |cause| cause.source());
    let texts: Vec<String> = all.map(ToString::to_string).collect();
    if texts.is_empty() {
        error.to_string()
    } else {
        texts.join(": ")
    }
}

/// Uploads a scene, unless the coordinator has it.
pub async fn upload(client: &mut JobsClient<Connection>, scene: &Scene) -> Result<(), CliError> {
    let blob = Blob::of(scene.to_blob());
    let put = v1::PutSceneRequest {
        chunks: blob.chunks.clone(),
        digest: blob.digest.clone(),
    };
    let calls = client.clone();
    let put = async || calls.clone().put_scene(put.clone()).await.map(drop);
    blob.upload(client, put)
        .await
        .map_err(|s| CliError::status(&s))
}

/// Bytes that are uploaded in chunks.
pub struct Blob {
    bytes: Arc<Vec<u8>>,
    /// BLAKE3 digest of the whole.
    pub digest: Vec<u8>,
    /// BLAKE3 digests of its chunks, in order.
    pub chunks: Vec<Vec<u8>>,
}

impl Blob {
    /// These bytes.
    pub fn of(bytes: Vec<u8>) -> Self {
        let digest = |part: &[u8]| blake3::hash(part).as_bytes().to_vec();
        let (whole, chunks) = (
            digest(&bytes),
            bytes.chunks(CHUNK_BYTES).map(digest).collect(),
        );
        Self {
            bytes: Arc::new(bytes),
            digest: whole,
            chunks,
        }
    }

    /// Uploads the chunks that the coordinator lacks, until `put` has joined them.
    pub async fn upload(
        &self,
        client: &mut JobsClient<Connection>,
        put: impl AsyncFn() -> Result<(), tonic::Status>,
    ) -> Result<(), tonic::Status> {
        // A whole that the coordinator has needs only its digest.
        match put().await {
            Err(s) if s.code() == tonic::Code::FailedPrecondition => {}
            done => return done,
        }
        // Another client who sends the same at the same time may take the chunks away once.
        for is_last in [false, true] {
            let request = v1::MissingChunksRequest {
                digests: self.chunks.clone(),
            };
            let missing = client.missing_chunks(request).await?.into_inner().digests;
            let missing: BTreeSet<Vec<u8>> = missing.into_iter().collect();
            // Each chunk is copied when it is sent.
            let needed: Vec<usize> = (0..self.chunks.len())
                .filter(|i| missing.contains(&self.chunks[*i]))
                .collect();
            let bytes = Arc::clone(&self.bytes);
            let chunks = needed.into_iter().map(move |i| {
                let start = i * CHUNK_BYTES;
                let data = bytes[start..bytes.len().min(start + CHUNK_BYTES)].to_vec();
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

/// A new request id. It makes one submission safe to repeat; the coordinator recognises the same job of
/// another submission by the job's key.
pub fn fresh_request_id() -> String {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| d.as_nanos());
    format!("cli-{}-{now:x}", std::process::id())
}

/// Follows a job while the connection holds; gives its last state if it has ended.
async fn follow_once(
    client: &mut JobsClient<Connection>,
    job: u64,
    show: &mut dyn FnMut(&v1::Job),
) -> Result<Option<v1::Job>, tonic::Status> {
    let mut stream = client.watch(v1::ShowRequest { job }).await?.into_inner();
    while let Some(message) = stream.next().await {
        let message = message?;
        show(&message);
        if message.finished_at_ms > 0 {
            return Ok(Some(message));
        }
    }
    // The coordinator is stopping, and had time to end the stream.
    Ok(None)
}

/// Follows a job until it ends; returns its last state.
pub async fn follow(
    client: &mut JobsClient<Connection>,
    job: u64,
    show: &mut dyn FnMut(&v1::Job),
) -> Result<v1::Job, CliError> {
    let ended = follow_once(client, job, show)
        .await
        .map_err(|s| CliError::status(&s))?;
    ended.ok_or_else(|| {
        CliError::Coordinator("the coordinator ended the stream before the job".to_owned())
    })
}

/// Follows a job until it ends, however often the coordinator restarts meanwhile.
pub async fn follow_on(
    mut client: JobsClient<Connection>,
    remote: &RemoteArgs,
    job: u64,
    show: &mut dyn FnMut(&v1::Job),
) -> Result<v1::Job, CliError> {
    let mut is_reached = false;
    loop {
        let ended = follow_once(&mut client, job, &mut |job| {
            is_reached = true;
            show(job);
        })
        .await;
        match ended {
            Ok(Some(last)) => return Ok(last),
            // The first attempt tells that there is none.
            Err(s) if !is_reached || !is_lost(&s) => return Err(CliError::status(&s)),
            Ok(None) | Err(_) => {}
        }
        say(&format!(
            "the connection to {} is lost; the job continues there: connecting again",
            remote.coordinator
        ));
        loop {
            tokio::time::sleep(RECONNECT).await;
            if let Ok(channel) = channel(remote).await {
                client = JobsClient::new(channel);
                break;
            }
        }
    }
}

/// Whether an error is one of the connection.
fn is_lost(s: &tonic::Status) -> bool {
    std::error::Error::source(s).is_some() || s.code() == tonic::Code::Unavailable
}

/// Turns a job that ended without a result into an error.
pub fn must_be_done(job: &v1::Job) -> Result<(), CliError> {
    match job.state() {
        v1::JobState::Done => Ok(()),
        v1::JobState::Failed => Err(CliError::Job(format!(
            "job {} failed: {}",
            job.id, job.reason
        ))),
        v1::JobState::Cancelled => Err(CliError::Job(format!(
            "job {} was cancelled; `sightline retry {}` continues it",
            job.id, job.id
        ))),
        _ => Err(CliError::Coordinator(format!(
            "job {} has not ended yet; `sightline watch {}` follows it",
            job.id, job.id
        ))),
    }
}

/// Downloads what is done of a job to `output`.
pub async fn fetch_partial(
    client: &mut JobsClient<Connection>,
    job: &v1::Job,
    output: &Output,
) -> Result<u64, CliError> {
    let request = v1::ShowRequest { job: job.id };
    let mut stream = client
        .fetch_partial(request)
        .await
        .map_err(|s| CliError::status(&s))?
        .into_inner();
    let (mut part, mut sequence) = (output.begin()?, Sequence::new(MAX_RESULT));
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| CliError::status(&s))?;
        sequence.next(&chunk).map_err(CliError::internal)?;
        part.write_all(&chunk.data)
            .map_err(|e| CliError::writing(output.path(), &e))?;
    }
    let bytes = sequence.end().map_err(CliError::internal)?;
    part.place()?;
    say(&format!(
        "warning: job {} has not ended: {} of {} tiles are in this result, all other cells show everything",
        job.id, job.tiles_done, job.tiles_total
    ));
    Ok(bytes)
}

/// Downloads a result to `output`, which is replaced only when all of it has arrived and has the job's
/// digest.
pub async fn fetch(
    client: &mut JobsClient<Connection>,
    job: &v1::Job,
    output: &Output,
) -> Result<u64, CliError> {
    // Written as it arrives: a result with certificates may exceed memory.
    let mut part = output.begin()?;
    let write = |data: &[u8]| {
        part.write_all(data)
            .map_err(|e| CliError::writing(output.path(), &e))
    };
    let bytes = fetch_to(client, job, write).await?;
    part.place()?;
    Ok(bytes)
}

/// Downloads a result; `take` gets its bytes in order. What it has got is the result when this succeeds.
pub async fn fetch_to(
    client: &mut JobsClient<Connection>,
    job: &v1::Job,
    mut take: impl FnMut(&[u8]) -> Result<(), CliError>,
) -> Result<u64, CliError> {
    let request = v1::ShowRequest { job: job.id };
    let mut stream = client
        .fetch(request)
        .await
        .map_err(|s| CliError::status(&s))?
        .into_inner();
    let (mut sequence, mut hasher) = (Sequence::new(MAX_RESULT), blake3::Hasher::new());
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| CliError::status(&s))?;
        sequence.next(&chunk).map_err(CliError::internal)?;
        hasher.update(&chunk.data);
        take(&chunk.data)?;
    }
    let bytes = sequence.end().map_err(CliError::internal)?;
    if hasher.finalize().as_bytes().as_slice() != job.result {
        return Err(CliError::Internal(
            "the result that arrived is not the job's; fetch it again".to_owned(),
        ));
    }
    Ok(bytes)
}
