//! Fair shares: among jobs of one priority the user comes first whose jobs have the fewest workers, then the
//! one that has used the least time. A user's jobs follow each other in the order of submission.
//!
//! A user is what the submission says; the time used counts from the user's first open job. One who comes
//! back counts as having used as little as the other users, so that nobody pays for a quiet week or saves up
//! for a busy one.

use std::collections::BTreeSet;

use sightline_records::ids::JobId;

use super::queue::{Account, Share, User};
use super::state::Scheduler;

impl Scheduler {
    /// The share of a user.
    pub(super) fn share(&self, user: &User) -> Share {
        self.accounts
            .get(user)
            .map(|account| account.share)
            .unwrap_or_default()
    }

    /// A job of this user is open from now on.
    pub(super) fn open_account(&mut self, user: &User) {
        if !self.accounts.contains_key(user) {
            self.accounts.insert(
                User::clone(user),
                Account {
                    share: Share::default(),
                    jobs: 0,
                },
            );
        }
        self.catch_up(user);
        if let Some(account) = self.accounts.get_mut(user) {
            account.jobs += 1;
        }
    }

    /// Before a job of this user can have workers again: if none could, the user counts as having used as
    /// little as the others that can.
    pub(super) fn catch_up(&mut self, user: &User) {
        let running = self
            .jobs
            .values()
            .filter(|job| job.runs() && job.open() > 0);
        let active: BTreeSet<&User> = running.map(|job| &job.whom.user).collect();
        if active.contains(user) {
            return;
        }
        let used = |user: &&User| self.accounts.get(*user).map(|a| a.share.used);
        let Some(least) = active.iter().filter_map(used).min() else {
            return;
        };
        let Some(account) = self.accounts.get_mut(user).filter(|a| a.share.workers == 0) else {
            return;
        };
        // The user has no job in any list, so no list has to be ordered anew.
        account.share.used = account.share.used.max(least);
    }

    /// A job of this user has ended, and has neither leases nor helpers.
    pub(super) fn close_account(&mut self, user: &User) {
        let Some(account) = self.accounts.get_mut(user) else {
            return;
        };
        account.jobs -= 1;
        if account.jobs == 0 {
            debug_assert!(
                account.share.workers == 0,
                "a user without jobs has workers"
            );
            self.accounts.remove(user);
        }
    }

    /// A worker begins to work on a job.
    pub(super) fn charge(&mut self, job: JobId) {
        self.change_share(job, |share| share.workers += 1);
    }

    /// A worker ends working on a job, which it did since `since`.
    pub(super) fn discharge(&mut self, job: JobId, since: u64) {
        let spent = self.clock - since.min(self.clock);
        self.change_share(job, |share| {
            debug_assert!(share.workers > 0, "a worker ends what it has not begun");
            share.workers = share.workers.saturating_sub(1);
            share.used = share.used.saturating_add(spent);
        });
    }

    fn change_share(&mut self, job: JobId, change: impl FnOnce(&mut Share)) {
        let Some(user) = self.jobs.get(&job).map(|job| User::clone(&job.whom.user)) else {
            return;
        };
        let Some(account) = self.accounts.get_mut(&user) else {
            return;
        };
        let from = account.share;
        change(&mut account.share);
        let to = account.share;
        for pool in self.pools.of.values_mut() {
            pool.jobs.reorder(&user, from, to);
            pool.crews.reorder(&user, from, to);
        }
    }
}
