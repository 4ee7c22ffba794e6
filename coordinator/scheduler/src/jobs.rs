//! Transitions of jobs: added, changed and ended jobs, the grace after a restart, and rejected store
//! commands.

use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_records::ids::{Digest, Epoch, JobId, Lease, LeaseId, TileIndex, WorkerId};
use sightline_records::{JobPhase, JobRecord, TileStats};

use super::event::{Effect, Note, StoreCommand};
use super::job::{OpenJob, Output};
use super::messages::Now;
use super::queue::User;
use super::state::{SPACE_EVERY, Scheduler, Timer};

/// Grace after a restart, in milliseconds. During the grace, tiles of jobs that ran are not leased to other
/// workers. Every living worker returns within this time, because an attempt to connect and the wait before
/// the next attempt each take at most one second.
pub(super) const GRACE: u64 = 2500;

impl Scheduler {
    /// Adds a job with the recorded states of its tiles.
    pub(super) fn take_up(&mut self, mut job: OpenJob, now: Now) {
        let id = job.record.id;
        if job.grace {
            let until = now.ms + GRACE;
            self.leases.graces.insert(id, until);
            self.set_timer(until, Timer::Grace(id));
        }
        // A job that is added again during its grace keeps the grace: workers may still hold its earlier
        // leases.
        job.grace = self.leases.graces.contains_key(&id) && self.only.is_none();
        if self.jobs.contains_key(&id) {
            self.drop_job(id);
        }
        job.counts_from = self.first_that_counts(&job);
        self.open_account(&job.key.user);
        let unchecked = std::mem::take(&mut job.unchecked);
        self.jobs.insert(id, job);
        for (tile, digest) in unchecked {
            self.draw(id, tile, digest);
        }
        self.set_orphans_aside(id);
        self.list_job(id);
        self.assemble_if_complete(id);
        self.tell_watchers(id);
    }

    /// Sets aside the open tiles that need a tile that was set aside.
    ///
    /// A late output can replace the placeholder of a dependent tile. An invalidation then reopens the
    /// dependent tile while the needed tile is still set aside.
    fn set_orphans_aside(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let aside = |tile: &TileIndex| matches!(job.tiles[tile.at()].output, Output::SetAside(_));
        let lost = job
            .indices()
            .filter(aside)
            .flat_map(|tile| job.lost_with(tile));
        let orphans: BTreeSet<TileIndex> =
            lost.filter(|tile| !job.tiles[tile.at()].judged).collect();
        let tiles: Vec<TileIndex> = orphans.into_iter().rev().collect();
        if tiles.is_empty() {
            return;
        }
        for tile in &tiles {
            job.tiles[tile.at()].judged = true;
            job.update_ready(*tile);
        }
        let (planned, reason) = (
            Arc::clone(&job.planned),
            "a tile that this tile needs was set aside".to_owned(),
        );
        self.effects.push(Effect::Run(StoreCommand::SetAside {
            job: id,
            planned,
            tiles,
            reason,
        }));
    }

    /// Returns the first lease that counts for a job that is being added.
    ///
    /// If the job's tiles were reopened in this epoch, it is the next lease. If they were reopened in an
    /// earlier epoch, it is the first lease of the following epoch.
    fn first_that_counts(&self, job: &OpenJob) -> LeaseId {
        let epoch = self.settings.epoch;
        match job.record.reopened_epoch {
            Some(reopened) if reopened >= epoch.0 => LeaseId {
                epoch,
                number: self.leases.count + 1,
            },
            Some(reopened) => LeaseId {
                epoch: Epoch(reopened + 1),
                number: 0,
            },
            None => job.counts_from,
        }
    }

    /// Restricts leases to the tiles of one job. Ends the job's grace, because its earlier workers were
    /// threads of a process that has ended.
    pub(super) fn restrict(&mut self, only: JobId) {
        self.only = Some(only);
        let ids = self.job_ids();
        ids.into_iter().for_each(|id| self.list_job(id));
        self.end_grace(only);
    }

