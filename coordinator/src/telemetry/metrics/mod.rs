//! What the coordinator counts, for Prometheus. `docs/operations.md` has the table of the names, and a test
//! compares the two.
//!
//! Counters and histograms are changed where something happens. Gauges are read from the scheduler and the
//! disk when somebody asks (`now.rs`). Nothing here has an influence on what the coordinator does.

mod disk;
mod now;
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
pub(crate) use self::now::FarmReadings;
use self::now::Gauges;

/// Labels with their values.
type Labels<const N: usize> = [(&'static str, String); N];
/// Counters by one label.
type Counters = Family<Labels<1>, Counter>;
/// Histograms by one label.
type Histograms = Family<Labels<1>, Histogram, fn() -> Histogram>;

/// Upper ends of the classes of times, in seconds: of requests and of the disk, and of tiles.
const SHORT: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 60.0];
const LONG: [f64; 10] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3600.0];

fn short() -> Histogram {
    Histogram::new(SHORT)
}

fn long() -> Histogram {
    Histogram::new(LONG)
}

/// All that is counted.
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

/// How a look into a cache ended.
#[derive(Clone, Copy)]
pub(crate) enum Cache {
    Hit,
    Miss,
}

/// Registers whether this coordinator leads.
fn lead(registry: &mut Registry, is: i64) {
    let leader: Gauge = Gauge::default();
    leader.set(is);
    registry.register(
        "leader",
        "1 if this coordinator grants tiles, 0 if it stands by",
        leader,
    );
}

/// The metrics of a coordinator that stands by.
pub(crate) fn standing_by() -> Result<String, std::fmt::Error> {
    let mut registry = Registry::with_prefix("sightline");
    registry.register(
        "build",
        "The program",
        Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]),
    );
    lead(&mut registry, 0);
    let ready: Gauge = Gauge::default();
    ready.set(1);
    registry.register("ready", "1 if /readyz says so", ready);
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("sightline");
        let build = Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]);
        registry.register("build", "The program", build);
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
            "Lines and cubes of committed tiles",
            this.samples.clone(),
        );
        r.register(
            "jobs_ended",
            "Jobs that have ended, by how",
            this.jobs_ended.clone(),
        );
        let help = "Bytes of the bodies of gRPC calls";
        r.register_with_unit("transferred", help, Unit::Bytes, this.transferred.clone());
        r.register(
            "cache_requests",
            "Looks into what is kept in memory",
            this.cache_requests.clone(),
        );
        let help = "Time from the arrival of a tile's output to its acknowledgement";
        r.register_with_unit("commit", help, seconds(), this.commit_seconds.clone());
        let help =
            "Time of a durable write of the store, which commands that arrive together share";
        r.register_with_unit("sync", help, seconds(), this.sync_seconds.clone());
        r.register(
            "tiles_set_aside",
            "Tiles that were given up",
            this.set_aside.clone(),
        );
        r.register(
            "tile_conflicts",
            "Outputs that differ from the one that stays",
            this.conflicts.clone(),
        );
        r.register(
            "worker_deaths",
            "Workers that ended without a word while they held a tile",
            this.deaths.clone(),
        );
        r.register(
            "leases_taken_back",
            "Leases that ended before their tile",
            this.taken_back.clone(),
        );
        r.register(
            "phases",
            "Phases of blocks that crews have finished",
            this.phases.clone(),
        );
        let help = "Time that the leader of a crew took over a phase";
        r.register_with_unit("phase", help, seconds(), this.phase_seconds.clone());
        r.register(
            "spot_checks",
            "Tiles that were computed again, by outcome",
            this.spot_checks.clone(),
        );
        r.register(
            "requests",
            "Calls that have ended, by their code",
            this.requests.clone(),
        );
        let help = "Time of a call, of a stream until its end";
        r.register_with_unit("request", help, seconds(), this.request_seconds.clone());
        r.register(
            "refused",
            "What was refused because of a limit",
            this.refused.clone(),
        );
        let help = "Addresses of the store of the blobs that workers were given";
        r.register("direct_addresses", help, this.addresses.clone());
        let help = "Bytes of the blobs whose addresses were given, and of the outputs committed from there";
        r.register_with_unit("direct", help, Unit::Bytes, this.direct_bytes.clone());
        let help = "Blobs that went through the coordinator because an address did not do";
        r.register("direct_fallbacks", help, this.fallbacks.clone());
        *this.registry.lock().unwrap_or_else(PoisonError::into_inner) = registry;
        this
    }
}

