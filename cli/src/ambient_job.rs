//! Ambient occlusion on a cluster: receivers become a job, and its result their openness.
//!
//! What receivers are for, texels or vertices, their caller knows: it writes the file.

use sightline_ambient::{Falloff, Receiver, Solver};
use sightline_model::openness::Openness;
use sightline_model::receivers::{self, Asked, Receivers};
use sightline_model::{Ambient, JobSpec};
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;

use crate::client::{self, Blob};
use crate::error::CliError;
use crate::progress::{Progress, say};
use crate::remote;
use crate::remote_args::RemoteArgs;

/// Receivers in the order of their blocks.
pub struct Ordered {
    /// The receivers as a job has them.
    pub receivers: Receivers,
    /// For each of them its place in the caller's order.
    order: Vec<u32>,
}

impl Ordered {
    /// Puts receivers in blocks, as the solver does in this process.
    pub fn new(solver: &Solver<'_>, all: &[Receiver]) -> Self {
        let settings = solver.settings();
        let blocks = solver.blocks(all);
        let order: Vec<u32> = blocks.iter().flatten().copied().collect();
        let receiver = |i: &u32| {
            let Receiver {
                point,
                normal,
                triangle,
            } = all[*i as usize];
            receivers::Receiver {
                point: point.to_array(),
                normal: normal.to_array(),
                triangle,
            }
        };
        let asked = Asked {
            distance: settings.distance,
            falloff: match settings.falloff {
                Falloff::None => receivers::Falloff::None,
                Falloff::Sqrt => receivers::Falloff::Sqrt,
            },
            lights: settings
                .lights
                .iter()
                .map(|light| light.corners().iter().map(|c| c.to_array()).collect())
                .collect(),
        };
        let receivers = order.iter().map(receiver).collect();
        let blocks = blocks.iter().map(|block| block.len() as u32).collect();
        Self {
            receivers: Receivers {
                asked,
                blocks,
                receivers,
            },
            order,
        }
    }

    /// The numbers of each receiver in the caller's order, one receiver after the other.
    pub fn back(&self, openness: &Openness) -> Vec<f32> {
        let numbers = openness.numbers as usize;
        let mut back = vec![f32::NAN; openness.values.len()];
        for (to, from) in self
            .order
            .iter()
            .zip(openness.values.chunks_exact(numbers.max(1)))
        {
            let start = *to as usize * numbers;
            if let Some(place) = back.get_mut(start..start + numbers) {
                place.copy_from_slice(from);
            }
        }
        back
    }
}

/// For whom a job is submitted.
#[derive(Clone, Debug, Default)]
pub struct Whom {
    /// The job's name, for people; at most 128 bytes.
    pub name: String,
    /// The user, by whom workers are shared; empty for none.
    pub user: String,
    /// -1000 to 1000; jobs of higher priority come first.
    pub priority: i32,
}

/// Computes receivers on the cluster of a coordinator, and shows the progress. Ctrl-C ends this client alone:
/// the job goes on, and the same call finds it again.
///
/// # Errors
/// [`CliError`]: what the coordinator refuses, a job that fails, or an interruption.
pub fn compute(
    remote: &RemoteArgs,
    scene: &Scene,
    receivers: &Receivers,
    whom: &Whom,
) -> Result<(v1::Job, Openness), CliError> {
    let progress = Progress::new();
    let done = remote::with(remote, async |mut client| {
        let job = submit(&mut client, scene, receivers, whom).await?;
        let mut show = |job: &v1::Job| progress.job(job, false);
        let job = client::follow_on(client.clone(), remote, job.id, &mut show).await?;
        // The coordinator may have restarted meanwhile.
        let mut client = JobsClient::new(client::channel(remote).await?);
        let openness = fetch(&mut client, &job, receivers).await?;
        Ok((job, openness))
    });
    progress.end();
    let (job, openness) = done?;
    if job.tiles_set_aside > 0 {
        say(&format!(
            "ATTENTION: {} tiles failed and were set aside: {} of {} receivers have no openness. `sightline \
             show --tiles {}` says why; the same command tries them again.",
            job.tiles_set_aside,
            openness.missing(),
            openness.points(),
            job.id
        ));
    }
    Ok((job, openness))
}

