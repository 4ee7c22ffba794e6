//! The clients that watch jobs.

use std::collections::BTreeMap;

use sightline_records::ids::JobId;
use tokio::sync::watch;

/// The channels to the clients that watch jobs.
#[derive(Default)]
pub(super) struct Watchers {
    by_job: BTreeMap<JobId, watch::Sender<bool>>,
    /// The channel for changes of any job and of the workers.
    any: watch::Sender<()>,
}

impl Watchers {
    /// Subscribes to the changes of a job. The value is true if the job has ended.
    pub(super) fn subscribe(&mut self, job: JobId) -> watch::Receiver<bool> {
        self.by_job.retain(|_, sender| sender.receiver_count() > 0);
        self.by_job
            .entry(job)
            .or_insert_with(|| watch::Sender::new(false))
            .subscribe()
    }

    /// Subscribes to the changes of all jobs and of the workers.
    pub(super) fn any(&self) -> watch::Receiver<()> {
        self.any.subscribe()
    }

    /// Wakes the watchers of a job. `ended` is true if the job has ended.
    pub(super) fn changed(&self, job: JobId, ended: bool) {
        if let Some(sender) = self.by_job.get(&job) {
            sender.send_replace(ended);
        }
        self.any.send_modify(|()| ());
    }

    /// Wakes all watchers, because every summary contains the number of workers.
    pub(super) fn all_changed(&self) {
        self.by_job
            .values()
            .for_each(|sender| sender.send_modify(|_| ()));
        self.any.send_modify(|()| ());
    }
}
