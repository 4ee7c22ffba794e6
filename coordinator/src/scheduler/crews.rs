//! Helpers: workers without a tile help the leaders of running tiles, evenly spread, until they get a tile or
//! the crew ends.

use std::collections::BTreeSet;

use super::crew::Crew;
use super::event::Effect;
use super::machine::Machine;
use super::messages::{Help, Now, Order};
use super::pools::Profile;
use crate::ids::{Lease, LeaseId, WorkerId};

impl Machine {
    /// Whether a tile is leased under this lease.
    pub(crate) fn is_leased(&self, lease: &Lease) -> bool {
        self.leases.get(&lease.id).is_some_and(|l| (l.job, l.tile) == (lease.job, lease.tile))
    }

    /// The holder of a lease can use helpers from now on.
    pub(super) fn crew_opened(&mut self, lease: Lease) {
        if !self.is_leased(&lease) || self.crews.contains_key(&lease.id) {
            return;
        }
        let Some(profile) = self.leases.get(&lease.id).map(|l| Profile::clone(&l.profile)) else { return };
        self.pools.at(&profile).crews.insert((0, lease.id));
        self.crews.insert(lease.id, Crew { lease, profile, helpers: BTreeSet::new() });
    }

    /// The holder of a lease can use no helpers any more.
    pub(super) fn crew_closed(&mut self, id: LeaseId) {
        if let Some(crew) = self.crews.remove(&id) {
            self.pools.at(&crew.profile).crews.remove(&(crew.helpers.len(), id));
            // Where the leader hangs, nobody else tells them.
            for helper in &crew.helpers {
                self.effects.push(Effect::Tell(*helper, Order::Revoke(crew.lease)));
            }
            self.pools.tidy(&crew.profile);
        }
    }

    /// A worker helps the holder of a lease no more.
    pub(super) fn helped(&mut self, worker: WorkerId, lease: &Lease) {
        let Some(w) = self.workers.get_mut(&worker).filter(|w| w.helps == Some(*lease)) else { return };
        w.helps = None;
        self.has_left(lease.id, worker);
        self.list_worker(worker);
    }

    /// A helper has left a crew.
    pub(super) fn has_left(&mut self, id: LeaseId, worker: WorkerId) {
        self.change_helpers(id, |helpers| {
            helpers.remove(&worker);
        });
    }

    fn change_helpers(&mut self, id: LeaseId, change: impl FnOnce(&mut BTreeSet<WorkerId>)) {
        let Some(crew) = self.crews.get_mut(&id) else { return };
        let before = crew.helpers.len();
        change(&mut crew.helpers);
        let after = crew.helpers.len();
        let pool = self.pools.at(&crew.profile);
        pool.crews.remove(&(before, id));
        pool.crews.insert((after, id));
    }

    /// The order to help did not reach a worker, which does not read its stream.
    pub(super) fn help_undelivered(&mut self, worker: WorkerId, lease: &Lease, now: Now) {
        // It counts as deaf first, so that it is not sent again at once.
        self.deafen(worker, now);
        self.helped(worker, lease);
    }

    /// Sends a worker without a tile to the crew with the fewest helpers; returns whether there are both.
    pub(super) fn send_helper(&mut self, profile: &Profile) -> bool {
        let Some(pool) = self.pools.of.get(profile) else { return false };
        let (Some(&worker), Some(&(_, id))) = (pool.helpers.first(), pool.crews.first()) else {
            return false;
        };
        let Some(lease) = self.crews.get(&id).map(|crew| crew.lease) else { return false };
        let Some(job) = self.jobs.get(&lease.job) else { return false };
        let help = Help { lease, spec: job.work.spec.clone(), profile: profile.to_string() };
        self.effects.push(Effect::Tell(worker, Order::Help(Box::new(help))));
        if let Some(w) = self.workers.get_mut(&worker) {
            w.helps = Some(lease);
        }
        self.change_helpers(id, |helpers| {
            helpers.insert(worker);
        });
        self.list_worker(worker);
        true
    }

    /// Calls a worker back from the crew that it helps, because it gets a tile.
    pub(super) fn call_back(&mut self, worker: WorkerId) {
        if let Some(lease) = self.workers.get(&worker).and_then(|w| w.helps) {
            self.effects.push(Effect::Tell(worker, Order::Revoke(lease)));
        }
    }
}
