//! The trait of a store: the queries and commands that the coordinator's state consists of.

use std::time::Duration;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, RetentionStamp,
    SceneRecord, Submitted, TileCheck, TileRecord, TileResult,
};

use super::entries::Entry;
use super::error::StoreError;
use super::identity::StoreIdentity;

/// Is told how long a durable write took.
pub type Report = Box<dyn Fn(Duration) + Send + Sync>;

/// The queries of a store, which have no effect on it.
pub trait Queries: Send + Sync {
    /// The scene with this digest, if it was recorded.
    fn scene(&self, digest: &Digest) -> Result<Option<SceneRecord>, StoreError>;

    /// All scenes, ascending by digest.
    fn scenes(&self) -> Result<Vec<SceneRecord>, StoreError>;

    /// One job.
    fn job(&self, job: JobId) -> Result<Option<JobRecord>, StoreError>;

    /// The newest `most` jobs whose ids are below `before`, ascending by id, and whether there are older
    /// ones.
    fn jobs_before(&self, before: JobId, most: usize)
    -> Result<(Vec<JobRecord>, bool), StoreError>;

    /// All jobs, ascending by id, which is the order they were submitted in.
    fn jobs(&self) -> Result<Vec<JobRecord>, StoreError>;

    /// The newest job with this key, whatever its state.
    fn job_by_key(&self, key: &Digest) -> Result<Option<JobRecord>, StoreError>;

    /// The job that answered the submission with this request id (its own or one it was joined to).
    fn job_by_request(&self, request_id: &str) -> Result<Option<JobRecord>, StoreError>;

    /// All tiles of a job, `0..job.tiles`; a tile without a record is open.
    fn tiles(&self, job: JobId) -> Result<Vec<TileRecord>, StoreError>;

    /// One tile of a job.
    fn tile(&self, job: JobId, tile: TileIndex) -> Result<TileRecord, StoreError>;

    /// Whether a command would be carried out now. Of a store that several coordinators share: whether this
    /// one still leads. Changes nothing.
    fn may_change(&self) -> Result<(), StoreError>;

    /// The epoch begun last; 0 before the first.
    fn epoch(&self) -> Result<u64, StoreError>;

    /// Returns the workers that get no tiles, by name.
    fn quarantined(&self) -> Result<Vec<QuarantineRecord>, StoreError>;

    /// Returns the last stamp of the clocks of retention, or `None` before the first.
    fn retention_stamp(&self) -> Result<Option<RetentionStamp>, StoreError>;

    /// Returns all entries, ascending by key.
    fn entries(&self) -> Result<Vec<Entry>, StoreError>;
}

/// The coordinator's persistent state.
///
/// Every command is one transaction, durable when it returns `Ok`. A command that returns an error changed
/// nothing, with one exception named at [`StoreError::Journal`]. Commands may be called from many threads;
/// those in flight together share one disk sync.
pub trait Store: Queries {
    /// Returns the identity of the store. The first call draws one and records it.
    fn identity(&self) -> Result<StoreIdentity, StoreError>;

    /// Records a scene. The same record again is accepted; another record under the same digest is refused.
    fn record_scene(&self, scene: SceneRecord) -> Result<(), StoreError>;

    /// Records a job, or returns the existing job that answers the submission: the job this `request_id` was
    /// answered by before, else the newest job of the same key unless that one failed or was cancelled. The
    /// same `request_id` with another key is refused, and so is a scene that was not recorded.
    fn submit_job(&self, job: NewJob) -> Result<Submitted, StoreError>;

    /// Gives a job that has not ended another priority.
    fn prioritize_job(&self, job: JobId, priority: i32) -> Result<JobRecord, StoreError>;

    /// Sets the number of tiles of a job submitted with `tiles: 0`, once its plan is known.
    /// The same number again is accepted; another one is refused.
    fn plan_job(&self, job: JobId, tiles: u32) -> Result<JobRecord, StoreError>;

