//! Changes of the records of jobs. Each change is written to the store before the scheduler receives it, in
//! the same order.

use std::sync::MutexGuard;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, SceneRecord, Submitted, TileCheck,
};
use sightline_scheduler::Event;
use sightline_store::{Store, StoreError};

use super::OutputRemoval;
use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::jobs::retention_stamp;
use crate::locks::{self, Rank, Ranked};
use crate::telemetry::events::{EventKind, LogEvent};

/// Changes of the records of jobs, under their lock. Only this type sends commands about jobs to the store.
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

    /// Passes an event to the scheduler, and collects its follow-ups.
    pub(crate) fn tell(&mut self, event: Event) {
        self.follow_ups.extend(self.c.tell(event));
    }

    /// Unlocks the records, and returns the follow-ups.
    pub(crate) fn finish(self) -> FollowUps {
        drop(self.lock);
        self.follow_ups
    }

    /// Runs a long read without the lock. Another thread may change records in the meantime.
    pub(crate) fn unlocked<T>(&mut self, read: impl FnOnce() -> T) -> T {
        self.lock = None;
        let read = read();
        self.lock = Some(lock(self.c));
        read
    }

    fn store(&self) -> &dyn Store {
        locks::check_store_call();
        &*self.c.records.store
    }

    /// Records a new job, or returns the existing job with the same key or request.
    pub(crate) fn submit(&mut self, job: NewJob) -> Result<Submitted, StoreError> {
        self.store().submit_job(job)
    }

    /// Moves a job from one of the given phases to another state.
    pub(crate) fn set_state(
        &mut self,
        id: JobId,
        from: &[JobPhase],
        to: JobState,
    ) -> Result<JobRecord, StoreError> {
        let at = retention_stamp::end_time(self.c);
        self.store().set_job_state(id, from, to, at)
    }

    /// Moves a job from one of the given phases to another state, and logs the change. The change reaches the
    /// store and the scheduler.
    pub(crate) fn move_to(
        &mut self,
        id: JobId,
        from: &[JobPhase],
        to: JobState,
    ) -> Result<(), StoreError> {
        let record = self.set_state(id, from, to)?;
        let text = format!("the job is {}", record.state.phase());
        tracing::info!("job {id} is {}", record.state.phase());
        self.c
            .record_event(LogEvent::of_job(EventKind::Job, id, text));
        self.tell(Event::JobChanged(Box::new(record)));
        Ok(())
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

    /// Binds a job to a numerics profile, unless it is bound already. Returns the profile to which the job is
    /// bound.
    pub(crate) fn bind_profile(&mut self, id: JobId, profile: &str) -> Result<String, StoreError> {
        self.store().bind_profile(id, profile)
    }

    /// Deletes an ended job.
    pub(crate) fn delete(&mut self, id: JobId) -> Result<JobRecord, StoreError> {
        self.store().delete_job(id)
    }

    /// Deletes a scene that no job references.
    pub(crate) fn delete_scene(&mut self, scene: Digest) -> Result<SceneRecord, StoreError> {
        self.store().delete_scene(scene)
    }

    /// Records a failure of a tile. Returns the number of workers on which the tile failed.
    pub(crate) fn fail_tile(
        &mut self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        self.store().fail_tile(job, tile, worker, reason)
    }

    /// Records the death of a worker as a failure of a tile. Returns the number of workers on which the tile
    /// failed.
    pub(crate) fn count_death(
        &mut self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        self.store().count_death(job, tile, worker, reason)
    }

    /// Removes a recorded failure of a tile.
    pub(crate) fn forget_failure(
        &mut self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<(), StoreError> {
        self.store().forget_failure(job, tile, worker, reason)
    }

    /// Sets a tile aside, with its placeholder.
    pub(crate) fn set_aside_tile(
        &mut self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        bytes: u64,
        reason: &str,
    ) -> Result<(), StoreError> {
        let reasons = [reason.to_owned()];
        self.store()
            .set_aside_tile(job, tile, digest, bytes, &reasons)
    }

    /// Records that another worker has computed the same output of a tile.
    pub(crate) fn confirm_tile(
        &mut self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        check: TileCheck,
    ) -> Result<(), StoreError> {
        self.store().confirm_tile(job, tile, digest, check)
    }

    /// Reopens the tiles of a job that were set aside, and removes the recorded failures of open tiles.
    /// Returns the number of reopened tiles.
    pub(crate) fn reopen_tiles(&mut self, id: JobId) -> Result<u32, StoreError> {
        self.store().reopen_tiles(id)
    }

    /// Reopens done tiles whose outputs are no longer trusted. Returns their number. `_no_commits` ensures
    /// that no output is committed in the meantime.
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

    /// Releases a worker from quarantine. Returns false if the worker was not quarantined.
    pub(crate) fn release(&mut self, worker: &str) -> Result<bool, StoreError> {
        self.store().release(worker)
    }
}

fn lock(c: &Coordinator) -> Ranked<MutexGuard<'_, ()>> {
    locks::lock(Rank::Jobs, &c.records.jobs)
}