    /// Ends the grace of a job: tiles that no worker has claimed can be leased.
    pub(super) fn end_grace(&mut self, id: JobId) {
        self.leases.graces.remove(&id);
        let Some(job) = self.jobs.get_mut(&id).filter(|j| j.grace) else {
            return;
        };
        job.grace = false;
        let free = job.ready.len();
        self.note(Note::GraceOver(id, free));
        self.list_job(id);
    }

    /// Updates a job to its current record in the store.
    pub(super) fn job_changed(&mut self, record: JobRecord) {
        let id = record.id;
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let phase = record.state.phase();
        let priority = Reverse(record.priority);
        if job.key.priority != priority {
            self.prioritize(id, priority);
        }
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        if job.record.state.phase() == JobPhase::Paused && phase != JobPhase::Paused {
            let user = User::clone(&job.key.user);
            self.catch_up(&user);
        }
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        job.record = record;
        job.pending = false;
        if phase.ended() {
            // Only an ended job loses these entries. For a job that is added again, the store may still
            // execute the commands.
            self.deaths.recording.retain(|(job, ..), _| *job != id);
            self.drop_job(id);
            return;
        }
        if phase == JobPhase::Paused {
            job.pace.forget();
            self.rest(id);
        }
        self.list_job(id);
        self.assemble_if_complete(id);
        self.tell_watchers(id);
    }

    /// Pauses a job: workers finish the tiles that they have begun, without helpers, and return the other
    /// tiles.
    fn rest(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let leases: Vec<LeaseId> = job.tiles.iter().flat_map(|t| t.leases).flatten().collect();
        for lease in leases {
            match self
                .leases
                .table
                .get(&lease)
                .is_some_and(|l| l.begun.is_some())
            {
                true => self.crew_closed(lease),
                false => self.end_lease(lease, true),
            }
        }
    }

    /// Revokes the leases of a paused job.
    pub(super) fn stop_now(&mut self, id: JobId) {
        if self
            .jobs
            .get(&id)
            .is_some_and(|job| job.record.state.phase() == JobPhase::Paused)
        {
            self.revoke_job(id);
            self.tell_watchers(id);
        }
    }

    /// Changes the priority of a job and reorders its queue entries.
    fn prioritize(&mut self, id: JobId, priority: Reverse<i32>) {
        self.unlist_job(id);
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let leases: Vec<LeaseId> = job.tiles.iter().flat_map(|t| t.leases).flatten().collect();
        leases.iter().for_each(|lease| self.stop_waiting(*lease));
        if let Some(job) = self.jobs.get_mut(&id) {
            job.key.priority = priority;
        }
        let held = |id: &LeaseId| {
            self.leases
                .table
                .get(id)
                .filter(|l| l.gone.is_none())
                .map(|l| l.worker)
        };
        let workers: Vec<WorkerId> = leases.iter().filter_map(held).collect();
        workers.into_iter().for_each(|worker| self.line_up(worker));
        leases
            .into_iter()
            .for_each(|lease| self.move_crew(lease, priority));
    }

