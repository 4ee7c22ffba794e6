//! One point: the same bake, from an empty store, repeated as often as the options state.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::children::Children;
use crate::error::BenchError;
use crate::host::Host;
use crate::input::bake_line;
use crate::options::Options;
use crate::percent::percent;
use crate::timing::{RunCost, Times};

/// The runs of a point.
pub struct Runs {
    /// The JSON that each run printed.
    pub documents: Vec<Value>,
    /// The times of the runs.
    pub times: Times,
    /// The folder with the first result.
    folder: TempDir,
}

impl Runs {
    /// Returns the JSON of the first run. All results of sampling are equal; results of time budgets may
    /// differ.
    pub fn first(&self) -> &Value {
        self.documents.first().unwrap_or(&Value::Null)
    }

    /// Returns the path of the first run's result.
    pub fn result(&self) -> PathBuf {
        self.folder.path().join("out.pvs")
    }
}

/// Bakes `scene` with `flags`, `--repeat` times one after the other. `name` is the name of the point in
/// warnings.
pub fn bake(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    scene: &Path,
    flags: &[OsString],
    name: &str,
) -> Result<Runs, BenchError> {
    let mut first = None;
    let (mut documents, mut took) = (Vec::new(), Vec::<RunCost>::new());
    for _ in 0..args.repeat.max(1) {
        let folder = tempfile::tempdir().map_err(BenchError::internal)?;
        let mut line = bake_line(scene, folder.path());
        line.extend_from_slice(flags);
        let (document, run) = children.run(line)?;
        documents.push(document);
        took.push(run);
        first.get_or_insert(folder);
    }
    let folder = first
        .ok_or_else(|| BenchError::Internal("the benchmark made no run of a point".to_owned()))?;
    let times = Times::from_runs(&took);
    if times.load.is_busy() {
        (host.say)(&format!(
            "warning: {name}: other processes used {} of all cores during the bake, so its time is \
             too long; CPU seconds are less affected, and --repeat shows the spread",
            percent(times.others_share.unwrap_or(0.0))
        ));
    }
    Ok(Runs {
        documents,
        times,
        folder,
    })
}
