//! Helpers of crews.
//!
//! Workers without a tile help the leaders of running tiles until they get a tile or the crew ends.
//!
//! Crews of higher priority come first. Within a priority, helpers are spread evenly over the users and over
//! each user's crews. A helper moves to another crew if that makes the spread more even. The number of
//! helpers per crew is limited.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use sightline_records::ids::{Lease, LeaseId, WorkerId};

use super::crew::Crew;
use super::event::Effect;
use super::messages::{Help, Now, WorkerCommand};
use super::pools::Profile;
use super::spot_check::Name;
use super::state::Scheduler;

impl Scheduler {
    /// Returns true if a tile is leased under this lease.
    pub fn is_leased(&self, lease: &Lease) -> bool {
        self.leases
            .table
            .get(&lease.id)
            .is_some_and(|l| (l.job, l.tile) == (lease.job, lease.tile))
    }

    /// Returns true if this lease is the check of a done tile.
    pub fn is_check(&self, lease: &Lease) -> bool {
        self.leases.table.get(&lease.id).is_some_and(|l| l.checks)
    }

    /// Opens a crew, because the holder of a lease can use helpers from now on.
    pub(super) fn crew_opened(&mut self, lease: Lease) {
        if !self.is_leased(&lease) || self.queues.crews.contains_key(&lease.id) {
            return;
        }
        let Some(profile) = self
            .leases
            .table
            .get(&lease.id)
            .map(|l| Profile::clone(&l.profile))
        else {
            return;
        };
        // The worker must compute a check without helpers.
        if self.leases.table.get(&lease.id).is_some_and(|l| l.checks) {
            return;
        }
        self.note_hand(&lease);
        // A paused job gets no helpers.
        let runs = self.jobs.get(&lease.job).filter(|job| job.runs());
        let Some(key) = runs.map(|job| job.key.clone()) else {
            return;
        };
        let share = self.share(&key.user);
        let pool = self.queues.pools.at(&profile);
        pool.crews.insert(&key, share, (0, lease.id));
        pool.crew_count += 1;
        self.queues.crews.insert(
            lease.id,
            Crew {
                lease,
                profile,
                key,
                helpers: BTreeMap::new(),
            },
        );
    }

    /// Closes a crew, because the holder of a lease can no longer use helpers.
    pub(super) fn crew_closed(&mut self, id: LeaseId) {
        if let Some(crew) = self.queues.crews.remove(&id) {
            let share = self.share(&crew.key.user);
            let pool = self.queues.pools.at(&crew.profile);
            pool.crews
                .remove(&crew.key, share, &(crew.helpers.len(), id));
            pool.crew_count -= 1;
            // If the leader hangs, only the coordinator can stop the helpers.
            for (helper, since) in crew.helpers {
                self.effects
                    .push(Effect::Tell(helper, WorkerCommand::Revoke(crew.lease)));
                self.discharge(crew.lease.job, since);
            }
            self.queues.pools.tidy(&crew.profile);
        }
    }

    /// Records that a worker no longer helps the holder of a lease.
    pub(super) fn helped(&mut self, worker: WorkerId, lease: &Lease) {
        let Some(w) = self
            .roster
            .workers
            .get_mut(&worker)
            .filter(|w| w.helps == Some(*lease))
        else {
            return;
        };
        w.helps = None;
        self.has_left(lease.id, worker);
        self.list_worker(worker);
    }

    /// Removes a helper from a crew.
    pub(super) fn has_left(&mut self, id: LeaseId, worker: WorkerId) {
        let Some(crew) = self.queues.crews.get_mut(&id) else {
            return;
        };
        let Some(since) = crew.helpers.remove(&worker) else {
            return;
        };
        let (job, now) = (crew.lease.job, crew.helpers.len());
        self.recount(id, now + 1, now);
        self.discharge(job, since);
    }

    /// Adds a helper to a crew.
    fn has_come(&mut self, id: LeaseId, worker: WorkerId) {
        let clock = self.time.clock;
        let Some(crew) = self.queues.crews.get_mut(&id) else {
            return;
        };
        crew.helpers.insert(worker, clock);
        let (lease, now) = (crew.lease, crew.helpers.len());
        self.recount(id, now - 1, now);
        self.charge(lease.job);
        self.note_hands(&lease, worker);
    }

    /// Records the leader of a crew as a contributor, because other workers may continue from its outcomes.
    fn note_hand(&mut self, lease: &Lease) {
        if let Some(worker) = self.leases.table.get(&lease.id).map(|l| l.worker) {
            self.note_hands(lease, worker);
        }
    }

