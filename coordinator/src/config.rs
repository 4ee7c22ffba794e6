//! The settings of a coordinator.

use std::path::{Path, PathBuf};
use std::time::Duration;

use sightline_store::{BlobError, BlobPlace, Blobs, FileBlobs, ObjectBlobs};

use crate::jobs::retention_clock::Ages;
use crate::quota::Quotas;

/// The time limits of leases, and the share of checked tiles.
#[derive(Clone, Copy, Debug)]
pub struct Leases {
    /// The duration after which a lease that is not renewed ends. Default: 10 s.
    pub ttl: Duration,
    /// The duration without progress of a tile after which its lease is revoked. Default: 10 min.
    pub stuck: Duration,
    /// The fraction of the tiles that a second worker computes again for comparison, 0 to 1. Default: 0.
    pub spot_check: f64,
}

impl Default for Leases {
    fn default() -> Self {
        Self {
            ttl: Duration::from_secs(10),
            stuck: Duration::from_secs(600),
            spot_check: 0.0,
        }
    }
}

/// The durations for which the coordinator keeps data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// The age at which ended jobs and their results are deleted, and then scenes without jobs. `None` keeps
    /// them.
    pub keep: Option<Duration>,
    /// The maximum size of results and scenes, in bytes. Above it, ended jobs are deleted, the lowest number
    /// first. `None` sets no limit.
    pub keep_bytes: Option<u64>,
    /// The age at which a blob without references is removed.
    pub grace: Duration,
}

impl Default for Retention {
    fn default() -> Self {
        // An interrupted client can continue its upload on the next day.
        Self {
            keep: None,
            keep_bytes: None,
            grace: Duration::from_secs(24 * 3600),
        }
    }
}

/// The settings of a coordinator on one machine's disk.
#[derive(Clone, Debug)]
pub struct Config {
    /// The directory of the store (`state/`) and of the blobs (`blobs/`).
    pub data_dir: PathBuf,
    /// The time limits of leases, and the share of checked tiles.
    pub leases: Leases,
    /// The quotas and rate limits of users.
    pub quotas: Quotas,
    /// The durations for which data is kept.
    pub retention: Retention,
    /// The location of the blobs. `None` selects `blobs/` in the data directory.
    pub blobs: Option<BlobPlace>,
}

impl Config {
    /// Creates the default settings with this data directory.
    pub fn new(data_dir: PathBuf) -> Self {
        let (leases, quotas, retention) =
            (Leases::default(), Quotas::default(), Retention::default());
        Self {
            data_dir,
            leases,
            quotas,
            retention,
            blobs: None,
        }
    }

    /// Opens the blob store for reading and writing. `shared` is the name under which this process writes to
    /// a directory that other processes use, too.
    ///
    /// # Errors
    /// [`BlobError`] if the location cannot be used.
    pub fn open_blobs(&self, shared: Option<&str>) -> Result<Box<dyn Blobs>, BlobError> {
        let in_files = |directory: &Path| match shared {
            None => FileBlobs::open(directory),
            Some(name) => FileBlobs::open_shared(directory, name),
        };
        Ok(match &self.blobs {
            None => Box::new(in_files(&self.data_dir.join("blobs"))?),
            Some(BlobPlace::Directory(directory)) => Box::new(in_files(directory)?),
            Some(BlobPlace::Bucket(place)) => {
                Box::new(ObjectBlobs::open(place, &self.data_dir.join("copies"))?)
            }
        })
    }

    /// Opens the blob store for reading only. Copies of a bucket's objects are stored in the folder `copies`.
    ///
    /// # Errors
    /// [`BlobError`] if the location cannot be used.
    pub fn inspect_blobs(&self, copies: &Path) -> Result<Box<dyn Blobs>, BlobError> {
        Ok(match &self.blobs {
            None => Box::new(FileBlobs::inspect(&self.data_dir.join("blobs"))?),
            Some(BlobPlace::Directory(directory)) => Box::new(FileBlobs::inspect(directory)?),
            Some(BlobPlace::Bucket(place)) => Box::new(ObjectBlobs::open(place, copies)?),
        })
    }
}

/// The settings of a running coordinator.
#[derive(Clone, Debug, Default)]
pub(crate) struct RunSettings {
    /// The time limits of leases, and the share of checked tiles.
    pub(crate) leases: Leases,
    /// The quotas and rate limits of users.
    pub(crate) quotas: Quotas,
    /// The durations for which data is kept.
    pub(crate) retention: Retention,
    /// The data directory, also if the records and blobs are elsewhere. `None` for a coordinator in memory.
    pub(crate) data_dir: Option<PathBuf>,
}

impl RunSettings {
    /// Returns the ages at which retention deletes jobs and blobs.
    pub(crate) fn ages(&self) -> Ages {
        Ages {
            jobs: self.retention.keep,
            blobs: Some(self.retention.grace),
        }
    }
}
