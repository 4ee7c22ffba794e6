//! The trait [`Store`]: the queries and commands on the coordinator's persistent state.

use std::time::Duration;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, RetentionStamp,
    SceneRecord, Submitted, TileCheck, TileRecord, TileResult,
};

use super::entries::Entry;
use super::error::StoreError;
use super::identity::StoreIdentity;

/// A callback that receives the duration of each durable write.
pub type Report = Box<dyn Fn(Duration) + Send + Sync>;

/// The queries of a store. Queries do not change the store.
pub trait Queries: Send + Sync {
    /// Returns the scene with this digest, or `None` if it was not recorded.
    fn scene(&self, digest: &Digest) -> Result<Option<SceneRecord>, StoreError>;

    /// Returns all scenes, ascending by digest.
    fn scenes(&self) -> Result<Vec<SceneRecord>, StoreError>;

    /// Returns the job with this id, or `None` if it does not exist.
    fn job(&self, job: JobId) -> Result<Option<JobRecord>, StoreError>;

    /// Returns the newest `most` jobs whose ids are below `before`, ascending by id. The flag is true if
    /// older jobs exist.
    fn jobs_before(&self, before: JobId, most: usize)
    -> Result<(Vec<JobRecord>, bool), StoreError>;

    /// Returns all jobs, ascending by id, which is the order of submission.
    fn jobs(&self) -> Result<Vec<JobRecord>, StoreError>;

    /// Returns the newest job with this key, in any state.
    fn job_by_key(&self, key: &Digest) -> Result<Option<JobRecord>, StoreError>;

    /// Returns the job that answered the submission with this request id: a new job, or an existing one.
    fn job_by_request(&self, request_id: &str) -> Result<Option<JobRecord>, StoreError>;

    /// Returns all tiles of a job, `0..job.tiles`. A tile without a record is open.
    fn tiles(&self, job: JobId) -> Result<Vec<TileRecord>, StoreError>;

    /// Returns one tile of a job.
    fn tile(&self, job: JobId, tile: TileIndex) -> Result<TileRecord, StoreError>;

    /// Checks that the store would accept a command now, without changing the store.
    ///
    /// If several coordinators share the store, checks that this coordinator still leads.
    fn may_change(&self) -> Result<(), StoreError>;

    /// Returns the epoch that began last; 0 before the first epoch.
    fn epoch(&self) -> Result<u64, StoreError>;

    /// Returns the quarantined workers, which get no tiles, ascending by name.
    fn quarantined(&self) -> Result<Vec<QuarantineRecord>, StoreError>;

    /// Returns the last stamp of the clocks of retention, or `None` before the first.
    fn retention_stamp(&self) -> Result<Option<RetentionStamp>, StoreError>;

    /// Returns all entries, ascending by key.
    fn entries(&self) -> Result<Vec<Entry>, StoreError>;
}

/// The persistent state of the coordinator.
///
/// Every command is one transaction, and its changes are durable when it returns `Ok`. A command that returns
/// an error has not changed the store, except for [`StoreError::Journal`], which documents the exception.
/// Several threads may call commands at the same time; concurrent commands share one disk sync.
pub trait Store: Queries {
    /// Returns the identity of the store. The first call generates the identity and records it.
    fn identity(&self) -> Result<StoreIdentity, StoreError>;

    /// Records a scene.
    ///
    /// An identical record is accepted again. A different record with the same digest is rejected.
    fn record_scene(&self, scene: SceneRecord) -> Result<(), StoreError>;

    /// Records a job, or returns the existing job that answers the submission.
    ///
    /// The store returns the job that an earlier submission with the same `request_id` received. Otherwise,
    /// it returns the newest job with the same key, unless that job failed or was cancelled. The store
    /// rejects a known `request_id` with another key, and a scene that was not recorded.
    fn submit_job(&self, job: NewJob) -> Result<Submitted, StoreError>;

    /// Changes the priority of a job that has not ended.
    fn prioritize_job(&self, job: JobId, priority: i32) -> Result<JobRecord, StoreError>;

    /// Sets the number of tiles of a job that was submitted with `tiles: 0`.
    ///
    /// The same number is accepted again. Another number is rejected.
    fn plan_job(&self, job: JobId, tiles: u32) -> Result<JobRecord, StoreError>;

    /// Binds a job to a numerics profile, and returns the profile that the job is bound to.
    ///
    /// The first profile stays; later calls do not change it.
    fn bind_profile(&self, job: JobId, profile: &str) -> Result<String, StoreError>;

