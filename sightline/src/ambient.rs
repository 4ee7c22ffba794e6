//! Ambient occlusion: a job computes the openness of receivers.
//!
//! The caller knows the use of its receivers (texels or vertices) and writes their file.

use sightline_ambient::{Falloff, Receiver, Solver};
use sightline_model::openness::Openness;
use sightline_model::receivers::{self, ReceiverSettings, Receivers};
use sightline_model::{Ambient, JobSpec};
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;

use crate::client::{Blob, Client, Job, JobHandle, Submission, fetch_to, upload};
use crate::error::Error;
use crate::observer::{Observer, note};

/// Receivers of ambient light in the order of a job: one block of the solver after the other.
///
/// ```no_run
/// use sightline::{LoadOptions, Local, OrderedReceivers, SceneSource, Silent};
/// use sightline_ambient::{AmbientScene, Receiver, Solver, SolverSettings};
///
/// let source = SceneSource::File("level.glb".into());
/// let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
/// let above = Receiver { point: glam::DVec3::Y, normal: glam::DVec3::Y, triangle: None };
/// let prepared = AmbientScene::new(&scene, false)?;
/// let receivers = OrderedReceivers::new(&Solver::new(&prepared, SolverSettings::new(2.0)), &[above]);
/// let result = sightline::ambient(&scene, &receivers, &Local::default(), &Silent)?;
/// println!("openness {:?}, error at most {}", receivers.restore(&result.openness), result.openness.bound);
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct OrderedReceivers {
    /// The receivers in the order of the job.
    receivers: Receivers,
    /// For each receiver in the order of the job, its index in the caller's list.
    order: Vec<u32>,
}

/// The outcome of a job of ambient occlusion.
#[derive(Clone, Debug)]
pub struct AmbientResult {
    /// The job in its last state.
    pub job: Job,
    /// The openness of the receivers, in the order of the job. [`OrderedReceivers::restore`] converts the
    /// values into the caller's order.
    pub openness: Openness,
}

impl OrderedReceivers {
    /// Returns the receivers in the order of the job.
    pub fn receivers(&self) -> &Receivers {
        &self.receivers
    }

    /// Sorts receivers into the blocks of the solver.
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
        let requested = ReceiverSettings {
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
                settings: requested,
                blocks,
                receivers,
            },
            order,
        }
    }

    /// Returns the values in the caller's order of the receivers: for each receiver its openness, then the
    /// form factor of each light.
    pub fn restore(&self, openness: &Openness) -> Vec<f32> {
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

impl Client {
    /// Computes the ambient occlusion of receivers on the farm of the coordinator. If the observer cancels,
    /// the waiting ends, but the job continues. A second call with the same scene and receivers returns the
    /// same job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call,
    /// [`crate::ErrorKind::Job`] if the job fails, or [`crate::ErrorKind::Cancelled`] if the observer
    /// cancels.
    pub fn ambient(
        &self,
        scene: &Scene,
        receivers: &OrderedReceivers,
        submission: &Submission,
        observer: &dyn Observer,
    ) -> Result<AmbientResult, Error> {
        let mut handle = self.submit_ambient(scene, receivers, submission, observer)?;
        handle.wait(observer)?;
        let openness = handle.fetch_openness(receivers, observer)?;
        let job = handle.job().clone();
        let result = AmbientResult { job, openness };
        let aside = result.job.message().tiles_set_aside;
        if aside > 0 {
            note(
                observer,
                format!(
                    "ATTENTION: {aside} tiles failed and were set aside: {} of {} receivers have no \
                     openness. `sightline show --tiles {}` prints the reasons; run the same command \
                     again to retry.",
                    result.openness.missing(),
                    result.openness.points(),
                    result.job.id()
                ),
            );
        }
        Ok(result)
    }

    /// Uploads the scene and the receivers, and submits a job of ambient occlusion. If the coordinator has a
    /// job with the same key, returns that job, and retries its tiles that were set aside.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn submit_ambient(
        &self,
        scene: &Scene,
        receivers: &OrderedReceivers,
        submission: &Submission,
        observer: &dyn Observer,
    ) -> Result<JobHandle<'_>, Error> {
        let (job, existing) = self.run(observer, async |connection| {
            let mut client = JobsClient::new(connection);
            submit(&mut client, scene, receivers, submission, observer).await
        })?;
        Ok(JobHandle::new(self, job, existing))
    }
}

