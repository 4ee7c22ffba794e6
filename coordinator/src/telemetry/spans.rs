//! The spans that a coordinator sends about its jobs, if traces are enabled.
//!
//! Spans are created when the scheduler receives an event or makes a decision; the scheduler itself does not
//! depend on them. Open spans are only in memory. After a restart a job has the same trace, because its trace
//! is derived from its record. The span of a lease that its worker has kept starts again. The other open
//! spans are lost.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use sightline_records::ids::{JobId, Lease, LeaseId, TileIndex, worker_name};
use sightline_records::{JobPhase, JobRecord, JobState, TileStats};
use sightline_scheduler::{Event, OpenJob, Scheduler};
use sightline_traces::{Span, SpanId, SpanTime, TraceId, Traces};

/// Names of the attributes of spans.
const JOB: &str = "sightline.job";
const TILE: &str = "sightline.tile";
const TILES: &str = "sightline.tiles";
const WORKER: &str = "sightline.worker";
const PROFILE: &str = "sightline.profile";
const END: &str = "sightline.end";
const CELLS: &str = "sightline.cells";
const SAMPLES: &str = "sightline.samples";
const BYTES: &str = "sightline.bytes";

/// The reasons for the end of a lease, or the fate of its output.
pub(crate) const DONE: &str = "done";
pub(crate) const TAKEN_BACK: &str = "taken_back";
pub(crate) const FAILED: &str = "failed";
pub(crate) const CONFLICT: &str = "conflict";
pub(crate) const CHECKED: &str = "checked";

/// Maximum number of ended jobs that are remembered. A job that is reopened after this many others is handled
/// as after a restart.
const MOST_ENDED: usize = 1 << 14;

/// A span of another trace that caused a submission.
pub(crate) type Cause = Option<(TraceId, SpanId)>;

/// The open spans, and the destination of spans.
#[derive(Default)]
pub(crate) struct Spans {
    traces: OnceLock<Traces>,
    open: Mutex<Open>,
}

#[derive(Default)]
struct Open {
    /// The jobs that have not ended.
    jobs: BTreeMap<JobId, JobSpans>,
    /// The jobs whose end is recorded in a span, at most [`MOST_ENDED`].
    ended: BTreeSet<JobId>,
}

struct JobSpans {
    trace: TraceId,
    /// The time from which the job's tiles may be leased.
    free: SpanTime,
    is_paused: bool,
    /// True if the span of the whole job was sent before the job was reopened.
    again: bool,
    /// True if tiles depend on other tiles.
    has_needs: bool,
    leases: BTreeMap<Lease, Leased>,
    /// The leases whose spans were sent. A late output still counts, and may arrive twice.
    spent: BTreeSet<LeaseId>,
    /// The times at which tiles were free again, or done if other tiles depend on them.
    moved: BTreeMap<TileIndex, SpanTime>,
}

struct Leased {
    begun: SpanTime,
    worker: String,
    /// True if the lease began in an earlier process, at an unknown time.
    is_older: bool,
}

impl JobSpans {
    fn span(&self, name: &'static str, begun: SpanTime, job: JobId) -> Span {
        Span::new(self.trace, name, begun)
            .below(self.trace.job())
            .number(JOB, job.0)
    }

    /// Returns the time from which a tile has waited for a worker.
    fn waits_since(&self, tile: TileIndex, needs: &[u32]) -> SpanTime {
        let needed = needs.iter().map(|need| TileIndex(*need));
        let moved = needed
            .chain([tile])
            .filter_map(|tile| self.moved.get(&tile));
        moved.fold(self.free, |since, moved| since.max(*moved))
    }

    /// Sends the span of a lease if the lease is open.
    fn end_lease(&mut self, traces: &Traces, lease: &Lease, how: &'static str, now: SpanTime) {
        let Some(leased) = self.leases.remove(lease) else {
            return;
        };
        self.spent.insert(lease.id);
        let span = Span::new(self.trace, "lease", leased.begun)
            .known_as(lease_id(self.trace, lease))
            .below(self.trace.job())
            .number(JOB, lease.job.0)
            .number(TILE, lease.tile.0)
            .name(WORKER, &leased.worker)
            .word(END, how)
            .failed((how != DONE && how != CHECKED).then_some(how));
        traces.send(span.end_at(now));
        if how != DONE || self.has_needs {
            self.moved.insert(lease.tile, now);
        }
    }

