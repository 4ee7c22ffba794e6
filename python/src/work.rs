//! Baking, measuring and checking in this process. Options are flags of the commands; answers are JSON text.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use serde_json::Value;
use sightline_cli::calls::{self, CliError, Source, Watcher};

use crate::mesh;
use crate::pvs::Pvs;
use crate::waiting::wait;

/// How a result that has no file is called in messages.
const RESULT: &str = "result";

/// Bakes a scene into a file.
#[pyfunction]
pub fn bake(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    output: PathBuf,
    flags: Vec<OsString>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let scene = mesh::source(scene)?;
    let done = wait(py, progress.as_ref(), |watcher| {
        calls::bake(&scene, &output, &flags, watcher)
    })?;
    Ok(done.to_string())
}

/// A command about a result in its scene.
type About =
    fn(&Source, (&sightline_pvs::Pvs, &Path), &[OsString], &dyn Watcher) -> Result<Value, CliError>;

fn about(
    py: Python<'_>,
    command: About,
    (pvs, scene): (&Bound<'_, Pvs>, &Bound<'_, PyAny>),
    flags: &[OsString],
    progress: Option<&Py<PyAny>>,
) -> PyResult<String> {
    let (scene, pvs) = (mesh::source(scene)?, pvs.get());
    let of = (&pvs.0, Path::new(RESULT));
    let done = wait(py, progress, |watcher| command(&scene, of, flags, watcher))?;
    Ok(done.to_string())
}

/// Measures a result.
#[pyfunction]
pub fn measure(
    py: Python<'_>,
    pvs: &Bound<'_, Pvs>,
    scene: &Bound<'_, PyAny>,
    flags: Vec<OsString>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    about(py, calls::measure, (pvs, scene), &flags, progress.as_ref())
}

/// Checks a result.
#[pyfunction]
pub fn verify(
    py: Python<'_>,
    pvs: &Bound<'_, Pvs>,
    scene: &Bound<'_, PyAny>,
    flags: Vec<OsString>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    about(py, calls::verify, (pvs, scene), &flags, progress.as_ref())
}
