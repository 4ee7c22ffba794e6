//! Helpers: workers without a tile help the leaders of running tiles until they get a tile or the crew ends.
//!
//! Crews of higher priority come first. Among equals helpers are spread evenly over the users and over each
//! user's crews, and one moves to another crew when that makes the spread more even. A crew has a most.

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
    /// Whether a tile is leased under this lease.
    pub fn is_leased(&self, lease: &Lease) -> bool {
        self.leases
            .get(&lease.id)
            .is_some_and(|l| (l.job, l.tile) == (lease.job, lease.tile))
    }

    /// Whether a done tile is computed again under this lease, to be compared.
    pub fn is_check(&self, lease: &Lease) -> bool {
        self.leases.get(&lease.id).is_some_and(|l| l.checks)
    }

    /// The holder of a lease can use helpers from now on.
    pub(super) fn crew_opened(&mut self, lease: Lease) {
        if !self.is_leased(&lease) || self.crews.contains_key(&lease.id) {
            return;
        }
        let Some(profile) = self
            .leases
            .get(&lease.id)
            .map(|l| Profile::clone(&l.profile))
        else {
            return;
        };
        // A check has nobody else's hands in it.
        if self.leases.get(&lease.id).is_some_and(|l| l.checks) {
            return;
        }
        self.note_hand(&lease);
        // A paused job gets no help.
        let runs = self.jobs.get(&lease.job).filter(|job| job.runs());
        let Some(whom) = runs.map(|job| job.whom.clone()) else {
            return;
        };
        let share = self.share(&whom.user);
        let pool = self.pools.at(&profile);
        pool.crews.insert(&whom, share, (0, lease.id));
        pool.crew_count += 1;
        self.crews.insert(
            lease.id,
            Crew {
                lease,
                profile,
                whom,
                helpers: BTreeMap::new(),
            },
        );
    }

    /// The holder of a lease can use no helpers any more.
    pub(super) fn crew_closed(&mut self, id: LeaseId) {
        if let Some(crew) = self.crews.remove(&id) {
            let share = self.share(&crew.whom.user);
            let pool = self.pools.at(&crew.profile);
            pool.crews
                .remove(&crew.whom, share, &(crew.helpers.len(), id));
            pool.crew_count -= 1;
            // Where the leader hangs, nobody else tells them.
            for (helper, since) in crew.helpers {
                self.effects
                    .push(Effect::Tell(helper, WorkerCommand::Revoke(crew.lease)));
                self.discharge(crew.lease.job, since);
            }
            self.pools.tidy(&crew.profile);
        }
    }

    /// A worker helps the holder of a lease no more.
    pub(super) fn helped(&mut self, worker: WorkerId, lease: &Lease) {
        let Some(w) = self
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

    /// A helper has left a crew.
    pub(super) fn has_left(&mut self, id: LeaseId, worker: WorkerId) {
        let Some(crew) = self.crews.get_mut(&id) else {
            return;
        };
        let Some(since) = crew.helpers.remove(&worker) else {
            return;
        };
        let (job, now) = (crew.lease.job, crew.helpers.len());
        self.recount(id, now + 1, now);
        self.discharge(job, since);
    }

    /// A helper is sent to a crew.
    fn has_come(&mut self, id: LeaseId, worker: WorkerId) {
        let clock = self.clock;
        let Some(crew) = self.crews.get_mut(&id) else {
            return;
        };
        crew.helpers.insert(worker, clock);
        let (lease, now) = (crew.lease, crew.helpers.len());
        self.recount(id, now - 1, now);
        self.charge(lease.job);
        self.note_hands(&lease, worker);
    }

    /// The leader of a crew leaves outcomes from which others may go on.
    fn note_hand(&mut self, lease: &Lease) {
        if let Some(worker) = self.leases.get(&lease.id).map(|l| l.worker) {
            self.note_hands(lease, worker);
        }
    }

    fn note_hands(&mut self, lease: &Lease, worker: WorkerId) {
        let Some(name) = self.workers.get(&worker).map(|w| Name::clone(&w.signature)) else {
            return;
        };
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.tiles[lease.tile.at()].contributors.insert(name);
        }
    }

    /// The job of a crew has another priority.
    pub(super) fn move_crew(&mut self, id: LeaseId, to: Reverse<i32>) {
        let Some(crew) = self.crews.get_mut(&id) else {
            return;
        };
        let from = crew.whom.clone();
        crew.whom.priority = to;
        let (whom, entry) = (crew.whom.clone(), (crew.helpers.len(), id));
        let profile = Profile::clone(&crew.profile);
        let share = self.share(&from.user);
        let crews = &mut self.pools.at(&profile).crews;
        crews.remove(&from, share, &entry);
        crews.insert(&whom, share, entry);
    }

    /// Lists a crew with another number of helpers.
    fn recount(&mut self, id: LeaseId, from: usize, to: usize) {
        let Some(crew) = self.crews.get(&id) else {
            return;
        };
        let share = self.share(&crew.whom.user);
        let crews = &mut self.pools.at(&crew.profile).crews;
        crews.remove(&crew.whom, share, &(from, id));
        crews.insert(&crew.whom, share, (to, id));
    }

    /// The order to help did not reach a worker, which does not read its stream.
    pub(super) fn help_undelivered(&mut self, worker: WorkerId, lease: &Lease, now: Now) {
        // It counts as deaf first, so that it is not sent again at once.
        self.backpressure(worker, now);
        self.helped(worker, lease);
    }

    /// Sends a worker without a tile to the crew whose turn it is, or moves one to it from another crew;
    /// returns whether it did.
    pub(super) fn send_helper(&mut self, profile: &Profile) -> bool {
        let Some(pool) = self.pools.of.get(profile) else {
            return false;
        };
        let Some((_, (_, id))) = pool.crew_with_room() else {
            return false;
        };
        let free = pool.helpers.first().copied();
        let Some(worker) = free.or_else(|| self.may_move(profile)) else {
            return false;
        };
        if let Some(earlier) = self.workers.get(&worker).and_then(|w| w.helps) {
            self.effects
                .push(Effect::Tell(worker, WorkerCommand::Revoke(earlier)));
            self.has_left(earlier.id, worker);
        }
        let Some(lease) = self.crews.get(&id).map(|crew| crew.lease) else {
            return false;
        };
        let Some(job) = self.jobs.get(&lease.job) else {
            return false;
        };
        let help = Help {
            lease,
            work: std::sync::Arc::clone(&job.work),
            profile: profile.to_string(),
        };
        self.effects
            .push(Effect::Tell(worker, WorkerCommand::Help(Box::new(help))));
        if let Some(w) = self.workers.get_mut(&worker) {
            w.helps = Some(lease);
        }
        self.has_come(id, worker);
        self.list_worker(worker);
        true
    }

    /// A helper that the crew whose turn it is needs more than its own: that one has a lower priority, or its
    /// user has two workers more, or it is of the same user and has two helpers more.
    fn may_move(&self, profile: &Profile) -> Option<WorkerId> {
        let pool = self.pools.of.get(profile)?;
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
        // One that was called back for a tile is on its way already.
        let helpers = &self.crews.get(&id)?.helpers;
        let stays = |w: &&WorkerId| {
            self.workers
                .get(w)
                .is_some_and(|w| w.leases.is_empty() && !w.draining)
        };
        helpers.keys().rev().find(stays).copied()
    }

    /// Calls a worker back from the crew that it helps, because it gets a tile.
    pub(super) fn call_back(&mut self, worker: WorkerId) {
        if let Some(lease) = self.workers.get(&worker).and_then(|w| w.helps) {
            self.effects
                .push(Effect::Tell(worker, WorkerCommand::Revoke(lease)));
        }
    }
}