/// Uploads what the coordinator lacks, and submits the job. A job that is there already answers; tiles of it
/// that were set aside are tried again.
///
/// # Errors
/// [`CliError`]: what the coordinator refuses.
pub async fn submit(
    client: &mut JobsClient<Connection>,
    scene: &Scene,
    receivers: &Receivers,
    whom: &Whom,
) -> Result<v1::Job, CliError> {
    let bytes = receivers
        .encode()
        .map_err(|e| CliError::Input(e.to_string()))?;
    let ambient = Ambient {
        receivers: *blake3::hash(&bytes).as_bytes(),
        bytes: bytes.len() as u64,
        points: receivers.receivers.len() as u32,
        lights: receivers.asked.lights.len() as u32,
    };
    let blob = Blob::of(bytes);
    let request = v1::SubmitRequest {
        request_id: client::fresh_request_id(),
        name: whom.name.clone(),
        spec: Some(JobSpec::of_receivers(scene.digest().0, ambient).to_message()),
        priority: whom.priority,
        user: whom.user.clone(),
    };
    client::upload(client, scene).await?;
    let put = v1::PutReceiversRequest {
        chunks: blob.chunks.clone(),
        digest: blob.digest.clone(),
    };
    let mut answer = None;
    // Another job with the same receivers may be deleted, and they with it, before this one names them.
    for is_last in [false, true] {
        let calls = client.clone();
        let put = async || calls.clone().put_receivers(put.clone()).await.map(drop);
        blob.upload(client, put).await.map_err(|s| refused(&s))?;
        match client.submit(request.clone()).await {
            Ok(submitted) => {
                answer = Some(submitted.into_inner());
                break;
            }
            Err(s) if s.code() == tonic::Code::NotFound && !is_last => {}
            Err(s) => return Err(CliError::status(&s)),
        }
    }
    let answer = answer.unwrap_or_default();
    let job = answer.job.unwrap_or_default();
    if answer.existing {
        say(&format!("job {} does this already", job.id));
    }
    if job.state() == v1::JobState::Done && job.tiles_set_aside > 0 {
        say(&format!(
            "an earlier run set {} tiles aside: trying them again",
            job.tiles_set_aside
        ));
        let request = v1::ShowRequest { job: job.id };
        return client
            .retry(request)
            .await
            .map(tonic::Response::into_inner)
            .map_err(|s| CliError::status(&s));
    }
    Ok(job)
}

/// The answer of a coordinator that takes no receivers.
fn refused(s: &tonic::Status) -> CliError {
    match s.code() {
        tonic::Code::Unimplemented => CliError::Coordinator(
            "the coordinator is of an earlier version, which computes no ambient occlusion; run the same \
             version of sightline on both"
                .to_owned(),
        ),
        _ => CliError::status(s),
    }
}

/// Downloads the result of a job that has ended: the openness of these receivers, in their order.
///
/// # Errors
/// [`CliError`]: a job without a result, or a result that is not of these receivers.
pub async fn fetch(
    client: &mut JobsClient<Connection>,
    job: &v1::Job,
    receivers: &Receivers,
) -> Result<Openness, CliError> {
    client::must_be_done(job)?;
    let mut bytes = Vec::new();
    client::fetch_to(client, job, |data| {
        bytes.extend_from_slice(data);
        Ok(())
    })
    .await?;
    let openness = Openness::of_result(&bytes).map_err(CliError::internal)?;
    if openness.points() != receivers.receivers.len() {
        return Err(CliError::Internal(format!(
            "job {} has the openness of {} receivers, and {} were asked for; submit it again",
            job.id,
            openness.points(),
            receivers.receivers.len()
        )));
    }
    Ok(openness)
}
