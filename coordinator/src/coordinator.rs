//! The coordinator: the state that its modules share.
//!
//! This module makes no decisions; the modules `uploads`, `jobs`, `workers`, `outputs` and `results` do. Most
//! calls block on the disk, so the services run them outside the async threads.

use std::sync::Arc;

use sightline_scheduler::{Event, Now};
use sightline_store::Blobs;
use sightline_traces::Traces;

use crate::access::Access;
use crate::clock::Moment;
use crate::config::RunSettings;
use crate::dispatch::FollowUps;
use crate::dispatch::dispatcher::Dispatcher;
use crate::jobs::suspensions::Suspensions;
use crate::records::Records;
use crate::results::state::{ResultState, SceneQueries};
use crate::telemetry::events::LogEvent;
use crate::telemetry::state::Telemetry;
use crate::timekeeper::Timekeeper;
use crate::uploads::state::UploadState;
use crate::users::state::UserState;
use crate::workers::state::WorkerState;

/// A coordinator without a network. [`serve`](crate::serve) offers its services over gRPC.
pub struct Coordinator {
    pub(crate) config: RunSettings,
    pub(crate) clock: Timekeeper,
    /// The store, and the locks that order its changes.
    pub(crate) records: Records,
    pub(crate) blobs: Box<dyn Blobs>,
    /// The scheduler, and the channels to workers and watchers.
    pub(crate) dispatcher: Dispatcher,
    pub(crate) uploads: UploadState,
    pub(crate) workers: WorkerState,
    pub(crate) results: ResultState,
    pub(crate) users: UserState,
    pub(crate) telemetry: Telemetry,
    /// The jobs that wait for a missing blob.
    pub(crate) suspensions: Suspensions,
}

impl Coordinator {
    /// Sets the program that answers queries which need the scene of a stored result. Only the first call has
    /// an effect.
    pub fn answer_with(&self, queries: Box<dyn SceneQueries>) {
        drop(self.results.scene_queries.set(queries));
    }

    /// Requires credentials of callers from now on. Only the first call has an effect.
    pub fn ask_callers(&self, access: Arc<Access>) {
        drop(self.users.access.set(access));
    }

    /// Sends traces of jobs from now on, including jobs that are already open. Only the first call has an
    /// effect.
    pub fn send_traces(&self, traces: Traces) {
        let spans = &self.telemetry.spans;
        spans.send_to(traces);
        self.dispatcher.read(|scheduler| {
            let jobs = scheduler.job_ids();
            jobs.into_iter()
                .filter_map(|id| scheduler.job(id))
                .for_each(|job| spans.taken_up(job));
        });
    }

    /// Returns the current time, after the clock of retention has observed it.
    pub(crate) fn now(&self) -> Moment {
        self.clock.now(self.config.ages())
    }

    /// Returns the current time in the scheduler's time base.
    pub(crate) fn scheduler_now(&self) -> Now {
        self.clock.scheduler_time(self.now())
    }

    /// Records an event in the event log, without blocking.
    pub(crate) fn record_event(&self, event: LogEvent) {
        self.telemetry.event_log.record(self.clock.unix_ms(), event);
    }

    /// Passes an event to the scheduler, without blocking.
    pub(crate) fn tell(&self, event: Event) -> FollowUps {
        // Read the time before waiting for the lock, because many returning workers may delay the lock.
        let now = self.scheduler_now();
        self.dispatcher.tell(event, now, &self.telemetry)
    }
}
