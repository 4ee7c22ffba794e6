//! Jobs in this process: a coordinator on loopback, its data directory, and workers. They speak the same gRPC
//! as in a cluster, except that the scene is shared in memory.

mod ambient;
mod bake;
mod coordinator;
mod partition;
mod search;
mod workers;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

pub use self::ambient::ambient;
pub use self::bake::{Baked, bake, bake_after};
pub use self::search::TracerSearch;
use crate::error::Error;
use crate::traces::TraceOptions;

/// The settings of a job in this process.
///
/// ```
/// use sightline::Local;
///
/// let local = Local { workers: Some(2), output: Some("level.pvs".into()), ..Default::default() };
/// assert!(local.data_dir.is_none());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Local {
    /// The name of the job, for the log of events.
    pub name: String,
    /// The folder for unfinished work and finished results. With it, an interrupted job continues, and a
    /// finished one is answered at once. Default: `$XDG_CACHE_HOME/sightline` or `~/.cache/sightline`.
    pub data_dir: Option<PathBuf>,
    /// The number of tiles that are computed at a time, 1 to 256. They share all cores. Default: one per
    /// core.
    pub workers: Option<u16>,
    /// The result file to write. Default: none, the result stays in memory.
    pub output: Option<PathBuf>,
    /// The collector of traces.
    pub traces: TraceOptions,
}

/// The maximum number of workers in a process.
const MOST_WORKERS: u16 = 256;

impl Local {
    /// Checks the number of workers.
    fn check(&self) -> Result<(), Error> {
        match self.workers {
            Some(workers) if !(1..=MOST_WORKERS).contains(&workers) => Err(Error::usage(format!(
                "--workers {workers} is not between 1 and {MOST_WORKERS}"
            ))
            .about("workers")),
            Some(_) | None => Ok(()),
        }
    }
}
