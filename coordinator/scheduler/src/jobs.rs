//! Jobs come, change and end; the grace after a restart; what the store refuses.

use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_records::ids::{Digest, Epoch, JobId, Lease, LeaseId, TileIndex, WorkerId};
use sightline_records::{JobPhase, JobRecord, TileStats};

use super::event::{Effect, Note, StoreCommand};
use super::job::{Job, Output};
use super::messages::Now;
use super::queue::User;
use super::state::{SPACE_EVERY, Scheduler, Timer};

/// How long after a restart nobody else gets the tiles of jobs that ran: every worker that is still there
/// comes back within this time, because an attempt to connect takes a second at most, and so does the wait
/// before the next one.
pub(super) const GRACE: u64 = 2500;

impl Scheduler {
    /// Adds a job with the recorded states of its tiles.
    pub(super) fn take_up(&mut self, mut job: Job, now: Now) {
        let id = job.record.id;
        if job.grace {
            let until = now.ms + GRACE;
            self.graces.insert(id, until);
            self.set_timer(until, Timer::Grace(id));
        }
        // A job that ended and was taken up again is still in the hands of the same workers.
        job.grace = self.graces.contains_key(&id) && self.only.is_none();
        if self.jobs.contains_key(&id) {
            self.drop_job(id);
        }
        job.counts_from = self.first_that_counts(&job);
        self.open_account(&job.whom.user);
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

    /// Sets open tiles aside that need a tile which was set aside. A late output can replace the stand-in of
    /// such a tile, and an invalidation then opens it again without the tile that it needs.
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
        let (work, reason) = (
            Arc::clone(&job.work),
            "a tile that it needs was set aside".to_owned(),
        );
        self.effects.push(Effect::Run(StoreCommand::SetAside {
            job: id,
            work,
            tiles,
            reason,
        }));
    }

    /// The first lease that counts of a job that is taken up: one that is still to be given where its tiles
    /// were opened again in this epoch, else one of the epoch after that.
    fn first_that_counts(&self, job: &Job) -> LeaseId {
        let epoch = self.settings.epoch;
        match job.record.reopened_epoch {
            Some(reopened) if reopened >= epoch.0 => LeaseId {
                epoch,
                number: self.next_lease,
            },
            Some(reopened) => LeaseId {
                epoch: Epoch(reopened + 1),
                number: 0,
            },
            None => job.counts_from,
        }
    }

    /// From now on leases only tiles of one job. Its earlier workers were threads of a process that is gone,
    /// so nothing is waited for.
    pub(super) fn restrict(&mut self, only: JobId) {
        self.only = Some(only);
        let ids = self.job_ids();
        ids.into_iter().for_each(|id| self.list_job(id));
        self.end_grace(only);
    }

    /// After the grace the tiles that no worker has claimed are free.
    pub(super) fn end_grace(&mut self, id: JobId) {
        self.graces.remove(&id);
        let Some(job) = self.jobs.get_mut(&id).filter(|j| j.grace) else {
            return;
        };
        job.grace = false;
        let free = job.ready.len();
        self.note(Note::GraceOver(id, free));
        self.list_job(id);
    }

