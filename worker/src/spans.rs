//! The spans that a worker sends of the tiles that it computes and of those that it helps with, where it and
//! its coordinator were told to send traces.
//!
//! The spans of a lease are below the coordinator's span of it. Phases are timed from outside, by a crew
//! around the crew: the sampler knows nothing of spans.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use sightline_bake::Crew;
use sightline_proto::v1;
use sightline_sample::TileError;
use sightline_sample::crew::{ForeignFinds, Phase};
use sightline_traces::{Begun, Span, SpanId, TraceId, Traces};

use crate::config::Config;

/// What takes less time has no span of its own: data that is here already, a turn that nobody else had.
const LEAST_STEP: Duration = Duration::from_millis(1);
/// The same of phases, of which a small tile has many.
const LEAST_PHASE: Duration = Duration::from_millis(10);

/// The spans of a lease on the worker's side.
#[derive(Clone)]
pub struct Steps {
    traces: Traces,
    /// What they are of; `None` where no spans are sent.
    of: Option<Of>,
}

#[derive(Clone)]
struct Of {
    trace: TraceId,
    lease: v1::Lease,
    /// The span of all that this worker does under the lease.
    whole: SpanId,
    worker: String,
}

impl Steps {
    /// The steps under a lease of a job with this trace, as a coordinator names it.
    pub fn of(config: &Config, lease: v1::Lease, trace: &[u8]) -> Self {
        let traces = config.traces.clone();
        let trace = TraceId::of_bytes(trace).filter(|_| traces.is_on());
        let context = trace.map(|trace| {
            let (whole, worker) = (traces.fresh_id(), config.name.clone());
            Of {
                trace,
                lease,
                whole,
                worker,
            }
        });
        Self {
            traces,
            of: context,
        }
    }

    /// Sends a span, if any are sent.
    fn send(&self, name: &'static str, begun: Begun, with: impl FnOnce(Span, &Of) -> Span) {
        if let Some(of) = &self.of {
            let span = Span::of(of.trace, name, begun).below(of.whole);
            let span = span
                .number("sightline.job", of.lease.job)
                .number("sightline.tile", of.lease.tile);
            self.traces
                .send(with(span.name("sightline.worker", &of.worker), of).end());
        }
    }

    /// Something has ended that took time only in some cases.
    pub fn step(&self, name: &'static str, begun: Begun) {
        if begun.elapsed() >= LEAST_STEP {
            self.send(name, begun, |span, _| span);
        }
    }

    /// An output was sent, after this many attempts.
    pub fn uploaded(&self, begun: Begun, bytes: u64, attempts: u32, failed: bool) {
        self.send("upload", begun, |span, _| {
            let span = span
                .number("sightline.bytes", bytes)
                .number("sightline.attempts", attempts);
            span.failed(failed.then_some("failed"))
        });
    }

    /// What this worker did under the lease has ended: a tile of its own, or help for another's.
    pub fn ended(
        &self,
        name: &'static str,
        begun: Begun,
        profile: &str,
        samples: u64,
        end: &'static str,
    ) {
        self.send(name, begun, |span, of| {
            let lease = of
                .trace
                .lease(of.lease.tile, of.lease.epoch, of.lease.lease);
            span.known_as(of.whole)
                .below(lease)
                .name("sightline.profile", profile)
                .number("sightline.samples", samples)
                .word("sightline.end", end)
                .failed((end != "done").then_some(end))
        });
    }

    /// Runs `compute` with a crew whose phases have spans below that of computing. `helps` says whether only
    /// the items computed here count.
    pub fn computing<T>(
        &self,
        crew: &dyn Crew,
        helps: bool,
        compute: impl FnOnce(&dyn Crew) -> T,
    ) -> T {
        if self.of.is_none() {
            return compute(crew);
        }
        let begun = Begun::now();
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
    /// The span of computing.
    whole: SpanId,
    helps: bool,
    phases: AtomicU32,
}

impl Crew for Timed<'_> {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        let number = self.phases.fetch_add(1, Ordering::Relaxed);
        let counted = Counted::of(phase);
        let done = self.crew.run(&counted);
        let items = counted.items.load(Ordering::Relaxed);
        let took = counted.begun.elapsed();
        let with = |span: Span| span.below(self.whole).number("sightline.phase", number);
        match counted.first.get() {
            // A helper waits for its leader most of the time.
            Some(first) if self.helps => {
                let last = Duration::from_nanos(counted.last.load(Ordering::Relaxed));
                let end = Begun::ago(took.saturating_sub(last));
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
    /// Sends a span that ended before now.
    fn send_until(
        &self,
        name: &'static str,
        begun: Begun,
        end: Begun,
        with: impl FnOnce(Span) -> Span,
    ) {
        if let Some(of) = &self.of {
            let span = Span::of(of.trace, name, begun);
            let span = span
                .number("sightline.job", of.lease.job)
                .number("sightline.tile", of.lease.tile);
            self.traces
                .send(with(span.name("sightline.worker", &of.worker)).end_at(end));
        }
    }
}

/// A phase that counts the items computed here, and notes when.
struct Counted<'a> {
    phase: &'a dyn Phase,
    begun: Begun,
    items: AtomicU64,
    first: OnceLock<Begun>,
    /// When the last item was computed, in nanoseconds after the beginning.
    last: AtomicU64,
}

impl<'a> Counted<'a> {
    fn of(phase: &'a dyn Phase) -> Self {
        let (items, last) = (AtomicU64::new(0), AtomicU64::new(0));
        Self {
            phase,
            begun: Begun::now(),
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
        self.first.get_or_init(Begun::now);
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
