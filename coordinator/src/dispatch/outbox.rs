//! The ways out of the scheduler: to workers, and to the clients that watch jobs.

use std::collections::BTreeMap;

use sightline_records::ids::{JobId, WorkerId};
use sightline_scheduler::{Scheduler, WorkerCommand};
use tokio::sync::watch;

/// The way to one worker.
pub(crate) trait Outbox: Send {
    /// Sends without waiting; returns whether the message was accepted. A worker that does not read its
    /// stream loses messages and, with time, its leases.
    fn offer(&self, order: WorkerCommand) -> bool;
}

/// The state machine and the ways to its workers.
pub(crate) struct Scheduling {
    pub(crate) scheduler: Scheduler,
    pub(crate) outboxes: BTreeMap<WorkerId, Box<dyn Outbox>>,
}

impl Scheduling {
    /// A machine without workers.
    pub(crate) fn new(scheduler: Scheduler) -> Self {
        Self {
            scheduler,
            outboxes: BTreeMap::new(),
        }
    }
}

/// The jobs that clients watch.
#[derive(Default)]
pub(crate) struct Watched {
    of: BTreeMap<JobId, watch::Sender<bool>>,
    /// Changes of any job and of the workers.
    any: watch::Sender<()>,
}

impl Watched {
    /// Changes of a job from now on; the value is whether the job has ended.
    pub(crate) fn subscribe(&mut self, job: JobId) -> watch::Receiver<bool> {
        self.of.retain(|_, sender| sender.receiver_count() > 0);
        self.of
            .entry(job)
            .or_insert_with(|| watch::Sender::new(false))
            .subscribe()
    }

    /// Changes of any job and of the workers from now on.
    pub(crate) fn any(&self) -> watch::Receiver<()> {
        self.any.subscribe()
    }

    /// Wakes those who watch a job.
    pub(crate) fn changed(&self, job: JobId, ended: bool) {
        if let Some(sender) = self.of.get(&job) {
            sender.send_replace(ended);
        }
        self.any.send_modify(|()| ());
    }

    /// Wakes everybody who watches a job: every summary says how many workers there are.
    pub(crate) fn all_changed(&self) {
        self.of
            .values()
            .for_each(|sender| sender.send_modify(|_| ()));
        self.any.send_modify(|()| ());
    }
}
