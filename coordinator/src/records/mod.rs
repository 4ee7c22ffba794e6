//! The records of a coordinator: its store, with the locks of changes.
//!
//! Every component reads the store. A change requires the type that holds its lock.
//!
//! | type | lock | changes |
//! |---|---|---|
//! | [`JobChanges`] | of the records of jobs | jobs, tiles, quarantines, and scenes that are deleted |
//! | [`OutputCommit`] | of outputs, shared | the output of a tile |
//! | [`OutputRemoval`] | of outputs, exclusive | blobs of outputs and results that are removed |
//!
//! [`Records`] itself has the changes that do not need a lock.

mod job_changes;
mod output_commit;
mod output_removal;

use std::ops::Deref;
use std::sync::{Mutex, RwLock};

use sightline_records::ids::JobId;
use sightline_records::{JobRecord, RetentionStamp, SceneRecord};
use sightline_store::{Queries, Store, StoreError, StoreIdentity};

pub(crate) use self::job_changes::JobChanges;
pub(crate) use self::output_commit::OutputCommit;
pub(crate) use self::output_removal::OutputRemoval;
use crate::locks::check_store_call;
use crate::telemetry::metrics::Metrics;

/// The store, with the locks of its changes.
pub(crate) struct Records {
    store: Box<dyn Store>,
    /// The lock that a thread holds while it changes the record of a job, and until the scheduler has
    /// received the change.
    jobs: Mutex<()>,
    /// The lock of outputs: shared by commits, exclusive for removals.
    outputs: RwLock<()>,
}

impl Deref for Records {
    type Target = dyn Queries;

    fn deref(&self) -> &Self::Target {
        check_store_call();
        &*self.store
    }
}

impl Records {
    /// Wraps a store.
    pub(crate) fn new(store: Box<dyn Store>) -> Self {
        Self {
            store,
            jobs: Mutex::default(),
            outputs: RwLock::default(),
        }
    }

    /// Returns the store, for a restart in tests.
    #[cfg(test)]
    pub(crate) fn into_store(self) -> Box<dyn Store> {
        self.store
    }

    /// Returns the read-only interface of the store.
    pub(crate) fn queries(&self) -> &dyn Queries {
        &**self
    }

    /// Returns the record of a job.
    ///
    /// # Errors
    /// [`StoreError::UnknownJob`] if the job does not exist, or another [`StoreError`] if the store fails.
    pub(crate) fn existing_job(&self, job: JobId) -> Result<JobRecord, StoreError> {
        self.job(job)?.ok_or(StoreError::UnknownJob { job })
    }

    /// Returns the identity of the store.
    pub(crate) fn identity(&self) -> Result<StoreIdentity, StoreError> {
        check_store_call();
        self.store.identity()
    }

    /// Records a scene whose blob is stored.
    pub(crate) fn record_scene(&self, scene: SceneRecord) -> Result<(), StoreError> {
        check_store_call();
        self.store.record_scene(scene)
    }

    /// Records a stamp of the clock of retention.
    pub(crate) fn stamp_retention(&self, stamp: RetentionStamp) -> Result<(), StoreError> {
        check_store_call();
        self.store.stamp_retention(stamp)
    }

    /// Reports the durations of durable writes to the metrics.
    pub(crate) fn report_syncs(&self, metrics: &Metrics) {
        check_store_call();
        self.store.report_syncs(metrics.syncs());
    }
}
