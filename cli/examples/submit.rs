//! Submits a scene to a coordinator over gRPC, waits for the job and fetches the result.
//!
//! `cargo run --release --example submit -- http://127.0.0.1:7600 SCENE OUT.pvs`

use std::error::Error;
use std::path::Path;

use sightline_model::{GridCells, JobSpec, KnownCells, Method, Sampler, Sampling};
use sightline_proto::chunks;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::{self, JobState};

/// Bakes the scene at `path` with 4×2×4 cells at the coordinator `url`; gives the result's bytes.
///
/// # Errors
/// The scene, the connection, or the reason why the job has no result.
pub async fn bake_at(url: &str, path: &Path) -> Result<Vec<u8>, Box<dyn Error>> {
    let scene = sightline_scene::load(path)?;
    let mut client = JobsClient::new(
        sightline_proto::connecting::Credentials::default()
            .endpoint(url)?
            .connect()
            .await?,
    );

    // The scene travels as chunks that are named by their content; the coordinator says which it lacks.
    let blob = scene.to_blob();
    let parts: Vec<&[u8]> = blob.chunks(chunks::CHUNK_BYTES).collect();
    let digests: Vec<Vec<u8>> = parts
        .iter()
        .map(|p| blake3::hash(p).as_bytes().to_vec())
        .collect();
    let request = v1::MissingChunksRequest {
        digests: digests.clone(),
    };
    let missing = client.missing_chunks(request).await?.into_inner().digests;
    let wanted = (0..parts.len()).filter(|i| missing.contains(&digests[*i]));
    let sent: Vec<v1::Chunk> = wanted.map(|i| chunks::piece(parts[i], 0)).collect();
    client.put_chunks(tokio_stream::iter(sent)).await?;
    let digest = scene.digest().0;
    client
        .put_scene(v1::PutSceneRequest {
            digest: digest.to_vec(),
            chunks: digests,
        })
        .await?;

    // A request with the same id again is answered with the same job.
    let cells = GridCells::new(scene.bounds(), [4, 2, 4])?;
    let sampling = Sampling::new(Sampler::lines(KnownCells::Grid(cells)));
    let spec = JobSpec::new(digest, Method::aggressive(sampling));
    let request_id = format!("example {}", std::process::id());
    let request = v1::SubmitRequest {
        request_id,
        name: "example".to_owned(),
        spec: Some(spec.to_message()),
        ..Default::default()
    };
    let job = client
        .submit(request)
        .await?
        .into_inner()
        .job
        .ok_or("the answer has no job")?;
    let id = v1::ShowRequest { job: job.id };

    // The stream ends with the job.
    let mut news = client.watch(id).await?.into_inner();
    let mut last = job;
    while let Some(job) = news.message().await? {
        last = job;
    }
    if last.state() != JobState::Done {
        return Err(format!("the job is {}: {}", last.state().as_str_name(), last.reason).into());
    }
    let mut result = chunks::Assembler::new(1 << 30);
    let mut stream = client.fetch(id).await?.into_inner();
    while let Some(chunk) = stream.message().await? {
        result.push(&chunk)?;
    }
    Ok(result.finish()?)
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, url, scene, out] = args.as_slice() else {
        return Err("usage: submit URL SCENE OUT.pvs".into());
    };
    std::fs::write(out, bake_at(url, Path::new(scene)).await?)?;
    Ok(())
}
