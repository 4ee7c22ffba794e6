//! The client of a coordinator: submissions, jobs, and the state of the farm.

mod endpoint;
mod farm;
mod follow;
mod handle;
mod job;
mod submit;
mod transfer;

use sightline_model::JobSpec;
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;
use sightline_traces::Traces;

pub use self::endpoint::{CredentialFiles, Endpoint};
pub use self::farm::{Invalidation, WorkerList};
pub(crate) use self::follow::follow;
use self::follow::follow_across_restarts;
pub use self::handle::{JobAction, JobHandle};
pub use self::job::Job;
pub use self::submit::{Estimate, Submission};
pub(crate) use self::submit::{send_spans, submit};
pub(crate) use self::transfer::{Blob, fetch, fetch_to, upload};
use crate::error::Error;
use crate::observer::{Observer, cancelled};
use crate::process::runtime;

/// A client of a coordinator. Every call opens a connection, so the coordinator may restart between calls.
///
/// ```no_run
/// use sightline::{Client, Endpoint, JobOptions, LoadOptions, SceneSource, Silent, Submission};
///
/// let source = SceneSource::File("level.glb".into());
/// let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
/// let job = JobOptions::default().resolve(&scene, &Silent)?;
/// let client = Client::new(Endpoint::new("http://127.0.0.1:7600"))?;
/// let mut handle = client.submit(&scene, &job, &Submission::default(), &Silent)?;
/// handle.wait(&Silent)?;
/// handle.fetch("level.pvs".as_ref(), &Silent)?;
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Debug)]
pub struct Client {
    endpoint: Endpoint,
    runtime: tokio::runtime::Runtime,
}

/// A filter for jobs.
///
/// ```
/// use sightline::JobFilter;
///
/// let filter = JobFilter { user: "mara".into(), ..Default::default() };
/// assert_eq!(filter.limit, None);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JobFilter {
    /// The maximum number of jobs; the newest ones are selected. Default: all jobs.
    pub limit: Option<u32>,
    /// Selects jobs with numbers below this job number. Default: no limit.
    pub before: Option<u64>,
    /// Selects jobs in one of these states, by their names. Empty for all states.
    pub states: Vec<String>,
    /// Selects jobs whose names contain this text. Empty for all names.
    pub name: String,
    /// Selects jobs of this user. Empty for all users.
    pub user: String,
}

/// A list of jobs in ascending order of their numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobList {
    /// The jobs.
    pub jobs: Vec<Job>,
    /// True if the coordinator has older jobs that the filter selects.
    pub has_older: bool,
}

impl Client {
    /// Creates a client, which connects at the first call.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Internal`] if threads cannot be started.
    pub fn new(endpoint: Endpoint) -> Result<Self, Error> {
        Ok(Self {
            endpoint,
            runtime: runtime()?,
        })
    }

    /// Returns the endpoint.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// Connects to the coordinator and runs a call. Returns an error if the observer cancels first.
    pub(crate) fn run<T>(
        &self,
        observer: &dyn Observer,
        call: impl AsyncFnOnce(Connection) -> Result<T, Error>,
    ) -> Result<T, Error> {
        self.runtime.block_on(async {
            let work = async { call(self.endpoint.connect().await?).await };
            tokio::select! {
                done = work => done,
                () = cancelled(observer) => Err(Error::cancelled(
                    "interrupted; submitted jobs continue at the coordinator",
                )),
            }
        })
    }

    /// Runs a call of the `Jobs` service.
    fn call<T>(
        &self,
        observer: &dyn Observer,
        call: impl AsyncFnOnce(&mut JobsClient<Connection>) -> Result<tonic::Response<T>, tonic::Status>,
    ) -> Result<T, Error> {
        self.run(observer, async |connection| {
            let answer = call(&mut JobsClient::new(connection)).await;
            Ok(answer.map_err(|s| Error::status(&s))?.into_inner())
        })
    }

