//! The state of the reports: events, metrics, spans, and the last test of readiness.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use crate::telemetry::events::EventLog;
use crate::telemetry::metrics::Metrics;
use crate::telemetry::spans::Spans;

/// The reasons why a coordinator is not ready, one sentence each.
pub(crate) type NotReady = Vec<String>;

/// The time and the outcome of the last test of readiness.
pub(crate) type LastTest = Option<(Instant, Result<(), NotReady>)>;

/// The reports of a coordinator.
pub(crate) struct Telemetry {
    /// The events of jobs and workers.
    pub(crate) event_log: EventLog,
    /// The metrics.
    pub(crate) metrics: Metrics,
    /// The spans of jobs.
    pub(crate) spans: Arc<Spans>,
    /// The last test of readiness.
    pub(crate) last_test: Mutex<LastTest>,
}

impl Telemetry {
    /// Creates empty reports on an event log.
    pub(crate) fn new(event_log: EventLog) -> Self {
        Self {
            event_log,
            metrics: Metrics::default(),
            spans: Arc::default(),
            last_test: Mutex::new(None),
        }
    }
}
