//! The spans that a worker sends for the tiles that it computes or helps with. The worker sends spans only if
//! its coordinator sends traces, too.
//!
//! The spans of a lease are children of the coordinator's span of the lease. A wrapper around the crew
//! measures the durations of phases, so that the sampler does not depend on spans.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use sightline_bake::Crew;
use sightline_proto::v1;
use sightline_sample::TileError;
use sightline_sample::crew::{ForeignFinds, Phase};
use sightline_traces::{Span, SpanId, SpanTime, TraceId, Traces};

use crate::config::Config;

/// Minimum duration of a step with its own span. Shorter steps used cached data, or did not wait.
const LEAST_STEP: Duration = Duration::from_millis(1);
/// Minimum duration of a phase with its own span, because a small tile has many phases.
const LEAST_PHASE: Duration = Duration::from_millis(10);

/// The spans of a lease on the worker's side.
#[derive(Clone)]
pub struct Steps {
    traces: Traces,
    /// The data of the spans; `None` if no spans are sent.
    context: Option<SpanContext>,
}

#[derive(Clone)]
struct SpanContext {
    trace: TraceId,
    lease: v1::Lease,
    /// The span of all work that this worker does under the lease.
    whole: SpanId,
    worker: String,
}

impl Steps {
    /// Creates the spans of a lease. `trace` is the job's trace from the coordinator's message.
    pub fn new(config: &Config, lease: v1::Lease, trace: &[u8]) -> Self {
        let traces = config.traces.clone();
        let trace = TraceId::of_bytes(trace).filter(|_| traces.is_on());
        let context = trace.map(|trace| {
            let (whole, worker) = (traces.fresh_id(), config.name.clone());
            SpanContext {
                trace,
                lease,
                whole,
                worker,
            }
        });
        Self { traces, context }
    }

    /// Sends a span, if spans are sent.
    fn send(
        &self,
        name: &'static str,
        begun: SpanTime,
        with: impl FnOnce(Span, &SpanContext) -> Span,
    ) {
        if let Some(context) = &self.context {
            let span = Span::new(context.trace, name, begun).below(context.whole);
            let span = span
                .number("sightline.job", context.lease.job)
                .number("sightline.tile", context.lease.tile);
            self.traces
                .send(with(span.name("sightline.worker", &context.worker), context).end());
        }
    }

    /// Sends the span of a step that has ended, unless it was too short.
    pub fn step(&self, name: &'static str, begun: SpanTime) {
        if begun.elapsed() >= LEAST_STEP {
            self.send(name, begun, |span, _| span);
        }
    }

    /// Sends the span of an upload that took this many attempts.
    pub fn uploaded(&self, begun: SpanTime, bytes: u64, attempts: u32, failed: bool) {
        self.send("upload", begun, |span, _| {
            let span = span
                .number("sightline.bytes", bytes)
                .number("sightline.attempts", attempts);
            span.failed(failed.then_some("failed"))
        });
    }

    /// Sends the span of the work under the lease. The work is a tile of this worker, or help for another
    /// worker's tile.
    pub fn ended(
        &self,
        name: &'static str,
        begun: SpanTime,
        profile: &str,
        samples: u64,
        end: &'static str,
    ) {
        self.send(name, begun, |span, context| {
            let lease =
                context
                    .trace
                    .lease(context.lease.tile, context.lease.epoch, context.lease.lease);
            span.known_as(context.whole)
                .below(lease)
                .name("sightline.profile", profile)
                .number("sightline.samples", samples)
                .word("sightline.end", end)
                .failed((end != "done").then_some(end))
        });
    }