    /// Uploads a scene and submits a job. If the coordinator has a job with the same key, returns that job
    /// ([`JobHandle::is_existing`]).
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached, or [`crate::ErrorKind::Input`]
    /// if it rejects the job.
    pub fn submit(
        &self,
        scene: &Scene,
        job: &JobSpec,
        submission: &Submission,
        observer: &dyn Observer,
    ) -> Result<JobHandle<'_>, Error> {
        self.submit_traced(scene, job, submission, &Traces::default(), observer)
    }

    /// Submits a job like [`Self::submit`], and sends the spans of the submission to a collector.
    ///
    /// # Errors
    /// As for [`Self::submit`].
    pub fn submit_traced(
        &self,
        scene: &Scene,
        job: &JobSpec,
        submission: &Submission,
        traces: &Traces,
        observer: &dyn Observer,
    ) -> Result<JobHandle<'_>, Error> {
        let request = submission.request(job);
        let answer = self.run(observer, async |connection| {
            let mut client = JobsClient::new(connection);
            submit(&mut client, scene, request, traces).await
        })?;
        let job = Job::from(answer.job.unwrap_or_default());
        Ok(JobHandle::new(self, job, answer.existing))
    }

    /// Estimates the cost of a job from the finished jobs of the coordinator, without uploading or
    /// submitting.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached, or [`crate::ErrorKind::Input`]
    /// if it rejects the job.
    pub fn estimate(
        &self,
        scene: &Scene,
        job: &JobSpec,
        submission: &Submission,
        observer: &dyn Observer,
    ) -> Result<Estimate, Error> {
        let request = submission.request(job);
        self.run(observer, async |connection| {
            submit::estimate(&mut JobsClient::new(connection), scene, request).await
        })
    }

    /// Lists the jobs that a filter selects.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if a state is unknown, or [`crate::ErrorKind::Coordinator`] if the
    /// coordinator cannot be reached or rejects the call.
    pub fn jobs(&self, filter: &JobFilter, observer: &dyn Observer) -> Result<JobList, Error> {
        let states = filter.states.iter().map(|name| state_named(name));
        let states: Vec<i32> = states.collect::<Result<_, _>>()?;
        self.run(observer, async |connection| {
            let mut client = JobsClient::new(connection);
            let mut list = JobList::default();
            let mut before = filter.before.unwrap_or(0);
            loop {
                let request = v1::ListRequest {
                    limit: filter.limit.unwrap_or(0),
                    before,
                    states: states.clone(),
                    name: filter.name.clone(),
                    user: filter.user.clone(),
                    scene: Vec::new(),
                };
                let page = client.list(request).await;
                let v1::ListResponse { jobs, older } =
                    page.map_err(|s| Error::status(&s))?.into_inner();
                before = jobs.first().map_or(0, |job| job.id);
                list.jobs.splice(0..0, jobs.into_iter().map(Job::from));
                list.has_older = older;
                if filter.limit.is_some() || !older || before == 0 {
                    return Ok(list);
                }
            }
        })
    }

    /// Returns the job with this number.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached, or the job does not exist.
    pub fn job(&self, number: u64, observer: &dyn Observer) -> Result<JobHandle<'_>, Error> {
        let request = v1::ShowRequest { job: number };
        let job = self.call(observer, async |client| client.show(request).await)?;
        Ok(JobHandle::new(self, job.into(), true))
    }

    /// Checks that the coordinator serves.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator does not serve.
    pub fn health(&self, observer: &dyn Observer) -> Result<(), Error> {
        use tonic_health::pb::health_check_response::ServingStatus;
        use tonic_health::pb::health_client::HealthClient;

        let request = tonic_health::pb::HealthCheckRequest {
            service: "sightline.v1.Jobs".to_owned(),
        };
        self.run(observer, async |connection| {
            let answer = HealthClient::new(connection).check(request).await;
            match answer.map_err(|s| Error::status(&s))?.into_inner().status() {
                ServingStatus::Serving => Ok(()),
                other => Err(Error::coordinator(format!(
                    "the coordinator does not serve: its health is {}",
                    other.as_str_name()
                ))),
            }
        })
    }
}

/// Returns the number of the job state with this name, such as `queued`, in the protocol.
fn state_named(name: &str) -> Result<i32, Error> {
    let full = format!("JOB_STATE_{}", name.to_ascii_uppercase());
    let state = v1::JobState::from_str_name(&full).filter(|s| *s != v1::JobState::Unspecified);
    state.map(i32::from).ok_or_else(|| {
        Error::usage(format!(
            "{name} is not a job state; give queued, running, paused, cancelled, failed or done"
        ))
        .about("state")
    })
}
