//! The client of a coordinator. Jobs are JSON text.

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;
use sightline_cli::calls::{self, Turn};

use crate::errors::{OptionError, of_command};
use crate::mesh;
use crate::waiting::wait;

/// A coordinator's client; it connects anew for each call.
#[pyclass(frozen, module = "sightline._sightline")]
pub struct Client(calls::Client);

#[pymethods]
impl Client {
    #[new]
    fn new(flags: Vec<OsString>) -> PyResult<Self> {
        calls::Client::new(flags).map(Self).map_err(of_command)
    }

    fn submit(
        &self,
        py: Python<'_>,
        scene: &Bound<'_, PyAny>,
        flags: Vec<OsString>,
    ) -> PyResult<(String, bool)> {
        let scene = mesh::source(scene)?;
        let (job, existing) = wait(py, None, |watcher| self.0.submit(&scene, &flags, watcher))?;
        Ok((job.to_string(), existing))
    }

    fn jobs(&self, py: Python<'_>, flags: Vec<OsString>) -> PyResult<Vec<String>> {
        let jobs = wait(py, None, |watcher| self.0.jobs(&flags, watcher))?;
        Ok(jobs.iter().map(ToString::to_string).collect())
    }

    fn show(&self, py: Python<'_>, job: u64) -> PyResult<String> {
        wait(py, None, |watcher| self.0.show(job, watcher)).map(|job| job.to_string())
    }

    fn wait(&self, py: Python<'_>, job: u64, progress: Option<Py<PyAny>>) -> PyResult<String> {
        wait(py, progress.as_ref(), |watcher| self.0.wait(job, watcher)).map(|job| job.to_string())
    }

    fn turn(&self, py: Python<'_>, job: u64, turn: &str) -> PyResult<String> {
        let turn = match turn {
            "cancel" => Turn::Cancel,
            "pause" => Turn::Pause { now: false },
            "resume" => Turn::Resume,
            "retry" => Turn::Retry,
            other => return Err(OptionError::new_err(format!("a job has no {other}"))),
        };
        wait(py, None, |watcher| self.0.turn(job, turn, watcher)).map(|job| job.to_string())
    }

    fn prioritize(&self, py: Python<'_>, job: u64, priority: i32) -> PyResult<String> {
        wait(py, None, |watcher| {
            self.0.prioritize(job, priority, watcher)
        })
        .map(|job| job.to_string())
    }

    fn fetch(&self, py: Python<'_>, job: u64, output: PathBuf) -> PyResult<u64> {
        wait(py, None, |watcher| self.0.fetch(job, &output, watcher))
    }
}
