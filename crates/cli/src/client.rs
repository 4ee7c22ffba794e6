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
            let reason = std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string);
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

/// Uploads the chunks of a scene that the coordinator lacks.
pub async fn upload(client: &mut JobsClient<Connection>, scene: &Scene) -> Result<(), CliError> {
    let blob = Arc::new(scene.to_blob());
    let whole = blake3::hash(&blob[..]).as_bytes().to_vec();
    let digests: Vec<Vec<u8>> =
        blob.chunks(CHUNK_BYTES).map(|p| blake3::hash(p).as_bytes().to_vec()).collect();
    let put = v1::PutSceneRequest { chunks: digests.clone(), digest: whole };
    // A scene that the coordinator has needs only its digest.
    match client.put_scene(put.clone()).await {
        Ok(_) => return Ok(()),
        Err(s) if s.code() == tonic::Code::FailedPrecondition => {}
        Err(s) => return Err(CliError::status(&s)),
    }
    // Another client who sends the same scene at the same time may take the chunks away once.
    for is_last in [false, true] {
        let request = v1::MissingChunksRequest { digests: digests.clone() };
        let missing =
            client.missing_chunks(request).await.map_err(|s| CliError::status(&s))?.into_inner().digests;
        let missing: BTreeSet<Vec<u8>> = missing.into_iter().collect();
        // Each chunk is copied when it is sent.
        let needed: Vec<usize> =
            (0..put.chunks.len()).filter(|i| missing.contains(&put.chunks[*i])).collect();
        let blob = Arc::clone(&blob);
        let chunks = needed.into_iter().map(move |i| {
            let start = i * CHUNK_BYTES;
            let data = blob[start..blob.len().min(start + CHUNK_BYTES)].to_vec();
            v1::Chunk {
                crc32c: crc32c::crc32c(&data),
                offset: 0,
                total: data.len() as u64,
                data,
                address: None,
            }
        });
        client.put_chunks(tokio_stream::iter(chunks)).await.map_err(|s| CliError::status(&s))?;
        match client.put_scene(put.clone()).await {
            Ok(_) => break,
            Err(s) if s.code() == tonic::Code::FailedPrecondition && !is_last => {}
            Err(s) => return Err(CliError::status(&s)),
        }
    }
    Ok(())
}

/// A new request id. It makes one submission safe to repeat; the coordinator recognises the same job of
/// another submission by the job's key.
pub fn fresh_request_id() -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_nanos());
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
    let ended = follow_once(client, job, show).await.map_err(|s| CliError::status(&s))?;
    ended.ok_or_else(|| CliError::Coordinator("the coordinator ended the stream before the job".to_owned()))
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
        v1::JobState::Failed => Err(CliError::Job(format!("job {} failed: {}", job.id, job.reason))),
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
    let mut stream = client.fetch_partial(request).await.map_err(|s| CliError::status(&s))?.into_inner();
    let (mut part, mut sequence) = (output.begin()?, Sequence::new(MAX_RESULT));
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| CliError::status(&s))?;
        sequence.next(&chunk).map_err(CliError::internal)?;
        part.write_all(&chunk.data).map_err(|e| CliError::writing(output.path(), &e))?;
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
    let request = v1::ShowRequest { job: job.id };
    let mut stream = client.fetch(request).await.map_err(|s| CliError::status(&s))?.into_inner();
    // Written as it arrives: a result with certificates may exceed memory.
    let mut part = output.begin()?;
    let (mut sequence, mut hasher) = (Sequence::new(MAX_RESULT), blake3::Hasher::new());
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|s| CliError::status(&s))?;
        sequence.next(&chunk).map_err(CliError::internal)?;
        hasher.update(&chunk.data);
        part.write_all(&chunk.data).map_err(|e| CliError::writing(output.path(), &e))?;
    }
    let bytes = sequence.end().map_err(CliError::internal)?;
    if hasher.finalize().as_bytes().as_slice() != job.result {
        return Err(CliError::Internal(
            "the result that arrived is not the job's; fetch it again".to_owned(),
        ));
    }
    part.place()?;
    Ok(bytes)
}