    /// Sends the spans of all leases for which `ends` returns true.
    fn end_leases(&mut self, traces: &Traces, now: SpanTime, ends: impl Fn(&Lease) -> bool) {
        let leases: Vec<Lease> = self.leases.keys().copied().filter(ends).collect();
        leases
            .iter()
            .for_each(|lease| self.end_lease(traces, lease, TAKEN_BACK, now));
    }
}

fn lease_id(trace: TraceId, lease: &Lease) -> SpanId {
    trace.lease(lease.tile.0, lease.id.epoch.0, lease.id.number)
}

impl Spans {
    /// Sends spans from now on. Only the first call has an effect.
    pub(crate) fn send_to(&self, traces: Traces) {
        drop(self.traces.set(traces));
    }

    fn on(&self) -> Option<&Traces> {
        self.traces.get().filter(|traces| traces.is_on())
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        // A panic may lose a span, but no other state.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the trace of a job, or `None` if traces are disabled.
    pub(crate) fn trace_of(&self, job: &JobRecord) -> Option<TraceId> {
        self.on()
            .map(|_| TraceId::of_job(&job.key, job.id.0, job.submitted_at_ms))
    }

    /// Returns the trace of a job that has not ended.
    pub(crate) fn trace(&self, job: JobId) -> Option<TraceId> {
        self.on()?;
        self.open().jobs.get(&job).map(|job| job.trace)
    }

    /// Records an event that the scheduler is about to receive.
    pub(crate) fn heard(&self, event: &Event) {
        let Some(traces) = self.on() else { return };
        match event {
            Event::TakenUp(job) => self.taken_up(job),
            Event::JobChanged(record) => self.changed(traces, record),
            Event::Stopped(id) => {
                if let Some(job) = self.open().jobs.get_mut(id) {
                    job.end_leases(traces, SpanTime::now(), |_| true);
                }
            }
            _ => {}
        }
    }

    /// Records that the scheduler has received a job.
    pub(crate) fn taken_up(&self, job: &OpenJob) {
        let Some(trace) = self.trace_of(&job.record) else {
            return;
        };
        let mut open = self.open();
        let again = open.ended.contains(&job.record.id);
        let (leases, spent) = open
            .jobs
            .remove(&job.record.id)
            .map(|job| (job.leases, job.spent))
            .unwrap_or_default();
        let spans = JobSpans {
            trace,
            free: SpanTime::now(),
            is_paused: job.record.state.phase() == JobPhase::Paused,
            again,
            has_needs: job
                .planned
                .plan()
                .tiles
                .iter()
                .any(|tile| !tile.needs.is_empty()),
            leases,
            spent,
            moved: BTreeMap::new(),
        };
        open.jobs.insert(job.record.id, spans);
    }

    fn changed(&self, traces: &Traces, record: &JobRecord) {
        let (id, phase) = (record.id, record.state.phase());
        let mut open = self.open();
        let Some(job) = open.jobs.get_mut(&id) else {
            return;
        };
        let was_paused = std::mem::replace(&mut job.is_paused, phase == JobPhase::Paused);
        if was_paused && !job.is_paused {
            job.free = SpanTime::now();
        }
        if !phase.ended() {
            return;
        }
        let now = SpanTime::now();
        job.end_leases(traces, now, |_| true);
        // If the span with this id was sent before, another span below it describes the rest. After a restart
        // in between, this is not known, and the span is sent once more.
        let whole = match job.again {
            false => {
                Span::since(job.trace, "job", record.submitted_at_ms).known_as(job.trace.job())
            }
            true => job.span("job", job.free, id),
        };
        let (end, bytes) = match &record.state {
            JobState::Done { bytes, .. } => (DONE, *bytes),
            JobState::Failed { .. } => (FAILED, 0),
            _ => ("cancelled", 0),
        };
        let whole = if job.again {
            whole
        } else {
            whole.number(JOB, id.0)
        };
        let whole = whole
            .number(TILES, record.tiles)
            .name(PROFILE, record.profile.as_deref().unwrap_or("unbound"))
            .number(BYTES, bytes)
            .word(END, end)
            .failed((end == FAILED).then_some(end));
        traces.send(whole.end_at(now));
        open.jobs.remove(&id);
        open.ended.insert(id);
        if open.ended.len() > MOST_ENDED {
            open.ended.pop_first();
        }
    }

    /// Records the planning of a submitted job. `begun` is the time at which the call arrived.
    pub(crate) fn planned(&self, id: JobId, begun: SpanTime, tiles: usize, cause: Cause) {
        let Some(traces) = self.on() else { return };
        if let Some(job) = self.open().jobs.get(&id) {
            traces.send(
                job.span("plan", begun, id)
                    .number(TILES, tiles as u64)
                    .linked(cause)
                    .end(),
            );
        }
    }

    /// Records that a tile is leased to a worker.
    pub(crate) fn leased(&self, lease: &Lease, worker: &str, scheduler: &Scheduler) {
        let Some(traces) = self.on() else { return };
        let mut open = self.open();
        let Some(job) = open.jobs.get_mut(&lease.job) else {
            return;
        };
        let now = SpanTime::now();
        // End the leases whose end no event has reported.
        job.end_leases(traces, now, |other| {
            other.tile == lease.tile && !scheduler.is_leased(other)
        });
        let needs = scheduler
            .job(lease.job)
            .map(|job| &*job.planned.plan().tiles[lease.tile.at()].needs);
        let since = job.waits_since(lease.tile, needs.unwrap_or_default());
        let wait = job
            .span("wait", since, lease.job)
            .number(TILE, lease.tile.0)
            .name(WORKER, worker);
        traces.send(wait.end_at(now));
        job.leases.insert(
            *lease,
            Leased {
                begun: now,
                worker: worker.to_owned(),
                is_older: false,
            },
        );
    }

    /// Records that a worker has returned with leases, some of which an earlier coordinator granted.
    pub(crate) fn held_again(&self, worker: &str, kept: &[Lease]) {
        if self.on().is_none() {
            return;
        }
        let mut open = self.open();
        for lease in kept {
            if let Some(job) = open
                .jobs
                .get_mut(&lease.job)
                .filter(|job| !job.spent.contains(&lease.id))
            {
                let begun = SpanTime::now();
                let leased = || Leased {
                    begun,
                    worker: worker.to_owned(),
                    is_older: true,
                };
                job.leases.entry(*lease).or_insert_with(leased);
            }
        }
    }

    /// Records that a lease ended before its tile was done.
    pub(crate) fn lease_ended(&self, lease: &Lease, how: &'static str) {
        let Some(traces) = self.on() else { return };
        if let Some(job) = self.open().jobs.get_mut(&lease.job) {
            job.end_lease(traces, lease, how, SpanTime::now());
        }
    }

    /// Records the fate of an output that arrived at `begun`. The lease ends with the output.
    pub(crate) fn committed(
        &self,
        lease: &Lease,
        begun: SpanTime,
        how: &'static str,
        stats: &TileStats,
        bytes: u64,
    ) {
        let Some(traces) = self.on() else { return };
        let mut open = self.open();
        let Some(job) = open.jobs.get_mut(&lease.job) else {
            return;
        };
        let now = SpanTime::now();
        if !job.spent.contains(&lease.id) {
            // After a restart an output may arrive before its worker reconnects, so the reported duration
            // replaces the unknown start.
            let since = SpanTime::ago(Duration::from_millis(stats.millis) + begun.elapsed());
            let leased = || Leased {
                begun: since,
                worker: worker_name(&stats.worker).to_owned(),
                is_older: true,
            };
            let leased = job.leases.entry(*lease).or_insert_with(leased);
            if leased.is_older && leased.begun.is_after(since) {
                leased.begun = since;
            }
        }
        let commit = job
            .span("commit", begun, lease.job)
            .below(lease_id(job.trace, lease))
            .number(TILE, lease.tile.0)
            .name(WORKER, worker_name(&stats.worker))
            .number(CELLS, stats.cells)
            .number(SAMPLES, stats.samples)
            .number(BYTES, bytes)
            .word(END, how)
            .failed((how == CONFLICT).then_some(how));
        traces.send(commit.end_at(now));
        job.end_lease(traces, lease, how, now);
    }

    /// Records that the result of a job was assembled, or that the assembly failed.
    pub(crate) fn assembled(&self, id: JobId, begun: SpanTime, bytes: Option<u64>) {
        let Some(traces) = self.on() else { return };
        if let Some(job) = self.open().jobs.get(&id) {
            let span = job
                .span("assemble", begun, id)
                .number(BYTES, bytes.unwrap_or(0));
            let end = if bytes.is_some() { DONE } else { FAILED };
            traces.send(
                span.word(END, end)
                    .failed(bytes.is_none().then_some(end))
                    .end(),
            );
        }
    }
}
