//! The implementation of [`Store`] for every [`Engine`], which reads a table and makes decisions durable.
//!
//! The stores differ only in the location of their table and in the way they make a change durable. The
//! commands have one implementation here; `rules.rs` contains their rules.

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, QuarantineRecord, RetentionStamp,
    SceneRecord, Submitted, TileCheck, TileRecord, TileResult,
};

use super::api::{Queries, Report, Store};
use super::entries::{self, Entry};
use super::error::StoreError;
use super::identity::StoreIdentity;
use super::rules::{self, Decision};
use super::table::View;
use super::upkeep;

/// A storage back end: reads a table and executes decisions durably.
pub(super) trait Engine: Send + Sync {
    /// Answers a query from the durable state.
    fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError>;

    /// Returns the error with which every write would fail, as far as it is known without a write.
    fn writable(&self) -> Result<(), StoreError> {
        Ok(())
    }

    /// Reports the duration of durable writes, as [`Store::report_syncs`]. A table without a disk reports no
    /// durations.
    fn report_syncs(&self, _to: Report) {}

    /// Decides, makes the event durable and applies it as one atomic step. Then returns the answer.
    fn command<A: Send + 'static>(
        &self,
        decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
    ) -> Result<A, StoreError>;
}

impl<E: Engine> Queries for E {
    fn scene(&self, digest: &Digest) -> Result<Option<SceneRecord>, StoreError> {
        self.query(|view| view.scene(digest))
    }
    fn scenes(&self) -> Result<Vec<SceneRecord>, StoreError> {
        self.query(|view| view.scenes())
    }
    fn job(&self, job: JobId) -> Result<Option<JobRecord>, StoreError> {
        self.query(|view| view.job(job))
    }
    fn jobs(&self) -> Result<Vec<JobRecord>, StoreError> {
        self.query(|view| view.jobs())
    }
    fn jobs_before(
        &self,
        before: JobId,
        most: usize,
    ) -> Result<(Vec<JobRecord>, bool), StoreError> {
        self.query(|view| view.jobs_before(before, most))
    }
    fn job_by_key(&self, key: &Digest) -> Result<Option<JobRecord>, StoreError> {
        self.query(|view| view.job_by_key(key))
    }
    fn job_by_request(&self, request_id: &str) -> Result<Option<JobRecord>, StoreError> {
        self.query(|view| view.job_by_request(request_id))
    }
    fn tiles(&self, job: JobId) -> Result<Vec<TileRecord>, StoreError> {
        self.query(|view| view.tiles(job))
    }
    fn tile(&self, job: JobId, tile: TileIndex) -> Result<TileRecord, StoreError> {
        self.query(|view| Ok(view.job_and_tile(job, tile)?.1))
    }
    fn epoch(&self) -> Result<u64, StoreError> {
        self.query(|view| view.epoch())
    }
    fn may_change(&self) -> Result<(), StoreError> {
        self.writable()?;
        self.command(|_| {
            Ok(Decision {
                event: None,
                answer: (),
            })
        })
    }
    fn quarantined(&self) -> Result<Vec<QuarantineRecord>, StoreError> {
        self.query(|view| view.quarantined())
    }
    fn retention_stamp(&self) -> Result<Option<RetentionStamp>, StoreError> {
        self.query(|view| view.retention_stamp())
    }
    fn entries(&self) -> Result<Vec<Entry>, StoreError> {
        self.query(entries::all)
    }
}