    /// Records an output that the store has committed.
    pub(super) fn committed(&mut self, lease: &Lease, digest: Digest, stats: &TileStats, now: Now) {
        let worker = self.leases.table.get(&lease.id).map(|l| l.worker);
        let Some(job) = self.jobs.get_mut(&lease.job) else {
            return;
        };
        if lease.tile.at() >= job.tiles.len() {
            return;
        }
        if job.complete(lease.tile, digest, stats) {
            job.tiles[lease.tile.at()].author = stats.worker.as_str().into();
            if let Some(worker) = worker.and_then(|id| self.roster.workers.get_mut(&id)) {
                worker.done.add(stats);
            }
            self.draw(lease.job, lease.tile, digest);
        }
        let Some(job) = self.jobs.get(&lease.job) else {
            return;
        };
        // Other workers need not continue with the tile; the sender of the output needs no command to stop.
        for id in job.tiles[lease.tile.at()].leases.into_iter().flatten() {
            self.end_lease(id, id != lease.id);
        }
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.mark_pace(now);
        }
        self.list_job(lease.job);
        self.assemble_if_complete(lease.job);
        self.tell_watchers(lease.job);
    }

    /// Records the placeholder of a tile.
    pub(super) fn tile_set_aside(&mut self, id: JobId, tile: TileIndex, digest: Digest) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        if tile.at() >= job.tiles.len() {
            return;
        }
        job.give_up(tile, digest);
        for lease in job.tiles[tile.at()].leases.into_iter().flatten() {
            self.end_lease(lease, true);
        }
        self.list_job(id);
        self.assemble_if_complete(id);
        self.tell_watchers(id);
    }

    /// Delays the assembly of a result and pauses leasing, because the disk has no space for further outputs.
    pub(super) fn assembly_waits(&mut self, id: JobId, now: Now) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.assembling = false;
            job.no_space_until = Some(now.ms + SPACE_EVERY);
            self.set_timer(now.ms + SPACE_EVERY, Timer::Space(id));
        }
        self.pause_leasing(now);
    }

    /// Records that an output waits for space. Its tile is finished, so it does not count as stuck.
    pub(super) fn disk_full(&mut self, lease: &Lease, now: Now) {
        if let Some(l) = self.leases.table.get_mut(&lease.id) {
            l.moved = now.ms;
        }
        self.pause_leasing(now);
    }

    /// Handles a command that the store rejected: restores the previous state and pauses leasing.
    pub(super) fn refused(&mut self, command: StoreCommand, now: Now) {
        let id = match command {
            StoreCommand::Bind(id, _) | StoreCommand::Start(id) | StoreCommand::FailJob(id, _) => {
                if let Some(job) = self.jobs.get_mut(&id) {
                    job.pending = false;
                }
                id
            }
            StoreCommand::Fail { job: id, tile, .. } => {
                self.unjudge(id, tile, now);
                id
            }
            StoreCommand::CountDeath {
                job: id,
                tile,
                worker,
                ..
            } => {
                self.deaths.recording.remove(&(id, tile, worker));
                self.unjudge(id, tile, now);
                id
            }
            // The store keeps one failure too many for the tile.
            StoreCommand::CancelDeath { job: id, .. } => id,
            // Without the recorded confirmation, a later quarantine reopens more tiles than necessary.
            StoreCommand::Confirm { job: id, .. } => id,
            StoreCommand::Quarantine { .. } => {
                self.trust.refused.push(command);
                self.pause_leasing(now);
                return;
            }
            StoreCommand::SetAside { job: id, tiles, .. } => {
                for tile in tiles {
                    self.unjudge(id, tile, now);
                }
                id
            }
        };
        self.pause_leasing(now);
        self.list_job(id);
    }

    /// Ends the wait for a decision on a tile that is still open.
    fn unjudge(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job.tiles.get_mut(tile.at()) else {
            return;
        };
        if std::mem::take(&mut t.judged) && t.output == Output::Open {
            if t.missing > 0 {
                // Only another command ends this tile's wait, which becomes longer each time.
                t.faults = t.faults.saturating_add(1);
            }
            self.back_off(id, tile, now);
        }
    }

    /// Sets aside an open tile without a delay if a tile that it needs was set aside.
    pub(super) fn set_orphan_aside(&mut self, id: JobId, tile: TileIndex) {
        let waits = |t: &super::job::Tile| t.missing == 0 || t.judged || t.not_before.is_some();
        let tile = self.jobs.get(&id).and_then(|job| job.tiles.get(tile.at()));
        if tile.is_some_and(|t| t.output == Output::Open && !waits(t)) {
            self.set_orphans_aside(id);
        }
    }

    /// Requests that the store ends a job as failed, for this reason.
    pub(super) fn fail_job(&mut self, id: JobId, reason: String) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.pending = true;
            self.effects
                .push(Effect::Run(StoreCommand::FailJob(id, reason)));
        }
    }
}
