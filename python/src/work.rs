//! Functions that bake, plan, measure and check in this process. Options and answers are JSON text.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use serde::Deserialize;
use serde_json::Value;
use sightline::{
    CellsByCost, JobOptions, LoadOptions, Local, MeasureOptions, NamedResult, TracerSearch,
    VerifyOptions, read_scene, tiles,
};

use crate::errors::parse;
use crate::mesh;
use crate::pvs::Pvs;
use crate::runner::wait;

/// The name of a result in messages.
const RESULT: &str = "result";

/// The options of a bake.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BakeOptions {
    scene: LoadOptions,
    job: Value,
    #[serde(default)]
    local: Local,
}

/// Bakes a scene, and writes a file if the options name one. Returns the result.
#[pyfunction]
pub fn bake(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    options: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Pvs> {
    let source = mesh::source(scene)?;
    let BakeOptions { scene, job, local } = parse(options)?;
    wait(py, progress.as_ref(), |observer| {
        let options = JobOptions::from_json(&job)?;
        let search = TracerSearch::begin(options.backend.unwrap_or_default());
        let scene = read_scene(&source, &scene, observer)?;
        let job = options.resolve(&scene, observer);
        let job = job.map_err(|e| e.naming_scene(source.path()))?;
        sightline::bake_after(search, &scene, &job, &local, observer).map(|baked| baked.pvs)
    })
    .map(Pvs)
}

/// Writes the plan of a bake to a folder. Returns the plan's description.
#[pyfunction]
pub fn plan(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    folder: &str,
    options: &str,
) -> PyResult<String> {
    let source = mesh::source(scene)?;
    let BakeOptions { scene, job, .. } = parse(options)?;
    let planned = wait(py, None, |observer| {
        let options = JobOptions::from_json(&job)?;
        let scene = read_scene(&source, &scene, observer)?;
        let job = options.resolve(&scene, observer);
        let job = job.map_err(|e| e.naming_scene(source.path()))?;
        tiles::plan(&scene, &job, folder, observer)
    })?;
    Ok(serde_json::json!(planned).to_string())
}

/// Computes a tile of a plan. Returns the tile's description.
#[pyfunction]
pub fn tile(
    py: Python<'_>,
    folder: &str,
    number: u32,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let tile = wait(py, progress.as_ref(), |observer| {
        tiles::run_tile(folder, tiles::TileIndex(number), observer)
    })?;
    Ok(serde_json::json!(tile).to_string())
}

/// Joins the tiles of a plan to a result file.
#[pyfunction]
pub fn assemble(py: Python<'_>, folder: &str, output: PathBuf) -> PyResult<()> {
    wait(py, None, |_| tiles::assemble(folder, &output).map(drop))
}

/// Measures a result. Returns the document of `sightline measure`.
#[pyfunction]
pub fn measure(
    py: Python<'_>,
    pvs: &Bound<'_, Pvs>,
    scene: &Bound<'_, PyAny>,
    options: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let (source, pvs) = (mesh::source(scene)?, pvs.get());
    let options: MeasureOptions = parse(options)?;
    let result = NamedResult::new(&pvs.0, Path::new(RESULT));
    let report = wait(py, progress.as_ref(), |observer| {
        sightline::measure(&source, result, &options, observer)
    })?;
    Ok(serde_json::json!(report).to_string())
}

/// Returns the choice of cells by cost in a JSON object of options.
fn choice(options: &str) -> Result<CellsByCost, sightline::Error> {
    let value: Value = serde_json::from_str(options).map_err(sightline::Error::internal)?;
    let options = JobOptions::from_json(&value)?.by_cost;
    options
        .choice()?
        .ok_or_else(|| sightline::Error::usage("give cell_budget or byte_budget"))
}

/// Finds cells by cost in a result. Returns the document of `sightline cells --json`.
#[pyfunction]
pub fn cells(py: Python<'_>, pvs: &Bound<'_, Pvs>, options: &str) -> PyResult<String> {
    let pvs = pvs.get();
    let result = NamedResult::new(&pvs.0, Path::new(RESULT));
    let found = wait(py, None, |observer| {
        let choice = choice(options)?;
        sightline::cell_divisions(result, choice.budget(), choice.cost(), observer)
    })?;
    Ok(serde_json::json!(found).to_string())
}

/// Writes the result of cells by cost of a fine result.
#[pyfunction]
pub fn unite(
    py: Python<'_>,
    pvs: &Bound<'_, Pvs>,
    output: PathBuf,
    options: &str,
    viewpoints: Option<PathBuf>,
) -> PyResult<()> {
    let pvs = pvs.get();
    let result = NamedResult::new(&pvs.0, Path::new(RESULT));
    wait(py, None, |observer| {
        let choice = choice(options)?;
        sightline::unite_cells(result, &choice, viewpoints.as_deref(), &output, observer).map(drop)
    })
}

/// Verifies a result. Returns the document of `sightline verify --json`.
#[pyfunction]
pub fn verify(
    py: Python<'_>,
    pvs: &Bound<'_, Pvs>,
    scene: &Bound<'_, PyAny>,
    options: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let (source, pvs) = (mesh::source(scene)?, pvs.get());
    let options: VerifyOptions = parse(options)?;
    let result = NamedResult::new(&pvs.0, Path::new(RESULT));
    let verdict = wait(py, progress.as_ref(), |observer| {
        sightline::verify(&source, result, &options, observer)
    })?;
    Ok(serde_json::json!(verdict).to_string())
}