    /// Binds a job to a numerics profile. The first profile wins; returns the profile that the job is bound
    /// to.
    fn bind_profile(&self, job: JobId, profile: &str) -> Result<String, StoreError>;

    /// Commits a tile's result and marks the tile as done. A late result for a tile that was set aside
    /// replaces its stand-in. A different digest for a tile that is done is kept out and counted.
    fn commit_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        result: TileResult,
    ) -> Result<CommitOutcome, StoreError>;

    /// Records that a tile failed on a worker; returns the number of different workers on which it has failed
    /// (counted up to a limit). Nothing changes if the tile is no longer open or the job has ended.
    fn fail_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError>;

    /// Records the death of a worker as [`Store::fail_tile`] records a failure. A recorded failure of the
    /// worker stays, so that [`Store::forget_failure`] of this death does not remove it.
    fn count_death(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError>;

    /// Forgets the failure of an open tile on a worker, if its last reason is this one.
    fn forget_failure(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<(), StoreError>;

    /// Sets an open tile aside: `digest` names the stand-in ("all visible") shipped for it.
    /// The same call again is accepted; a tile that is done stays done ([`StoreError::TileNotOpen`]).
    fn set_aside_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        bytes: u64,
        reasons: &[String],
    ) -> Result<(), StoreError>;

    /// Moves a job to another state if it is in one of `from`; a job that is in `to` stays as it is.
    /// `Done` is reached through [`Store::finish_job`] alone, and left through [`Store::reopen_tiles`] alone.
    /// `at_ms` is kept as the time of the end if `to` ends the job.
    fn set_job_state(
        &self,
        job: JobId,
        from: &[JobPhase],
        to: JobState,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError>;

    /// Ends a queued or running job with its result, all of whose tiles must be done or set aside.
    /// The same result again is accepted; another one is refused.
    fn finish_job(
        &self,
        job: JobId,
        result: Digest,
        bytes: u64,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError>;

    /// Retries failed tiles: tiles set aside are open again, failures of open tiles are forgotten, and a job
    /// that failed, was cancelled, or is done with tiles set aside is queued. Done tiles stay done. Returns
    /// the number of reopened tiles.
    fn reopen_tiles(&self, job: JobId) -> Result<u32, StoreError>;

    /// Records that another worker has computed a done tile again, with the digest that it has. Nothing
    /// changes if the tile has another one by now.
    fn confirm_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        check: TileCheck,
    ) -> Result<(), StoreError>;

    /// Opens tiles again whose results or stand-ins are not believed any more; a done job is queued with all
    /// its tiles open. Returns the number of opened tiles.
    fn invalidate_tiles(&self, job: JobId, tiles: &[TileIndex]) -> Result<u32, StoreError>;

    /// Records that a worker gets no tiles any more; for one that gets none the first reason stays.
    fn quarantine(&self, record: QuarantineRecord) -> Result<(), StoreError>;

    /// Records that a worker gets tiles again; returns whether it had none.
    fn release(&self, worker: &str) -> Result<bool, StoreError>;

    /// Records a stamp of the clocks of retention, which replaces the previous one.
    fn stamp_retention(&self, stamp: RetentionStamp) -> Result<(), StoreError>;

    /// Removes a scene that no job names; returns its record, so that the caller can remove the blob.
    fn delete_scene(&self, scene: Digest) -> Result<SceneRecord, StoreError>;

    /// Takes over entries of another store, a few hundred at a time. The `first` ones need a store without
    /// scenes and jobs.
    fn import(&self, entries: Vec<Entry>, first: bool) -> Result<(), StoreError>;

    /// From now on reports how long each durable write took. Only the first call counts.
    fn report_syncs(&self, to: Report);

    /// Begins the next epoch (once at each start of a coordinator) and returns it.
    fn begin_epoch(&self) -> Result<u64, StoreError>;

    /// Removes an ended job, its tiles and its request ids; returns its record, so that the caller can remove
    /// the blobs. Its id is never used again.
    fn delete_job(&self, job: JobId) -> Result<JobRecord, StoreError>;
}
