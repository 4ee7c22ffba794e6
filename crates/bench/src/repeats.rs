//! One point: the same bake, from an empty store, as many times as asked.

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
use crate::timing::{Times, Took};

/// The runs of a point.
pub struct Runs {
    /// What each printed.
    pub documents: Vec<Value>,
    /// What they took.
    pub times: Times,
    /// Where the first result is.
    folder: TempDir,
}

impl Runs {
    /// What the first printed. All results of sampling are the same; time budgets may differ.
    pub fn first(&self) -> &Value {
        self.documents.first().unwrap_or(&Value::Null)
    }

    /// The result of the first.
    pub fn result(&self) -> PathBuf {
        self.folder.path().join("out.pvs")
    }
}

/// Bakes `scene` with `flags`, `--repeat` times one after the other. `name` is what a warning calls it.
pub fn bake(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    scene: &Path,
    flags: &[OsString],
    name: &str,
) -> Result<Runs, BenchError> {
    let mut first = None;
    let (mut documents, mut took) = (Vec::new(), Vec::<Took>::new());
    for _ in 0..args.repeat.max(1) {
        let folder = tempfile::tempdir().map_err(BenchError::internal)?;
        let mut line = bake_line(scene, folder.path());
        line.extend_from_slice(flags);
        let (document, run) = children.run(line)?;
        documents.push(document);
        took.push(run);
        first.get_or_insert(folder);
    }
    let folder = first.ok_or_else(|| BenchError::Internal("nothing was run".to_owned()))?;
    let times = Times::of(&took);
    if times.load.is_busy() {
        (host.say)(&format!(
            "warning: {name}: other processes took {} of all cores meanwhile, so its time is too long; CPU \
             seconds suffer less, and --repeat shows how much",
            percent(times.others_share.unwrap_or(0.0))
        ));
    }
    Ok(Runs {
        documents,
        times,
        folder,
    })
}