    /// Takes in a job's record as the store has it now.
    pub(super) fn job_changed(&mut self, record: JobRecord) {
        let id = record.id;
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let phase = record.state.phase();
        let priority = Reverse(record.priority);
        if job.whom.priority != priority {
            self.prioritize(id, priority);
        }
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        if job.record.state.phase() == JobPhase::Paused && phase != JobPhase::Paused {
            let user = User::clone(&job.whom.user);
            self.catch_up(&user);
        }
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        job.record = record;
        job.pending = false;
        if phase.ended() {
            // A job that is taken up again keeps them: their commands may still be under way.
            self.recording.retain(|(job, ..), _| *job != id);
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

    /// A job is paused: workers finish the tiles that they have begun, without help, and give others back.
    fn rest(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let leases: Vec<LeaseId> = job.tiles.iter().flat_map(|t| t.leases).flatten().collect();
        for lease in leases {
            match self.leases.get(&lease).is_some_and(|l| l.begun.is_some()) {
                true => self.crew_closed(lease),
                false => self.end_lease(lease, true),
            }
        }
    }

    /// Takes the tiles of a paused job back from their workers.
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

    /// A job gets another priority: it and what it has move to other places of the lists.
    fn prioritize(&mut self, id: JobId, priority: Reverse<i32>) {
        self.unlist_job(id);
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let leases: Vec<LeaseId> = job.tiles.iter().flat_map(|t| t.leases).flatten().collect();
        leases.iter().for_each(|lease| self.stop_waiting(*lease));
        if let Some(job) = self.jobs.get_mut(&id) {
            job.whom.priority = priority;
        }
        let held = |id: &LeaseId| {
            self.leases
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

    /// The store has an output of a tile.
    pub(super) fn committed(&mut self, lease: &Lease, digest: Digest, stats: &TileStats, now: Now) {
        let worker = self.leases.get(&lease.id).map(|l| l.worker);
        let Some(job) = self.jobs.get_mut(&lease.job) else {
            return;
        };
        if lease.tile.at() >= job.tiles.len() {
            return;
        }
        if job.complete(lease.tile, digest, stats) {
            job.tiles[lease.tile.at()].author = stats.worker.as_str().into();
            if let Some(worker) = worker.and_then(|id| self.workers.get_mut(&id)) {
                worker.done.add(stats);
            }
            self.draw(lease.job, lease.tile, digest);
        }
        let Some(job) = self.jobs.get(&lease.job) else {
            return;
        };
        // The others that work on it need not go on; its own worker knows.
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

    /// A tile has a stand-in.
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

    /// The result of a job cannot be written for now, so there is no space for further outputs either.
    pub(super) fn assembly_waits(&mut self, id: JobId, now: Now) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.assembling = false;
            job.no_space_until = Some(now.ms + SPACE_EVERY);
            self.set_timer(now.ms + SPACE_EVERY, Timer::Space(id));
        }
        self.pause_leasing(now);
    }

    /// An output waits for space. Its tile is finished, so it is not stuck, however long that takes.
    pub(super) fn disk_full(&mut self, lease: &Lease, now: Now) {
        if let Some(l) = self.leases.get_mut(&lease.id) {
            l.moved = now.ms;
        }
        self.pause_leasing(now);
    }

    /// The store refused a command. Whatever waited for it is as before, and no tiles are leased for a while.
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
                self.recording.remove(&(id, tile, worker));
                self.unjudge(id, tile, now);
                id
            }
            // The tile keeps a failure too many.
            StoreCommand::CancelDeath { job: id, .. } => id,
            // That nobody knows of the agreement makes later suspicions wider, and nothing wrong.
            StoreCommand::Confirm { job: id, .. } => id,
            StoreCommand::Quarantine { .. } => {
                self.unsaid.push(command);
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

    /// Ends the wait for a verdict on a tile that is still open.
    fn unjudge(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job.tiles.get_mut(tile.at()) else {
            return;
        };
        if std::mem::take(&mut t.judged) && t.output == Output::Open {
            if t.missing > 0 {
                // Nothing but another command ends its wait, which becomes longer each time.
                t.faults = t.faults.saturating_add(1);
            }
            self.back_off(id, tile, now);
        }
    }

    /// Sets a tile aside that waits for nothing although a tile that it needs was set aside.
    pub(super) fn set_orphan_aside(&mut self, id: JobId, tile: TileIndex) {
        let waits = |t: &super::job::Tile| t.missing == 0 || t.judged || t.not_before.is_some();
        let tile = self.jobs.get(&id).and_then(|job| job.tiles.get(tile.at()));
        if tile.is_some_and(|t| t.output == Output::Open && !waits(t)) {
            self.set_orphans_aside(id);
        }
    }

    /// Asks the store to end a job.
    pub(super) fn fail_job(&mut self, id: JobId, reason: String) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.pending = true;
            self.effects
                .push(Effect::Run(StoreCommand::FailJob(id, reason)));
        }
    }
}