impl Metrics {
    /// Everything, as OpenMetrics text; `moment` is how things stand. Looks at files.
    ///
    /// # Errors
    /// When a value cannot be written as text.
    pub(crate) fn text(&self, moment: FarmReadings) -> Result<String, std::fmt::Error> {
        // Nobody reads gauges of two moments.
        let registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        self.gauges.set(moment);
        let mut text = String::new();
        encode(&mut text, &registry)?;
        Ok(text)
    }

    /// A tile was committed.
    pub(crate) fn committed(&self, profile: &str, samples: u64, millis: u64) {
        let labels = [("profile", profile.to_owned())];
        self.samples.get_or_create(&labels).inc_by(samples);
        self.tile_seconds
            .get_or_create(&labels)
            .observe(millis as f64 / 1000.0);
    }

    /// A commit took this long.
    pub(crate) fn commit_took(&self, time: Duration) {
        self.commit_seconds.observe(time.as_secs_f64());
    }

    /// Where the store reports how long its durable writes take.
    pub(crate) fn syncs(&self) -> Box<dyn Fn(Duration) + Send + Sync> {
        let histogram = self.sync_seconds.clone();
        Box::new(move |time| histogram.observe(time.as_secs_f64()))
    }

    /// A job has ended.
    pub(crate) fn job_ended(&self, how: &str) {
        self.jobs_ended
            .get_or_create(&[("state", how.to_owned())])
            .inc();
    }

    /// Where bytes of one direction, `in` or `out`, are counted.
    pub(crate) fn transferred(&self, direction: &str) -> Counter {
        self.transferred
            .get_or_create_owned(&[("direction", direction.to_owned())])
    }

    /// Somebody has looked into a cache.
    pub(crate) fn looked(&self, cache: &'static str, outcome: Cache) {
        let outcome = match outcome {
            Cache::Hit => "hit",
            Cache::Miss => "miss",
        };
        self.cache_requests
            .get_or_create(&[("cache", cache.to_owned()), ("outcome", outcome.to_owned())])
            .inc();
    }

    /// A tile was set aside.
    pub(crate) fn tile_set_aside(&self) {
        self.set_aside.inc();
    }

    /// An output differs from the one that stays.
    pub(crate) fn conflict(&self) {
        self.conflicts.inc();
    }

    /// Counts a worker that ended without a word while it held a tile.
    pub(crate) fn worker_died(&self) {
        self.deaths.inc();
    }

    /// A lease has ended before its tile.
    pub(crate) fn lease_taken_back(&self) {
        self.taken_back.inc();
    }

    /// A crew has finished a phase, in this time; 0 if it is not known.
    pub(crate) fn phase_done(&self, profile: &str, time: Duration) {
        self.phases.inc();
        if !time.is_zero() {
            let of_profile = self
                .phase_seconds
                .get_or_create_owned(&[("profile", profile.to_owned())]);
            of_profile.observe(time.as_secs_f64());
        }
    }

    /// A tile was computed again.
    pub(crate) fn spot_check(&self, outcome: &'static str) {
        self.spot_checks
            .get_or_create(&[("outcome", outcome.to_owned())])
            .inc();
    }

    /// A call has ended.
    pub(crate) fn request(&self, method: &str, code: &str, time: Duration) {
        self.requests
            .get_or_create(&[("method", method.to_owned()), ("code", code.to_owned())])
            .inc();
        self.request_seconds
            .get_or_create(&[("method", method.to_owned())])
            .observe(time.as_secs_f64());
    }

    /// A worker was given an address, to `read` or to `write` there.
    pub(crate) fn addressed(&self, operation: &'static str) {
        self.addresses
            .get_or_create(&[("operation", operation.to_owned())])
            .inc();
    }

    /// So many bytes are between a worker and the store of the blobs.
    pub(crate) fn went_directly(&self, operation: &'static str, bytes: u64) {
        self.direct_bytes
            .get_or_create(&[("operation", operation.to_owned())])
            .inc_by(bytes);
    }

    /// A worker could not use an address.
    pub(crate) fn fell_back(&self, operation: &'static str) {
        self.fallbacks
            .get_or_create(&[("operation", operation.to_owned())])
            .inc();
    }

    /// Something was refused because of a limit.
    pub(crate) fn refused(&self, limit: &'static str) {
        self.refused
            .get_or_create(&[("limit", limit.to_owned())])
            .inc();
    }
}