impl JobHandle<'_> {
    /// Downloads the openness of the receivers of an ended job, in the order of the job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Job`] if the job has no result, or [`crate::ErrorKind::Coordinator`] if the
    /// coordinator cannot be reached or rejects the call.
    pub fn fetch_openness(
        &self,
        receivers: &OrderedReceivers,
        observer: &dyn Observer,
    ) -> Result<Openness, Error> {
        self.client().run(observer, async |connection| {
            fetch(&mut JobsClient::new(connection), self.job(), receivers).await
        })
    }
}

/// Uploads the chunks of the scene and of the receivers that the coordinator lacks, and submits the job. If
/// the coordinator has a job with the same key, returns that job, and retries its tiles that were set aside.
pub(crate) async fn submit(
    client: &mut JobsClient<Connection>,
    scene: &Scene,
    receivers: &OrderedReceivers,
    submission: &Submission,
    observer: &dyn Observer,
) -> Result<(Job, bool), Error> {
    let receivers = &receivers.receivers;
    let bytes = receivers
        .encode()
        .map_err(|e| Error::input(e.to_string()))?;
    let ambient = Ambient {
        receivers: *blake3::hash(&bytes).as_bytes(),
        bytes: bytes.len() as u64,
        points: receivers.receivers.len() as u32,
        lights: receivers.settings.lights.len() as u32,
    };
    let blob = Blob::new(bytes);
    let request = submission.request(&JobSpec::of_receivers(scene.digest().0, ambient));
    upload(client, scene).await?;
    let put = v1::PutReceiversRequest {
        chunks: blob.chunks.clone(),
        digest: blob.digest.clone(),
    };
    let mut answer = None;
    // The deletion of another job with the same receivers may remove the receivers before this job references
    // them, so try twice.
    for is_last in [false, true] {
        let calls = client.clone();
        let put = async || calls.clone().put_receivers(put.clone()).await.map(drop);
        blob.upload(client, put).await.map_err(|s| rejected(&s))?;
        match client.submit(request.clone()).await {
            Ok(submitted) => {
                answer = Some(submitted.into_inner());
                break;
            }
            Err(s) if s.code() == tonic::Code::NotFound && !is_last => {}
            Err(s) => return Err(Error::status(&s)),
        }
    }
    let answer = answer.unwrap_or_default();
    let job = Job::from(answer.job.unwrap_or_default());
    if answer.existing {
        note(
            observer,
            format!(
                "job {} does this already: it has the same scene and receivers",
                job.id()
            ),
        );
    }
    let aside = job.message().tiles_set_aside;
    if job.is_done() && aside > 0 {
        note(
            observer,
            format!(
                "an earlier run set {aside} tiles aside; the coordinator leases these tiles again"
            ),
        );
        let retried = client.retry(v1::ShowRequest { job: job.id() }).await;
        let retried = retried.map_err(|s| Error::status(&s))?.into_inner();
        return Ok((retried.into(), answer.existing));
    }
    Ok((job, answer.existing))
}

/// Converts the error of a coordinator that rejects receivers.
fn rejected(s: &tonic::Status) -> Error {
    match s.code() {
        tonic::Code::Unimplemented => Error::coordinator(
            "the coordinator has an earlier version, which computes no ambient occlusion; run the same \
             version of sightline on the client and the coordinator",
        ),
        _ => Error::status(s),
    }
}

/// Downloads the result of an ended job: the openness of these receivers, in their order.
pub(crate) async fn fetch(
    client: &mut JobsClient<Connection>,
    job: &Job,
    receivers: &OrderedReceivers,
) -> Result<Openness, Error> {
    job.ensure_done()?;
    let mut bytes = Vec::new();
    fetch_to(client, job, |data| {
        bytes.extend_from_slice(data);
        Ok(())
    })
    .await?;
    let openness = Openness::of_result(&bytes).map_err(Error::internal)?;
    let expected = receivers.order.len();
    if openness.points() != expected {
        return Err(Error::internal(format!(
            "job {} has the openness of {} receivers, expected {expected}; submit the job again",
            job.id(),
            openness.points()
        )));
    }
    Ok(openness)
}
