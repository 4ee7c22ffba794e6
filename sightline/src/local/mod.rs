//! Jobs in this process: a coordinator on loopback, its data directory, and workers. They communicate over
//! gRPC like in a cluster, except that they share the scene in memory.

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
    /// The name of the job, for the event log.
    pub name: String,
    /// The folder for unfinished work and finished results. With it, an interrupted job continues, and a
    /// finished job returns its result immediately. Default: `$XDG_CACHE_HOME/sightline` or
    /// `~/.cache/sightline`.
    pub data_dir: Option<PathBuf>,
    /// The number of workers, 1 to 256. Each worker computes one tile at a time, and all workers share all
    /// cores. Default: one per core.
    pub workers: Option<u16>,
    /// The path of the result file. Default: no file, and the result stays in memory.
    pub output: Option<PathBuf>,
    /// The collector of traces.
    pub traces: TraceOptions,
}

/// Maximum number of workers in a process.
const MOST_WORKERS: u16 = 256;

impl Local {
    /// Checks that the number of workers is in its range.
    fn check(&self) -> Result<(), Error> {
        match self.workers {
            Some(workers) if !(1..=MOST_WORKERS).contains(&workers) => Err(Error::usage(format!(
                "--workers {workers} is out of range; give a number from 1 to {MOST_WORKERS}"
            ))
            .about("workers")),
            Some(_) | None => Ok(()),
        }
    }
}
