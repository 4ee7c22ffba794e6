//! Submissions: a scene and a job for a coordinator, and an estimate of the job's cost.

use serde::{Deserialize, Serialize};
use sightline_model::JobSpec;
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_scene::Scene;
use sightline_traces::{Span, SpanTime, TraceId, Traces};

use super::transfer::{Blob, upload};
use crate::error::Error;

/// The name, user and priority of a submission.
///
/// ```
/// use sightline::Submission;
///
/// let submission = Submission { name: "harbour".into(), priority: 10, ..Default::default() };
/// assert!(submission.user.is_none());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Submission {
    /// The display name of the job, cut to 32 characters.
    pub name: String,
    /// The submitting user, cut to 32 characters. Jobs of the same priority share the workers evenly between
    /// users. Default: the login name.
    pub user: Option<String>,
    /// The priority, -1000 to 1000. Jobs of a higher priority get workers first. Default: 0.
    pub priority: i32,
    /// A text that makes the submission safe to repeat: the same text gives the same job. Default: a new text
    /// for each submission.
    pub request_id: Option<String>,
}

impl Submission {
    /// Creates the request for a job.
    pub(crate) fn request(&self, job: &JobSpec) -> v1::SubmitRequest {
        v1::SubmitRequest {
            request_id: self.request_id.clone().unwrap_or_else(fresh_request_id),
            name: short(&self.name),
            spec: Some(job.to_message()),
            priority: self.priority,
            user: short(&self.user.clone().unwrap_or_else(login_name)),
        }
    }
}

/// Creates a request id. The id makes one submission safe to repeat. If another submission has the same job,
/// the coordinator recognises the job by its key.
fn fresh_request_id() -> String {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| d.as_nanos());
    format!("cli-{}-{now:x}", std::process::id())
}

/// Returns a name in the form that the coordinator accepts: at most 32 characters, without control
/// characters.
fn short(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(32).collect()
}

/// Returns the name of the user who runs this program, or an empty name if the system does not report it.
fn login_name() -> String {
    let variable = |name| std::env::var(name).ok().filter(|user| !user.is_empty());
    let name = variable("USER")
        .or_else(|| variable("LOGNAME"))
        .or_else(|| variable("USERNAME"));
    name.or_else(user_of_process).unwrap_or_default()
}

/// Returns the user of this process from the system's list of users. Containers and services often lack the
/// user in the environment.
#[cfg(target_os = "linux")]
fn user_of_process() -> Option<String> {
    use std::os::unix::fs::MetadataExt as _;
    let number = std::fs::metadata("/proc/self").ok()?.uid();
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(number)).then(|| name.to_owned())
    });
    Some(name.unwrap_or_else(|| format!("user {number}")))
}

#[cfg(not(target_os = "linux"))]
fn user_of_process() -> Option<String> {
    None
}

/// Uploads a scene and submits a request about it.
pub(crate) async fn submit(
    client: &mut JobsClient<Connection>,
    scene: &Scene,
    request: v1::SubmitRequest,
    traces: &Traces,
) -> Result<v1::SubmitResponse, Error> {
    let begun = SpanTime::now();
    upload(client, scene).await?;
    let uploaded = SpanTime::now();
    let answer = client.submit(request).await;
    let answer = answer.map_err(|s| Error::status(&s))?.into_inner();
    send_spans(traces, &answer, begun, uploaded);
    Ok(answer)
}

/// Sends the spans of a submission: the work of the client before the job existed, and the time until the
/// answer. A job that existed before the submission has no such spans.
pub(crate) fn send_spans(
    traces: &Traces,
    answer: &v1::SubmitResponse,
    begun: SpanTime,
    uploaded: SpanTime,
) {
    let job = answer.job.as_ref().filter(|_| !answer.existing);
    // A coordinator that does not send traces does not return a trace id.
    let Some((job, trace)) = job.and_then(|job| Some((job.id, TraceId::of_bytes(&job.trace)?)))
    else {
        return;
    };
    let submit = traces.fresh_id();
    let span = |name| Span::new(trace, name, begun).number("sightline.job", job);
    traces.send(span("upload").below(submit).end_at(uploaded));
    traces.send(span("submit").known_as(submit).below(trace.job()).end());
}

/// The expected cost of a job.
///
/// ```no_run
/// use sightline::{Client, Endpoint, JobOptions, LoadOptions, SceneSource, Silent, Submission};
///
/// let source = SceneSource::File("level.glb".into());
/// let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
/// let job = JobOptions::default().resolve(&scene, &Silent)?;
/// let client = Client::new(Endpoint::new("http://127.0.0.1:7600"))?;
/// let estimate = client.estimate(&scene, &job, &Submission::default(), &Silent)?;
/// println!("{} bytes are to be uploaded", estimate.upload_bytes);
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The number of bytes of the scene that the coordinator lacks.
    pub upload_bytes: u64,
    /// The message of the coordinator.
    pub message: v1::EstimateResponse,
}

/// Estimates the cost of a request about a scene.
pub(crate) async fn estimate(
    client: &mut JobsClient<Connection>,
    scene: &Scene,
    request: v1::SubmitRequest,
) -> Result<Estimate, Error> {
    let blob = Blob::new(scene.to_blob());
    let upload_bytes = blob.upload_bytes(client).await;
    let upload_bytes = upload_bytes.map_err(|s| Error::status(&s))?;
    let message = client.estimate(request).await;
    Ok(Estimate {
        upload_bytes,
        message: message.map_err(|s| Error::status(&s))?.into_inner(),
    })
}