    /// Runs `compute` with a crew whose phases have spans below the span of the computation.
    ///
    /// If `helps` is true, the span of a phase covers only the items that this worker computes.
    pub fn computing<T>(
        &self,
        crew: &dyn Crew,
        helps: bool,
        compute: impl FnOnce(&dyn Crew) -> T,
    ) -> T {
        if self.context.is_none() {
            return compute(crew);
        }
        let begun = SpanTime::now();
        let timed = Timed {
            crew,
            steps: self,
            whole: self.traces.fresh_id(),
            helps,
            phases: AtomicU32::new(0),
        };
        let done = compute(&timed);
        let phases = timed.phases.load(Ordering::Relaxed);
        self.send("compute", begun, |span, _| {
            span.known_as(timed.whole)
                .number("sightline.phases", phases)
        });
        done
    }
}

/// A crew whose phases are timed.
struct Timed<'a> {
    crew: &'a dyn Crew,
    steps: &'a Steps,
    /// The span of the computation.
    whole: SpanId,
    helps: bool,
    phases: AtomicU32,
}

impl Crew for Timed<'_> {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        let number = self.phases.fetch_add(1, Ordering::Relaxed);
        let counted = Counted::new(phase);
        let done = self.crew.run(&counted);
        let items = counted.items.load(Ordering::Relaxed);
        let took = counted.begun.elapsed();
        let with = |span: Span| span.below(self.whole).number("sightline.phase", number);
        match counted.first.get() {
            // A helper waits for its leader most of the time.
            Some(first) if self.helps => {
                let last = Duration::from_nanos(counted.last.load(Ordering::Relaxed));
                let end = SpanTime::ago(took.saturating_sub(last));
                self.steps.send_until("items", *first, end, |span| {
                    with(span).number("sightline.items", items)
                });
            }
            _ if !self.helps && took >= LEAST_PHASE => {
                let all = phase.items() as u64;
                self.steps.send("phase", counted.begun, |span, _| {
                    with(span)
                        .number("sightline.items", all)
                        .number("sightline.items_here", items)
                });
            }
            _ => {}
        }
        done
    }

    fn end(&self) -> Result<(), TileError> {
        self.crew.end()
    }
}

impl Steps {
    /// Sends a span that ended in the past.
    fn send_until(
        &self,
        name: &'static str,
        begun: SpanTime,
        end: SpanTime,
        with: impl FnOnce(Span) -> Span,
    ) {
        if let Some(context) = &self.context {
            let span = Span::new(context.trace, name, begun);
            let span = span
                .number("sightline.job", context.lease.job)
                .number("sightline.tile", context.lease.tile);
            self.traces
                .send(with(span.name("sightline.worker", &context.worker)).end_at(end));
        }
    }
}

/// A phase that counts the items that this worker computes and records their times.
struct Counted<'a> {
    phase: &'a dyn Phase,
    begun: SpanTime,
    items: AtomicU64,
    first: OnceLock<SpanTime>,
    /// The time at which the last item was computed, in nanoseconds after the beginning.
    last: AtomicU64,
}

impl<'a> Counted<'a> {
    fn new(phase: &'a dyn Phase) -> Self {
        let (items, last) = (AtomicU64::new(0), AtomicU64::new(0));
        Self {
            phase,
            begun: SpanTime::now(),
            items,
            first: OnceLock::new(),
            last,
        }
    }
}

impl Phase for Counted<'_> {
    fn items(&self) -> usize {
        self.phase.items()
    }

    fn prepare(&self) {
        self.phase.prepare();
    }

    fn costs(&self) -> Vec<u64> {
        self.phase.costs()
    }

    fn compute(
        &self,
        item: usize,
        is_needless: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), TileError> {
        self.first.get_or_init(SpanTime::now);
        let done = self.phase.compute(item, is_needless);
        self.items.fetch_add(1, Ordering::Relaxed);
        self.last
            .fetch_max(self.begun.elapsed().as_nanos() as u64, Ordering::Relaxed);
        done
    }

    fn has(&self, item: usize) -> bool {
        self.phase.has(item)
    }

    fn take(&self, items: &[usize]) -> Vec<u8> {
        self.phase.take(items)
    }

    fn add(&self, finds: &[u8]) -> Result<u64, ForeignFinds> {
        self.phase.add(finds)
    }

    fn outcome(&self) -> Vec<u8> {
        self.phase.outcome()
    }
}
