//! The metrics of the coordinator, for Prometheus. `docs/operations.md` lists the names, and a test compares
//! the list.
//!
//! Events update counters and histograms. Gauges are read from the scheduler and the disk at each request
//! (`gauges.rs`). Metrics do not affect the behaviour of the coordinator.

mod disk;
mod gauges;
#[cfg(test)]
mod tests;

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

pub(crate) use self::disk::free_bytes;
pub(crate) use self::gauges::FarmReadings;
use self::gauges::Gauges;

/// Labels with their values.
type Labels<const N: usize> = [(&'static str, String); N];
/// Counters by one label.
type Counters = Family<Labels<1>, Counter>;
/// Histograms by one label.
type Histograms = Family<Labels<1>, Histogram, fn() -> Histogram>;

/// Upper bounds of the histogram buckets for requests, phases and disk writes, in seconds.
const SHORT: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 60.0];
/// Upper bounds of the histogram buckets for tiles, in seconds.
const LONG: [f64; 10] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3600.0];

fn short() -> Histogram {
    Histogram::new(SHORT)
}

fn long() -> Histogram {
    Histogram::new(LONG)
}

/// All metrics of a coordinator.
pub(crate) struct Metrics {
    registry: Mutex<Registry>,
    gauges: Gauges,
    tile_seconds: Histograms,
    samples: Counters,
    jobs_ended: Counters,
    transferred: Counters,
    cache_requests: Family<Labels<2>, Counter>,
    commit_seconds: Histogram,
    sync_seconds: Histogram,
    set_aside: Counter,
    conflicts: Counter,
    taken_back: Counter,
    deaths: Counter,
    phases: Counter,
    phase_seconds: Histograms,
    spot_checks: Counters,
    requests: Family<Labels<2>, Counter>,
    request_seconds: Histograms,
    refused: Counters,
    addresses: Counters,
    direct_bytes: Counters,
    fallbacks: Counters,
}

/// The outcome of a cache request.
#[derive(Clone, Copy)]
pub(crate) enum CacheOutcome {
    Hit,
    Miss,
}

/// Registers the gauge that states if this coordinator leads.
fn lead(registry: &mut Registry, is: i64) {
    let leader: Gauge = Gauge::default();
    leader.set(is);
    registry.register(
        "leader",
        "1 if this coordinator leads, 0 if it is a standby",
        leader,
    );
}

/// Returns the metrics of a standby.
pub(crate) fn standby_metrics() -> Result<String, std::fmt::Error> {
    let mut registry = Registry::with_prefix("sightline");
    registry.register(
        "build",
        "The version of the program",
        Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]),
    );
    lead(&mut registry, 0);
    let ready: Gauge = Gauge::default();
    ready.set(1);
    registry.register(
        "ready",
        "1 if /readyz reports that the process is ready",
        ready,
    );
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("sightline");
        let build = Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]);
        registry.register("build", "The version of the program", build);
        lead(&mut registry, 1);
        let this = Self {
            gauges: Gauges::register(&mut registry),
            registry: Mutex::default(),
            tile_seconds: Family::new_with_constructor(long),
            samples: Family::default(),
            jobs_ended: Family::default(),
            transferred: Family::default(),
            cache_requests: Family::default(),
            commit_seconds: short(),
            sync_seconds: short(),
            set_aside: Counter::default(),
            conflicts: Counter::default(),
            taken_back: Counter::default(),
            deaths: Counter::default(),
            phases: Counter::default(),
            phase_seconds: Family::new_with_constructor(short),
            spot_checks: Family::default(),
            requests: Family::default(),
            request_seconds: Family::new_with_constructor(short),
            refused: Family::default(),
            addresses: Family::default(),
            direct_bytes: Family::default(),
            fallbacks: Family::default(),
        };
        let r = &mut registry;
        let seconds = || Unit::Seconds;
        r.register_with_unit(
            "tile",
            "Time that a worker spent on a tile that was committed",
            seconds(),
            this.tile_seconds.clone(),
        );
        r.register(
            "samples",
            "Samples (sight lines or cubes) of committed tiles",
            this.samples.clone(),
        );
        r.register(
            "jobs_ended",
            "Ended jobs, by their final state",
            this.jobs_ended.clone(),
        );
        let help = "Bytes of the bodies of gRPC calls";
        r.register_with_unit("transferred", help, Unit::Bytes, this.transferred.clone());
        r.register(
            "cache_requests",
            "Requests to the caches in memory, by cache and outcome",
            this.cache_requests.clone(),
        );
        let help = "Time from the arrival of a tile's output to its acknowledgement";
        r.register_with_unit("commit", help, seconds(), this.commit_seconds.clone());
        let help =
            "Time of a durable write of the store, which commands that arrive together share";
        r.register_with_unit("sync", help, seconds(), this.sync_seconds.clone());
        r.register(
            "tiles_set_aside",
            "Tiles that were set aside after too many failures",
            this.set_aside.clone(),
        );
        r.register(
            "tile_conflicts",
            "Outputs that differ from the stored output of their tile",
            this.conflicts.clone(),
        );
        r.register(
            "worker_deaths",
            "Workers whose connection ended while they computed a tile",
            this.deaths.clone(),
        );
        r.register(
            "leases_taken_back",
            "Leases that ended before their tile was done",
            this.taken_back.clone(),
        );
        r.register(
            "phases",
            "Phases of blocks that crews have finished",
            this.phases.clone(),
        );
        let help = "Time in which the leader of a crew finished a phase";
        r.register_with_unit("phase", help, seconds(), this.phase_seconds.clone());
        r.register(
            "spot_checks",
            "Spot checks of tiles, by outcome",
            this.spot_checks.clone(),
        );
        r.register(
            "requests",
            "Ended calls, by method and status code",
            this.requests.clone(),
        );
        let help = "Duration of a call; of a stream, until the stream ends";
        r.register_with_unit("request", help, seconds(), this.request_seconds.clone());
        r.register(
            "refused",
            "Calls and uploads that were rejected because of a limit",
            this.refused.clone(),
        );
        let help = "Signed addresses of the blob store that workers received";
        r.register("direct_addresses", help, this.addresses.clone());
        let help =
            "Bytes of blobs whose addresses workers received, and of outputs written directly";
        r.register_with_unit("direct", help, Unit::Bytes, this.direct_bytes.clone());
        let help = "Blobs that were sent through the coordinator because direct access failed";
        r.register("direct_fallbacks", help, this.fallbacks.clone());
        *this.registry.lock().unwrap_or_else(PoisonError::into_inner) = registry;
        this
    }
}

