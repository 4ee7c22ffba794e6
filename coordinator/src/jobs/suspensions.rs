//! The list of the jobs that wait for a missing blob.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use sightline_records::ids::{Digest, JobId};

/// A missing blob that a job needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MissingBlob {
    /// The scene of the job.
    Scene(Digest),
    /// The receivers of the job.
    Receivers(Digest),
}

impl MissingBlob {
    /// Returns the digest of the missing blob.
    pub(crate) fn digest(self) -> Digest {
        let (Self::Scene(digest) | Self::Receivers(digest)) = self;
        digest
    }
}

/// The jobs that wait for a missing blob.
#[derive(Default)]
pub(crate) struct Suspensions {
    waiting: Mutex<BTreeMap<JobId, MissingBlob>>,
    /// The lock that a thread holds while it suspends or continues jobs.
    pub(super) lock: Mutex<()>,
}

impl Suspensions {
    /// Returns the missing blob for which a job waits, if it waits.
    pub(crate) fn missing_blob(&self, job: JobId) -> Option<MissingBlob> {
        self.waiting().get(&job).copied()
    }

    /// Removes a job from the waiting jobs, since a user's action on the job replaces the wait.
    pub(crate) fn forget(&self, job: JobId) {
        self.waiting().remove(&job);
    }

    /// Locks the list of waiting jobs.
    pub(super) fn waiting(&self) -> MutexGuard<'_, BTreeMap<JobId, MissingBlob>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