impl<E: Engine> Store for E {
    fn identity(&self) -> Result<StoreIdentity, StoreError> {
        if let Some(known) = self.query(|view| view.identity())? {
            return Ok(known);
        }
        let fresh = StoreIdentity::random()?;
        self.command(move |view| upkeep::identify(view, fresh))
    }
    fn record_scene(&self, scene: SceneRecord) -> Result<(), StoreError> {
        self.command(|view| rules::record_scene(view, scene))
    }
    fn submit_job(&self, job: NewJob) -> Result<Submitted, StoreError> {
        self.command(|view| rules::submit_job(view, job))
    }
    fn prioritize_job(&self, job: JobId, priority: i32) -> Result<JobRecord, StoreError> {
        self.command(move |view| rules::prioritize_job(view, job, priority))
    }
    fn plan_job(&self, job: JobId, tiles: u32) -> Result<JobRecord, StoreError> {
        self.command(move |view| rules::plan_job(view, job, tiles))
    }
    fn bind_profile(&self, job: JobId, profile: &str) -> Result<String, StoreError> {
        let profile = profile.to_owned();
        self.command(move |view| rules::bind_profile(view, job, profile))
    }
    fn commit_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        result: TileResult,
    ) -> Result<CommitOutcome, StoreError> {
        self.command(move |view| rules::commit_tile(view, job, tile, result))
    }
    fn fail_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        let (worker, reason) = (worker.to_owned(), reason.to_owned());
        self.command(move |view| rules::fail_tile(view, job, tile, worker, &reason))
    }
    fn count_death(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<u32, StoreError> {
        let (worker, reason) = (worker.to_owned(), reason.to_owned());
        self.command(move |view| rules::count_death(view, job, tile, worker, &reason))
    }
    fn forget_failure(
        &self,
        job: JobId,
        tile: TileIndex,
        worker: &str,
        reason: &str,
    ) -> Result<(), StoreError> {
        let (worker, reason) = (worker.to_owned(), reason.to_owned());
        self.command(move |view| rules::forget_failure(view, job, tile, &worker, &reason))
    }
    fn set_aside_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        bytes: u64,
        reasons: &[String],
    ) -> Result<(), StoreError> {
        let reasons = reasons.to_vec();
        self.command(move |view| rules::set_aside_tile(view, job, tile, digest, bytes, &reasons))
    }
    fn set_job_state(
        &self,
        job: JobId,
        from: &[JobPhase],
        to: JobState,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError> {
        let from = from.to_vec();
        self.command(move |view| rules::set_job_state(view, job, &from, to, at_ms))
    }
    fn finish_job(
        &self,
        job: JobId,
        result: Digest,
        bytes: u64,
        at_ms: u64,
    ) -> Result<JobRecord, StoreError> {
        self.command(move |view| rules::finish_job(view, job, result, bytes, at_ms))
    }
    fn reopen_tiles(&self, job: JobId) -> Result<u32, StoreError> {
        self.command(move |view| rules::reopen_tiles(view, job))
    }
    fn confirm_tile(
        &self,
        job: JobId,
        tile: TileIndex,
        digest: Digest,
        check: TileCheck,
    ) -> Result<(), StoreError> {
        self.command(move |view| upkeep::confirm_tile(view, job, tile, digest, check))
    }
    fn invalidate_tiles(&self, job: JobId, tiles: &[TileIndex]) -> Result<u32, StoreError> {
        let tiles = tiles.to_vec();
        self.command(move |view| upkeep::invalidate_tiles(view, job, &tiles))
    }
    fn quarantine(&self, record: QuarantineRecord) -> Result<(), StoreError> {
        self.command(move |view| upkeep::quarantine(view, record))
    }
    fn release(&self, worker: &str) -> Result<bool, StoreError> {
        let worker = worker.to_owned();
        self.command(move |view| upkeep::release(view, worker))
    }
    fn stamp_retention(&self, stamp: RetentionStamp) -> Result<(), StoreError> {
        self.command(move |view| rules::stamp_retention(view, stamp))
    }
    fn delete_scene(&self, scene: Digest) -> Result<SceneRecord, StoreError> {
        self.command(move |view| upkeep::delete_scene(view, scene))
    }
    fn import(&self, entries: Vec<Entry>, first: bool) -> Result<(), StoreError> {
        self.command(move |view| upkeep::import(view, entries, first))
    }
    fn report_syncs(&self, to: Report) {
        Engine::report_syncs(self, to);
    }
    fn begin_epoch(&self) -> Result<u64, StoreError> {
        self.command(rules::begin_epoch)
    }
    fn delete_job(&self, job: JobId) -> Result<JobRecord, StoreError> {
        self.command(move |view| rules::delete_job(view, job))
    }
}