impl Metrics {
    /// Returns all metrics as OpenMetrics text. `readings` is the current state of the farm. Reads sizes of
    /// files.
    ///
    /// # Errors
    /// [`std::fmt::Error`] if a value cannot be written as text.
    pub(crate) fn text(&self, readings: FarmReadings) -> Result<String, std::fmt::Error> {
        // The lock prevents a text with gauges of two moments.
        let registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        self.gauges.set(readings);
        let mut text = String::new();
        encode(&mut text, &registry)?;
        Ok(text)
    }

    /// Counts a committed tile.
    pub(crate) fn committed(&self, profile: &str, samples: u64, millis: u64) {
        let labels = [("profile", profile.to_owned())];
        self.samples.get_or_create(&labels).inc_by(samples);
        self.tile_seconds
            .get_or_create(&labels)
            .observe(millis as f64 / 1000.0);
    }

    /// Records the duration of a commit.
    pub(crate) fn commit_took(&self, time: Duration) {
        self.commit_seconds.observe(time.as_secs_f64());
    }

    /// Returns the function with which the store reports the durations of durable writes.
    pub(crate) fn syncs(&self) -> Box<dyn Fn(Duration) + Send + Sync> {
        let histogram = self.sync_seconds.clone();
        Box::new(move |time| histogram.observe(time.as_secs_f64()))
    }

    /// Counts an ended job.
    pub(crate) fn job_ended(&self, how: &str) {
        self.jobs_ended
            .get_or_create(&[("state", how.to_owned())])
            .inc();
    }

    /// Returns the counter of transferred bytes in one direction, `in` or `out`.
    pub(crate) fn transferred(&self, direction: &str) -> Counter {
        self.transferred
            .get_or_create_owned(&[("direction", direction.to_owned())])
    }

    /// Counts a cache request.
    pub(crate) fn cache_request(&self, cache: &'static str, outcome: CacheOutcome) {
        let outcome = match outcome {
            CacheOutcome::Hit => "hit",
            CacheOutcome::Miss => "miss",
        };
        self.cache_requests
            .get_or_create(&[("cache", cache.to_owned()), ("outcome", outcome.to_owned())])
            .inc();
    }

    /// Counts a tile that was set aside.
    pub(crate) fn tile_set_aside(&self) {
        self.set_aside.inc();
    }

    /// Counts an output that differs from the stored output.
    pub(crate) fn conflict(&self) {
        self.conflicts.inc();
    }

    /// Counts a worker that disconnected without notice while it had a tile.
    pub(crate) fn worker_died(&self) {
        self.deaths.inc();
    }

    /// Counts a lease that ended before its tile was done.
    pub(crate) fn lease_taken_back(&self) {
        self.taken_back.inc();
    }

    /// Counts a finished phase of a crew, and records its duration. A duration of 0 is unknown.
    pub(crate) fn phase_done(&self, profile: &str, time: Duration) {
        self.phases.inc();
        if !time.is_zero() {
            let of_profile = self
                .phase_seconds
                .get_or_create_owned(&[("profile", profile.to_owned())]);
            of_profile.observe(time.as_secs_f64());
        }
    }

    /// Counts a tile that was computed again for a check.
    pub(crate) fn spot_check(&self, outcome: &'static str) {
        self.spot_checks
            .get_or_create(&[("outcome", outcome.to_owned())])
            .inc();
    }

    /// Counts an ended call, and records its duration.
    pub(crate) fn request(&self, method: &str, code: &str, time: Duration) {
        self.requests
            .get_or_create(&[("method", method.to_owned()), ("code", code.to_owned())])
            .inc();
        self.request_seconds
            .get_or_create(&[("method", method.to_owned())])
            .observe(time.as_secs_f64());
    }

    /// Counts an address that a worker received, to `read` or to `write`.
    pub(crate) fn addressed(&self, operation: &'static str) {
        self.addresses
            .get_or_create(&[("operation", operation.to_owned())])
            .inc();
    }

    /// Counts bytes that were transferred directly between a worker and the blob store.
    pub(crate) fn went_directly(&self, operation: &'static str, bytes: u64) {
        self.direct_bytes
            .get_or_create(&[("operation", operation.to_owned())])
            .inc_by(bytes);
    }

    /// Counts a direct transfer that failed, so that the worker used the coordinator.
    pub(crate) fn fell_back(&self, operation: &'static str) {
        self.fallbacks
            .get_or_create(&[("operation", operation.to_owned())])
            .inc();
    }

    /// Counts a call that was rejected because of a limit.
    pub(crate) fn refused(&self, limit: &'static str) {
        self.refused
            .get_or_create(&[("limit", limit.to_owned())])
            .inc();
    }
}
