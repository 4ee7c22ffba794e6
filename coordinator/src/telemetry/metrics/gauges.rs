//! Gauges: readings of the coordinator's current state at each request for metrics.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};
use sightline_scheduler::{Counts, WorkerStatus};
use sightline_store::Carried;

use super::Labels;
use super::disk::{bytes_below, free_bytes};

/// Maximum age of the sizes of directories, because the measurement inspects all files.
const SIZES_EVERY: Duration = Duration::from_secs(60);

/// The current state of the farm, without values that are read from files.
pub(crate) struct FarmReadings {
    /// True if the coordinator is ready.
    pub(crate) ready: bool,
    /// The jobs that have not ended.
    pub(crate) jobs: Vec<Counts>,
    /// The connected workers.
    pub(crate) members: Vec<WorkerStatus>,
    /// The number of quarantined workers, which receive no tiles because their outputs were wrong.
    pub(crate) quarantined: usize,
    /// The data directory. `None` if the data is not in files.
    pub(crate) data_dir: Option<PathBuf>,
    /// The bytes transferred between the coordinator and an object store, if blobs are in one.
    pub(crate) carried: Option<Carried>,
}

/// The gauges, which `set` updates.
pub(super) struct Gauges {
    ready: Gauge,
    jobs: Family<Labels<1>, Gauge>,
    tiles: Family<Labels<2>, Gauge>,
    workers: Family<Labels<1>, Gauge>,
    quarantined: Gauge,
    worker_samples: Family<Labels<1>, Counter>,
    store_bytes: Family<Labels<1>, Gauge>,
    disk_free: Gauge,
    carried: Family<Labels<1>, Counter>,
    sized: Mutex<Option<Instant>>,
}

impl Gauges {
    pub(super) fn register(r: &mut Registry) -> Self {
        let this = Self {
            ready: Gauge::default(),
            jobs: Family::default(),
            tiles: Family::default(),
            workers: Family::default(),
            quarantined: Gauge::default(),
            worker_samples: Family::default(),
            store_bytes: Family::default(),
            disk_free: Gauge::default(),
            carried: Family::default(),
            sized: Mutex::new(None),
        };
        r.register(
            "ready",
            "1 if /readyz reports that the process is ready",
            this.ready.clone(),
        );
        r.register(
            "jobs",
            "Jobs that have not ended, by state",
            this.jobs.clone(),
        );
        let help = "Open tiles: ready to be leased, leased, or waiting for other tiles, a pause or a profile";
        r.register("tiles", help, this.tiles.clone());
        r.register(
            "workers",
            "Connected workers, each under all its profiles",
            this.workers.clone(),
        );
        let help = "Quarantined workers, which get no tiles because their outputs were wrong";
        r.register("quarantined_workers", help, this.quarantined.clone());
        let help = "Samples (sight lines or cubes) of committed tiles of a worker since the worker connected";
        r.register("worker_samples", help, this.worker_samples.clone());
        let help =
            "Size of the journal, its view, blobs and outcomes of phases, at most a minute old";
        r.register_with_unit("store", help, Unit::Bytes, this.store_bytes.clone());
        let help = "Free space on the disk of the data directory";
        r.register_with_unit("disk_free", help, Unit::Bytes, this.disk_free.clone());
        let help = "Bytes of blobs sent between the coordinator and the object store";
        r.register_with_unit("object_store", help, Unit::Bytes, this.carried.clone());
        this
    }

    /// Sets the gauges to the current state.
    pub(super) fn set(&self, readings: FarmReadings) {
        self.ready.set(i64::from(readings.ready));
        self.quarantined.set(readings.quarantined as i64);
        self.set_jobs(readings.jobs);
        // Workers that have left must not be listed.
        self.workers.clear();
        self.worker_samples.clear();
        for member in readings.members {
            for profile in member.profiles {
                self.workers.get_or_create(&[("profile", profile)]).inc();
            }
            let samples = self
                .worker_samples
                .get_or_create_owned(&[("worker", member.name)]);
            samples.inc_by(member.done.samples);
        }
        self.carried.clear();
        if let Some(Carried { read, written }) = readings.carried {
            for (direction, bytes) in [("in", read), ("out", written)] {
                self.carried
                    .get_or_create_owned(&[("direction", direction.to_owned())])
                    .inc_by(bytes);
            }
        }
        if let Some(place) = &readings.data_dir {
            if let Some(free) = free_bytes(place) {
                self.disk_free.set(free.min(i64::MAX as u64) as i64);
            }
            self.set_sizes(place);
        }
    }

    fn set_jobs(&self, jobs: Vec<Counts>) {
        let mut states = BTreeMap::from([("queued", 0), ("running", 0), ("paused", 0)]);
        let mut tiles: BTreeMap<(String, &str), i64> = BTreeMap::new();
        for job in jobs {
            *states.entry(job.state).or_default() += 1;
            for (state, count) in [
                ("ready", job.ready),
                ("leased", job.leased),
                ("waiting", job.waiting),
            ] {
                *tiles.entry((job.profile.clone(), state)).or_default() += i64::from(count);
            }
        }
        for (state, count) in states {
            self.jobs
                .get_or_create(&[("state", state.to_owned())])
                .set(count);
        }
        self.tiles.clear();
        for ((profile, state), count) in tiles {
            self.tiles
                .get_or_create(&[("state", state.to_owned()), ("profile", profile)])
                .set(count);
        }
    }

    fn set_sizes(&self, place: &Path) {
        let mut sized = self.sized.lock().unwrap_or_else(PoisonError::into_inner);
        if sized.is_some_and(|at| at.elapsed() < SIZES_EVERY) {
            return;
        }
        let parts = [
            ("journal", "state/journal"),
            ("view", "state/sled"),
            ("blobs", "blobs"),
            ("crews", "crews"),
        ];
        for (part, path) in parts {
            let bytes = bytes_below(&place.join(path)).min(i64::MAX as u64) as i64;
            self.store_bytes
                .get_or_create(&[("part", part.to_owned())])
                .set(bytes);
        }
        *sized = Some(Instant::now());
    }
}
