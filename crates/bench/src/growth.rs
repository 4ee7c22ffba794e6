//! The growth of time and memory with triangles, cells and workers, one at a time.

use std::ffi::OsString;
use std::path::Path;

use serde::Serialize;

use crate::children::{Children, number};
use crate::error::BenchError;
use crate::frontier::seconds;
use crate::host::Host;
use crate::input::Input;
use crate::ladder::Ladder;
use crate::options::{Growth, Options};
use crate::repeats;
use crate::timing::Times;

/// Returns the sampling flags of all bakes of a growth.
pub fn sampling(args: &Options) -> [String; 4] {
    [
        "--sampler",
        "lines",
        "--target-error",
        &args.grow_error.to_string(),
    ]
    .map(str::to_owned)
}

/// The measurements of one bake of a growth.
#[derive(Clone, Debug, Serialize)]
pub struct Grown {
    /// The quantity that grows from row to row.
    pub grows: Growth,
    /// The name of the scene in tables.
    pub scene: String,
    /// The number of triangles of the scene.
    pub triangles: f64,
    /// The number of cells of the result.
    pub cells: f64,
    /// The number of workers; `None` means one per core.
    pub workers: Option<u32>,
    /// The times of the whole command, from start to exit.
    #[serde(flatten)]
    pub times: Times,
    /// The peak memory in megabytes; `None` if the system does not report it.
    pub peak_mb: Option<f64>,
    /// The size of the sets in bytes, per cell.
    pub bytes_per_cell: f64,
}

impl Growth {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Triangles => "triangles",
            Self::Cells => "cells",
            Self::Workers => "workers",
        }
    }

    /// Returns the values of the growing quantity, ascending.
    fn values(self, ladder: Ladder) -> &'static [u32] {
        match (self, ladder) {
            (Self::Triangles, Ladder::Quick) => &[10_000, 100_000, 1_000_000],
            (Self::Triangles, Ladder::Full) => &[10_000, 100_000, 1_000_000, 10_000_000],
            (Self::Cells, Ladder::Quick) => &[2, 4, 8, 16],
            (Self::Cells, Ladder::Full) => &[2, 4, 8, 16, 32],
            (Self::Workers, _) => &[1, 2, 4],
        }
    }
}

/// Measures one growth, on generated forests for triangles, and on each input scene for cells and workers.
pub fn measure(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    inputs: &[Input],
    grows: Growth,
) -> Result<Vec<Grown>, BenchError> {
    let scenes: Vec<Option<&Input>> = match grows {
        Growth::Triangles => vec![None],
        Growth::Cells | Growth::Workers => inputs.iter().map(Some).collect(),
    };
    let mut rows = Vec::new();
    for scene in scenes {
        let mut values = grows.values(args.points).iter().peekable();
        while let Some(&value) = values.next() {
            let row = bake(args, host, children, scene, grows, value)?;
            (host.say)(&format!(
                "growth of {}, {} at {value}: {} s",
                grows.name(),
                row.scene,
                seconds(row.times.seconds)
            ));
            let over = row.times.seconds > args.max_seconds;
            rows.push(row);
            // A bake with more workers should not need more time, so continue.
            if over && grows != Growth::Workers && values.peek().is_some() {
                (host.say)(&format!(
                    "growth of {}: larger points are skipped, because this point took more than {} \
                     s (--max-seconds)",
                    grows.name(),
                    args.max_seconds
                ));
                break;
            }
        }
    }
    Ok(rows)
}

fn bake(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    scene: Option<&Input>,
    grows: Growth,
    value: u32,
) -> Result<Grown, BenchError> {
    let folder = tempfile::tempdir().map_err(BenchError::internal)?;
    let (name, path) = match scene {
        Some(input) => (input.name.clone(), input.path.clone()),
        None => ("forest".to_owned(), forest(children, folder.path(), value)?),
    };
    let mut flags: Vec<_> = sampling(args).map(OsString::from).to_vec();
    let cells = if grows == Growth::Cells {
        [value; 3]
    } else {
        args.cells
    };
    let division = match scene {
        Some(_) => args.division(cells),
        // The view box option applies to the given scenes, not to the forest.
        None => Options::grid(cells).to_vec(),
    };
    flags.extend(division.into_iter().map(OsString::from));
    let workers = (grows == Growth::Workers).then_some(value);
    flags.extend(
        workers
            .into_iter()
            .flat_map(|w| [OsString::from("--workers"), w.to_string().into()]),
    );
    let called = format!("growth of {}, {name} at {value}", grows.name());
    let runs = repeats::bake(args, host, children, &path, &flags, &called)?;
    let baked = runs.first();
    Ok(Grown {
        grows,
        scene: name,
        triangles: number(baked, "triangles")?,
        cells: number(baked, "cells")?,
        workers,
        peak_mb: baked["peak_memory_bytes"].as_f64().map(|b| b / 1e6),
        bytes_per_cell: number(baked, "bytes_per_cell")?,
        times: runs.times,
    })
}

fn forest(
    children: &Children,
    folder: &Path,
    triangles: u32,
) -> Result<std::path::PathBuf, BenchError> {
    let path = folder.join("forest.glb");
    let words = ["generate", "forest", "--triangles"].map(OsString::from);
    let rest = [
        triangles.to_string().into(),
        "-o".into(),
        path.clone().into(),
    ];
    children.run(words.into_iter().chain(rest))?;
    Ok(path)
}