    fn note_hands(&mut self, lease: &Lease, worker: WorkerId) {
        let Some(name) = self
            .roster
            .workers
            .get(&worker)
            .map(|w| Name::clone(&w.signature))
        else {
            return;
        };
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.tiles[lease.tile.at()].contributors.insert(name);
        }
    }

    /// Moves a crew in its list, because the priority of its job has changed.
    pub(super) fn move_crew(&mut self, id: LeaseId, to: Reverse<i32>) {
        let Some(crew) = self.queues.crews.get_mut(&id) else {
            return;
        };
        let from = crew.key.clone();
        crew.key.priority = to;
        let (key, entry) = (crew.key.clone(), (crew.helpers.len(), id));
        let profile = Profile::clone(&crew.profile);
        let share = self.share(&from.user);
        let crews = &mut self.queues.pools.at(&profile).crews;
        crews.remove(&from, share, &entry);
        crews.insert(&key, share, entry);
    }

    /// Moves a crew in its list, because its number of helpers has changed.
    fn recount(&mut self, id: LeaseId, from: usize, to: usize) {
        let Some(crew) = self.queues.crews.get(&id) else {
            return;
        };
        let share = self.share(&crew.key.user);
        let crews = &mut self.queues.pools.at(&crew.profile).crews;
        crews.remove(&crew.key, share, &(from, id));
        crews.insert(&crew.key, share, (to, id));
    }

    /// Removes a worker from a crew. The help command could not be sent, because the worker does not read its
    /// stream. The scheduler sends no further commands to the worker for a while.
    pub(super) fn help_undelivered(&mut self, worker: WorkerId, lease: &Lease, now: Now) {
        // Mark the worker as unable to receive first; otherwise it would be sent again at once.
        self.backpressure(worker, now);
        self.helped(worker, lease);
    }

    /// Sends a worker without a tile, or a helper of another crew, to the next crew in order. Returns true if
    /// a worker was sent.
    pub(super) fn send_helper(&mut self, profile: &Profile) -> bool {
        let Some(pool) = self.queues.pools.by_profile.get(profile) else {
            return false;
        };
        let Some((_, (_, id))) = pool.crew_with_room() else {
            return false;
        };
        let free = pool.helpers.first().copied();
        let Some(worker) = free.or_else(|| self.may_move(profile)) else {
            return false;
        };
        if let Some(earlier) = self.roster.workers.get(&worker).and_then(|w| w.helps) {
            self.effects
                .push(Effect::Tell(worker, WorkerCommand::Revoke(earlier)));
            self.has_left(earlier.id, worker);
        }
        let Some(lease) = self.queues.crews.get(&id).map(|crew| crew.lease) else {
            return false;
        };
        let Some(job) = self.jobs.get(&lease.job) else {
            return false;
        };
        let help = Help {
            lease,
            planned: std::sync::Arc::clone(&job.planned),
            profile: profile.to_string(),
        };
        self.effects
            .push(Effect::Tell(worker, WorkerCommand::Help(Box::new(help))));
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            w.helps = Some(lease);
        }
        self.has_come(id, worker);
        self.list_worker(worker);
        true
    }

    /// Returns a helper that may move to the next crew in order, because that crew needs it more.
    ///
    /// The next crew needs the helper more than the present crew of the helper in three cases. The next crew
    /// has a higher priority, or its user has at least two workers less than the user of the present crew. Or
    /// both crews have the same user, and the next crew has at least two helpers less.
    fn may_move(&self, profile: &Profile) -> Option<WorkerId> {
        let pool = self.queues.pools.by_profile.get(profile)?;
        let (needs, (few, _)) = pool.crew_with_room()?;
        let (has, &(many, id)) = pool.crews.richest(|(helpers, _)| *helpers > 0)?;
        let more = if has.0 != needs.0 {
            has.0 > needs.0
        } else if has.2 != needs.2 {
            has.1.workers >= needs.1.workers + 2
        } else {
            many >= few + 2
        };
        if !more {
            return None;
        }
        // A helper that was called back for a tile already leaves its crew.
        let helpers = &self.queues.crews.get(&id)?.helpers;
        let stays = |w: &&WorkerId| {
            self.roster
                .workers
                .get(w)
                .is_some_and(|w| w.leases.is_empty() && !w.draining)
        };
        helpers.keys().rev().find(stays).copied()
    }

    /// Calls a worker back from the crew that it helps, because it gets a tile.
    pub(super) fn call_back(&mut self, worker: WorkerId) {
        if let Some(lease) = self.roster.workers.get(&worker).and_then(|w| w.helps) {
            self.effects
                .push(Effect::Tell(worker, WorkerCommand::Revoke(lease)));
        }
    }
}
