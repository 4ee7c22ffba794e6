//! The spans that a coordinator sends of its jobs, where it was told to send traces.
//!
//! They are made of what the scheduler was told and of what it decided, at the moment of it; the scheduler
//! itself knows nothing of them. What is open is in memory alone. After a restart the job has the same trace,
//! since that is derived from its record; a lease that its worker has kept begins anew, and the others of
//! before are lost with those who had begun them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use sightline_records::ids::{JobId, Lease, LeaseId, TileIndex, worker_name};
use sightline_records::{JobPhase, JobRecord, JobState, TileStats};
use sightline_scheduler::{Event, Job, Scheduler};
use sightline_traces::{Begun, Span, SpanId, TraceId, Traces};

/// Attributes. Their words are those of the events.
const JOB: &str = "sightline.job";
const TILE: &str = "sightline.tile";
const TILES: &str = "sightline.tiles";
const WORKER: &str = "sightline.worker";
const PROFILE: &str = "sightline.profile";
const END: &str = "sightline.end";
const CELLS: &str = "sightline.cells";
const SAMPLES: &str = "sightline.samples";
const BYTES: &str = "sightline.bytes";

/// How a lease ended, or what came of its output.
pub(crate) const DONE: &str = "done";
pub(crate) const TAKEN_BACK: &str = "taken_back";
pub(crate) const FAILED: &str = "failed";
pub(crate) const CONFLICT: &str = "conflict";
pub(crate) const CHECKED: &str = "checked";

/// Jobs that are remembered after their end. One that is taken up anew after so many others is told of as
/// after a restart.
const MOST_ENDED: usize = 1 << 14;

/// Another trace's span that led to a submission.
pub(crate) type Cause = Option<(TraceId, SpanId)>;

/// What is open, and where spans go.
#[derive(Default)]
pub(crate) struct Spans {
    traces: OnceLock<Traces>,
    open: Mutex<Open>,
}

#[derive(Default)]
struct Open {
    /// Jobs that have not ended.
    jobs: BTreeMap<JobId, JobSpans>,
    /// Jobs of which a span says that they have ended, at most [`MOST_ENDED`].
    ended: BTreeSet<JobId>,
}

struct JobSpans {
    trace: TraceId,
    /// Since when its tiles may be leased.
    free: Begun,
    is_paused: bool,
    /// Whether the span of the whole job was sent before it was taken up once more.
    again: bool,
    /// Whether tiles need others.
    has_needs: bool,
    leases: BTreeMap<Lease, Leased>,
    /// Leases whose spans were sent. An output counts however late it comes, and may come twice.
    spent: BTreeSet<LeaseId>,
    /// When tiles were free again, or done where others need them.
    moved: BTreeMap<TileIndex, Begun>,
}

struct Leased {
    begun: Begun,
    worker: String,
    /// Whether it began in an earlier process, at an unknown time.
    is_older: bool,
}

impl JobSpans {
    fn span(&self, name: &'static str, begun: Begun, job: JobId) -> Span {
        Span::of(self.trace, name, begun)
            .below(self.trace.job())
            .number(JOB, job.0)
    }

    /// Since when a tile has waited for a worker.
    fn waits_since(&self, tile: TileIndex, needs: &[u32]) -> Begun {
        let needed = needs.iter().map(|need| TileIndex(*need));
        let moved = needed
            .chain([tile])
            .filter_map(|tile| self.moved.get(&tile));
        moved.fold(self.free, |since, moved| since.max(*moved))
    }