    /// Commits a tile's result and marks the tile as done.
    ///
    /// A late result replaces the placeholder of a tile that was set aside. If the tile is already done with
    /// another digest, the store rejects the result and counts a conflict.
    fn commit_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        result: TileResult,
    ) -> Result<CommitOutcome, StoreError>;

    /// Records that a tile failed on a worker. Returns the number of workers on which it has failed.
    ///
    /// The number is at most [`MAX_FAILURES`](sightline_records::MAX_FAILURES). If the tile is not open or
    /// the job has ended, the call has no effect.
    fn fail_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError>;

    /// Records the death of a worker as [`Store::fail_tile`] records a failure.
    ///
    /// A recorded failure of the same worker stays, so that [`Store::forget_failure`] for this death does not
    /// remove it.
    fn count_death(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError>;

    /// Removes the failure of an open tile on a worker if the last recorded reason equals `reason`.
    fn forget_failure(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<(), StoreError>;

    /// Sets an open tile aside. `digest` and `bytes` are the digest and the size in bytes of the blob of its
    /// placeholder, whose cells show all triangles as undecided.
    ///
    /// The same call is accepted again. A done tile stays done ([`StoreError::TileNotOpen`]).
    fn set_aside_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        bytes: u64,
        reasons: &[String],
    ) -> Result<(), StoreError>;

    /// Changes the state of a job if its current state is one of `from`. A job in state `to` stays unchanged.
    ///
    /// Only [`Store::finish_job`] sets the state `Done`, and only [`Store::reopen_tiles`] and
    /// [`Store::invalidate_tiles`] leave it. If `to` ends the job, `at_ms` becomes the time of its end.
    fn set_job_state(
        &self,
        job: JobId,
        from: &[JobPhase],
        to: JobState,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError>;

    /// Ends a queued or running job with its result. All tiles of the job must be done or set aside.
    ///
    /// The same result is accepted again. Another result is rejected.
    fn finish_job(
        &self,
        job: JobId,
        result: Digest,
        bytes: u64,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError>;

    /// Reopens failed tiles for another attempt, and returns the number of reopened tiles.
    ///
    /// Tiles that were set aside become open, and the failures of open tiles are removed. A job is queued
    /// again if it failed, was cancelled, or is done with tiles that were set aside. Done tiles stay done.
    fn reopen_tiles(&self, job: JobId) -> Result<u32, StoreError>;

    /// Records that another worker computed a done tile again with the same `digest`.
    ///
    /// If the tile's output now has another digest, the call has no effect.
    fn confirm_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        check: TileCheck,
    ) -> Result<(), StoreError>;

    /// Reopens tiles whose results or placeholders are no longer trusted, and returns the number of reopened
    /// tiles.
    ///
    /// A done job is queued again with all its tiles open.
    fn invalidate_tiles(&self, job: JobId, tiles: &[TileIndex]) -> Result<u32, StoreError>;

    /// Quarantines a worker, so that it gets no tiles. If the worker is already quarantined, the first reason
    /// stays.
    fn quarantine(&self, record: QuarantineRecord) -> Result<(), StoreError>;

    /// Ends the quarantine of a worker. Returns true if the worker was quarantined.
    fn release(&self, worker: &str) -> Result<bool, StoreError>;

    /// Records the clocks of retention. The stamp replaces the previous one.
    fn stamp_retention(&self, stamp: RetentionStamp) -> Result<(), StoreError>;

    /// Removes a scene that no job references, and returns its record. The caller can then remove the blob.
    fn delete_scene(&self, scene: Digest) -> Result<SceneRecord, StoreError>;

    /// Imports entries of another store, a few hundred per call. With `first`, the store must contain no
    /// scenes and no jobs.
    fn import(&self, entries: Vec<Entry>, first: bool) -> Result<(), StoreError>;

    /// Reports the duration of each later durable write to `to`. Only the first call has an effect.
    fn report_syncs(&self, to: Report);

    /// Begins the next epoch and returns it. A coordinator calls this once at each start.
    fn begin_epoch(&self) -> Result<u64, StoreError>;

    /// Removes an ended job, its tiles and its request ids, and returns its record.
    ///
    /// The caller can then remove the blobs. The id of the job is never reused.
    fn delete_job(&self, job: JobId) -> Result<JobRecord, StoreError>;
}
