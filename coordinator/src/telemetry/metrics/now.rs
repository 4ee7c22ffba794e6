//! How things stand at the moment somebody asks for the metrics.

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

/// How old the sizes of directories may be: all their files are looked at.
const SIZES_EVERY: Duration = Duration::from_secs(60);

/// How things stand, without what is read from files.
pub(crate) struct FarmReadings {
    /// Whether the coordinator is ready.
    pub(crate) ready: bool,
    /// The jobs that have not ended.
    pub(crate) jobs: Vec<Counts>,
    /// The connected workers.
    pub(crate) members: Vec<WorkerStatus>,
    /// Workers that get no tiles because their outputs were wrong.
    pub(crate) quarantined: usize,
    /// Where the data is, if it is in files.
    pub(crate) data_dir: Option<PathBuf>,
    /// The bytes that went between the coordinator and an object store, if blobs are in one.
    pub(crate) carried: Option<Carried>,
}

/// What is set to it.
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
        r.register("ready", "1 if /readyz says so", this.ready.clone());
        r.register(
            "jobs",
            "Jobs that have not ended, by state",
            this.jobs.clone(),
        );
        let help =
            "Open tiles: ready to be leased, leased, or waiting for others, a pause or a profile";
        r.register("tiles", help, this.tiles.clone());
        r.register(
            "workers",
            "Connected workers, each under all its profiles",
            this.workers.clone(),
        );
        let help = "Workers that get no tiles because their outputs were wrong";
        r.register("quarantined_workers", help, this.quarantined.clone());
        let help = "Lines and cubes of committed tiles of a worker since it connected";
        r.register("worker_samples", help, this.worker_samples.clone());
        let help = "Size of the journal, of its view, and of blobs, at most a minute old";
        r.register_with_unit("store", help, Unit::Bytes, this.store_bytes.clone());
        let help = "Free space where the data is";
        r.register_with_unit("disk_free", help, Unit::Bytes, this.disk_free.clone());
        let help = "Bytes of blobs between the coordinator and the object store";
        r.register_with_unit("object_store", help, Unit::Bytes, this.carried.clone());
        this
    }

    /// Sets them to what stands now.
    pub(super) fn set(&self, moment: FarmReadings) {
        self.ready.set(i64::from(moment.ready));
        self.quarantined.set(moment.quarantined as i64);
        self.set_jobs(moment.jobs);
        // Who has gone is not listed.
        self.workers.clear();
        self.worker_samples.clear();
        for member in moment.members {
            for profile in member.profiles {
                self.workers.get_or_create(&[("profile", profile)]).inc();
            }
            let samples = self
                .worker_samples
                .get_or_create_owned(&[("worker", member.name)]);
            samples.inc_by(member.done.samples);
        }
        self.carried.clear();
        if let Some(Carried { read, written }) = moment.carried {
            for (direction, bytes) in [("in", read), ("out", written)] {
                self.carried
                    .get_or_create_owned(&[("direction", direction.to_owned())])
                    .inc_by(bytes);
            }
        }
        if let Some(place) = &moment.data_dir {
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