    /// Ends a lease, if it is open.
    fn end_lease(&mut self, traces: &Traces, lease: &Lease, how: &'static str, now: Begun) {
        let Some(leased) = self.leases.remove(lease) else {
            return;
        };
        self.spent.insert(lease.id);
        let span = Span::of(self.trace, "lease", leased.begun)
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

    /// Ends all leases for which `ends` holds.
    fn end_leases(&mut self, traces: &Traces, now: Begun, ends: impl Fn(&Lease) -> bool) {
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
    /// Sends spans from now on. Only the first one counts.
    pub(crate) fn send_to(&self, traces: Traces) {
        drop(self.traces.set(traces));
    }

    fn on(&self) -> Option<&Traces> {
        self.traces.get().filter(|traces| traces.is_on())
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        // A span may be lost with a panic, nothing else.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The trace of a job; `None` where none are sent.
    pub(crate) fn trace_of(&self, job: &JobRecord) -> Option<TraceId> {
        self.on()
            .map(|_| TraceId::of_job(&job.key, job.id.0, job.submitted_at_ms))
    }

    /// The trace of a job that has not ended.
    pub(crate) fn trace(&self, job: JobId) -> Option<TraceId> {
        self.on()?;
        self.open().jobs.get(&job).map(|job| job.trace)
    }

    /// Looks at what the scheduler is about to be told.
    pub(crate) fn heard(&self, event: &Event) {
        let Some(traces) = self.on() else { return };
        match event {
            Event::TakenUp(job) => self.taken_up(job),
            Event::JobChanged(record) => self.changed(traces, record),
            Event::Stopped(id) => {
                if let Some(job) = self.open().jobs.get_mut(id) {
                    job.end_leases(traces, Begun::now(), |_| true);
                }
            }
            _ => {}
        }
    }

    /// A job has come into the scheduler.
    pub(crate) fn taken_up(&self, job: &Job) {
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
            free: Begun::now(),
            is_paused: job.record.state.phase() == JobPhase::Paused,
            again,
            has_needs: job
                .work
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
            job.free = Begun::now();
        }
        if !phase.ended() {
            return;
        }
        let now = Begun::now();
        job.end_leases(traces, now, |_| true);
        // Where a span of this id was sent, another one below it says the rest. After a restart in between
        // nobody remembers, and it is sent once more.
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

    /// A job was submitted; `begun` is when the call arrived.
    pub(crate) fn planned(&self, id: JobId, begun: Begun, tiles: usize, cause: Cause) {
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

    /// A tile is leased to a worker.
    pub(crate) fn leased(&self, lease: &Lease, worker: &str, scheduler: &Scheduler) {
        let Some(traces) = self.on() else { return };
        let mut open = self.open();
        let Some(job) = open.jobs.get_mut(&lease.job) else {
            return;
        };
        let now = Begun::now();
        // Those of which nobody was told that they have ended.
        job.end_leases(traces, now, |other| {
            other.tile == lease.tile && !scheduler.is_leased(other)
        });
        let needs = scheduler
            .job(lease.job)
            .map(|job| &*job.work.plan().tiles[lease.tile.at()].needs);
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

    /// A worker has come back with leases, some of which an earlier coordinator gave.
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
                let begun = Begun::now();
                let leased = || Leased {
                    begun,
                    worker: worker.to_owned(),
                    is_older: true,
                };
                job.leases.entry(*lease).or_insert_with(leased);
            }
        }
    }

    /// A lease has ended before its tile was done.
    pub(crate) fn lease_ended(&self, lease: &Lease, how: &'static str) {
        let Some(traces) = self.on() else { return };
        if let Some(job) = self.open().jobs.get_mut(&lease.job) {
            job.end_lease(traces, lease, how, Begun::now());
        }
    }

    /// An output has arrived, `begun` at that moment, and something came of it. The lease ends with that.
    pub(crate) fn committed(
        &self,
        lease: &Lease,
        begun: Begun,
        how: &'static str,
        stats: &TileStats,
        bytes: u64,
    ) {
        let Some(traces) = self.on() else { return };
        let mut open = self.open();
        let Some(job) = open.jobs.get_mut(&lease.job) else {
            return;
        };
        let now = Begun::now();
        if !job.spent.contains(&lease.id) {
            // After a restart an output may come before its worker, and the worker says how long it took.
            let since = Begun::ago(Duration::from_millis(stats.millis) + begun.elapsed());
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

    /// The result of a job was assembled, or could not be.
    pub(crate) fn assembled(&self, id: JobId, begun: Begun, bytes: Option<u64>) {
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
