//! Changes of the records of jobs: each is in the store before the scheduler receives it, and in this order.

use std::sync::MutexGuard;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, SceneRecord, Submitted, TileCheck,
};
use sightline_scheduler::Event;
use sightline_store::{Store, StoreError};

use super::OutputRemoval;
use crate::dispatch::{FollowUps, tell};
use crate::jobs::retention_stamp;
use crate::locks::{self, Rank, Ranked};
use crate::state::Coordinator;

/// Changes of the records of jobs, under their lock. Only this type has the commands of the store on jobs.
/// [`Self::finish`] unlocks and returns the follow-ups of all events.
#[must_use = "finish() returns the follow-ups of the changes"]
pub(crate) struct JobChanges<'c> {
    c: &'c Coordinator,
    lock: Option<Ranked<MutexGuard<'c, ()>>>,
    follow_ups: FollowUps,
}

impl<'c> JobChanges<'c> {
    /// Waits for the lock.
    pub(crate) fn begin(c: &'c Coordinator) -> Self {
        Self {
            c,
            lock: Some(lock(c)),
            follow_ups: FollowUps::default(),
        }
    }

    /// Returns the coordinator.
    pub(crate) fn coordinator(&self) -> &'c Coordinator {
        self.c
    }

    /// Gives the scheduler an event, and keeps its follow-ups.
    pub(crate) fn tell(&mut self, event: Event) {
        self.follow_ups.extend(tell(self.c, event));
    }

    /// Unlocks, and returns the follow-ups.
    pub(crate) fn finish(self) -> FollowUps {
        drop(self.lock);
        self.follow_ups
    }

    /// Runs a long read without the lock. Afterwards, records may have changed.
    pub(crate) fn unlocked<T>(&mut self, read: impl FnOnce() -> T) -> T {
        self.lock = None;
        let read = read();
        self.lock = Some(lock(self.c));
        read
    }

    fn store(&self) -> &dyn Store {
        locks::check_store_call();
        &*self.c.store.store
    }

    /// Records a new job, or finds the job with the same key or request.
    pub(crate) fn submit(&mut self, job: NewJob) -> Result<Submitted, StoreError> {
        self.store().submit_job(job)
    }

    /// Moves a job that is in one of some phases to another state.
    pub(crate) fn set_state(
        &mut self,
        id: JobId,
        from: &[JobPhase],
        to: JobState,
    ) -> Result<JobRecord, StoreError> {
        let at = retention_stamp::end_time(self.c);
        self.store().set_job_state(id, from, to, at)
    }

    /// Ends a job with a result.
    pub(crate) fn finish_job(
        &mut self,
        id: JobId,
        result: Digest,
        bytes: u64,
    ) -> Result<JobRecord, StoreError> {
        let at = retention_stamp::end_time(self.c);
        self.store().finish_job(id, result, bytes, at)
    }

    /// Changes the priority of a job.
    pub(crate) fn prioritize(&mut self, id: JobId, priority: i32) -> Result<JobRecord, StoreError> {
        self.store().prioritize_job(id, priority)
    }

    /// Binds a job to a numerics profile; returns the profile to which it is bound.
    pub(crate) fn bind_profile(&mut self, id: JobId, profile: &str) -> Result<String, StoreError> {
        self.store().bind_profile(id, profile)
    }

    /// Deletes an ended job.
    pub(crate) fn delete(&mut self, id: JobId) -> Result<JobRecord, StoreError> {
        self.store().delete_job(id)
    }

    /// Deletes a scene that no job names.
    pub(crate) fn delete_scene(&mut self, scene: Digest) -> Result<SceneRecord, StoreError> {
        self.store().delete_scene(scene)
    }

    /// Records a failure of a tile; returns the number of workers on which
    /// it failed.
    pub(crate) fn fail_tile(
        &mut self,
        (job, tile): (JobId, TileIndex),
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        self.store().fail_tile(job, tile, worker, reason)
    }

    /// Records the death of a worker as a failure of a tile; returns the number of workers on which
    /// it failed.
    pub(crate) fn count_death(
        &mut self,
        (job, tile): (JobId, TileIndex),
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        self.store().count_death(job, tile, worker, reason)
    }

    /// Removes a recorded failure of a tile.
    pub(crate) fn forget_failure(
        &mut self,
        (job, tile): (JobId, TileIndex),
        worker: &str,
        reason: &str,
    ) -> Result<(), StoreError> {
        self.store().forget_failure(job, tile, worker, reason)
    }

    /// Sets a tile aside, with its placeholder.
    pub(crate) fn set_aside_tile(
        &mut self,
        (job, tile): (JobId, TileIndex),
        (digest, bytes): (Digest, u64),
        reason: &str,
    ) -> Result<(), StoreError> {
        let reasons = [reason.to_owned()];
        self.store()
            .set_aside_tile(job, tile, digest, bytes, &reasons)
    }

    /// Records that another worker has computed the same output of a tile.
    pub(crate) fn confirm_tile(
        &mut self,
        (job, tile): (JobId, TileIndex),
        digest: Digest,
        check: TileCheck,
    ) -> Result<(), StoreError> {
        self.store().confirm_tile(job, tile, digest, check)
    }

    /// Reopens the failed and open tiles of an ended job.
    pub(crate) fn reopen_tiles(&mut self, id: JobId) -> Result<u32, StoreError> {
        self.store().reopen_tiles(id)
    }

    /// Reopens done tiles whose outputs are no longer trusted; returns their number. No output is committed
    /// in the meantime.
    pub(crate) fn invalidate_tiles(
        &mut self,
        _no_commits: &OutputRemoval<'_>,
        id: JobId,
        tiles: &[TileIndex],
    ) -> Result<u32, StoreError> {
        self.store().invalidate_tiles(id, tiles)
    }

    /// Quarantines a worker.
    pub(crate) fn quarantine(&mut self, record: QuarantineRecord) -> Result<(), StoreError> {
        self.store().quarantine(record)
    }

    /// Releases a worker from quarantine; returns false if it was not quarantined.
    pub(crate) fn release(&mut self, worker: &str) -> Result<bool, StoreError> {
        self.store().release(worker)
    }
}

fn lock(c: &Coordinator) -> Ranked<MutexGuard<'_, ()>> {
    locks::lock(Rank::Jobs, &c.store.jobs)
}
