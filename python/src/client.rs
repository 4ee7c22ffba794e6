//! The client of a coordinator. Options and jobs are JSON text.

use std::path::PathBuf;

use pyo3::prelude::*;
use serde::Deserialize;
use serde_json::Value;
use sightline::{
    CredentialFiles, Endpoint, JobAction, JobFilter, JobOptions, LoadOptions, Submission,
    TraceOptions, process, read_scene,
};

use crate::errors::{OptionError, from_library, parse};
use crate::mesh;
use crate::runner::wait;

/// A client of a coordinator, which connects for each call.
#[pyclass(frozen, module = "sightline._sightline")]
pub struct Client(sightline::Client);

/// The options of a submission.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SubmitOptions {
    scene: LoadOptions,
    job: Value,
    submission: Submission,
    #[serde(default)]
    traces: TraceOptions,
}

#[pymethods]
impl Client {
    #[new]
    fn new(url: &str, credentials: &str) -> PyResult<Self> {
        let files: CredentialFiles = parse(credentials)?;
        let credentials = files.read().map_err(from_library)?;
        let endpoint = Endpoint::new(url).with_credentials(credentials);
        sightline::Client::new(endpoint)
            .map(Self)
            .map_err(from_library)
    }

    fn submit(
        &self,
        py: Python<'_>,
        scene: &Bound<'_, PyAny>,
        options: &str,
    ) -> PyResult<(String, bool)> {
        let source = mesh::source(scene)?;
        let options: SubmitOptions = parse(options)?;
        wait(py, None, |observer| {
            let job = JobOptions::from_json(&options.job)?;
            let scene = read_scene(&source, &options.scene, observer)?;
            let job = job.resolve(&scene, observer);
            let job = job.map_err(|e| e.naming_scene(source.path()))?;
            let name = process::default_name()?;
            let traces = options.traces.start("sightline-submit", &name)?;
            let _flush_guard = traces.flush_guard();
            let (client, submission) = (&self.0, &options.submission);
            let handle = client.submit_traced(&scene, &job, submission, &traces, observer)?;
            Ok((handle.job().to_json().to_string(), handle.is_existing()))
        })
    }

    fn jobs(
        &self,
        py: Python<'_>,
        limit: Option<u32>,
        before: Option<u64>,
    ) -> PyResult<Vec<String>> {
        let filter = JobFilter {
            limit: Some(limit.unwrap_or(100)),
            before,
            ..JobFilter::default()
        };
        let list = wait(py, None, |observer| self.0.jobs(&filter, observer))?;
        let text = |job: &sightline::Job| job.to_json().to_string();
        Ok(list.jobs.iter().map(text).collect())
    }

    fn show(&self, py: Python<'_>, job: u64) -> PyResult<String> {
        wait(py, None, |observer| {
            let handle = self.0.job(job, observer)?;
            Ok(handle.job().to_json().to_string())
        })
    }

    fn wait(&self, py: Python<'_>, job: u64, progress: Option<Py<PyAny>>) -> PyResult<String> {
        wait(py, progress.as_ref(), |observer| {
            let mut handle = self.0.job(job, observer)?;
            let ended = handle.wait(observer)?;
            ended.ensure_done()?;
            Ok(ended.to_json().to_string())
        })
    }

    fn act(&self, py: Python<'_>, job: u64, action: &str) -> PyResult<String> {
        let action = match action {
            "cancel" => JobAction::Cancel,
            "pause" => JobAction::Pause { now: false },
            "resume" => JobAction::Resume,
            "retry" => JobAction::Retry,
            other => {
                return Err(OptionError::new_err(format!(
                    "a job has no action {other:?}; give cancel, pause, resume or retry"
                )));
            }
        };
        wait(py, None, |observer| self.0.act(job, action, observer))
            .map(|job| job.to_json().to_string())
    }

    fn prioritize(&self, py: Python<'_>, job: u64, priority: i32) -> PyResult<String> {
        wait(py, None, |observer| {
            self.0.prioritize(job, priority, observer)
        })
        .map(|job| job.to_json().to_string())
    }

    fn fetch(&self, py: Python<'_>, job: u64, output: PathBuf) -> PyResult<u64> {
        wait(py, None, |observer| self.0.fetch(job, &output, observer))
    }
}
