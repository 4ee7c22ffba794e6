//! Fair shares of the workers between users.
//!
//! Within a priority, the user whose jobs have the fewest workers comes first, then the user that has used
//! the least time. A user's jobs follow each other in the order of submission.
//!
//! The submission names the user. The used time counts from the user's first open job. A returning user
//! starts with the least used time of the active users, so an idle week neither costs nor earns time.

use std::collections::BTreeSet;

use sightline_records::ids::JobId;

use super::queue::{Account, Share, User};
use super::state::Scheduler;

impl Scheduler {
    /// Returns the share of a user.
    pub(super) fn share(&self, user: &User) -> Share {
        self.queues
            .accounts
            .get(user)
            .map(|account| account.share)
            .unwrap_or_default()
    }

    /// Counts a new open job of a user.
    pub(super) fn open_account(&mut self, user: &User) {
        if !self.queues.accounts.contains_key(user) {
            self.queues.accounts.insert(
                User::clone(user),
                Account {
                    share: Share::default(),
                    jobs: 0,
                },
            );
        }
        self.catch_up(user);
        if let Some(account) = self.queues.accounts.get_mut(user) {
            account.jobs += 1;
        }
    }

    /// Raises the used time of a user before a job of the user can have workers again.
    ///
    /// If none of the user's jobs could have workers, the user starts with the least used time of the active
    /// users.
    pub(super) fn catch_up(&mut self, user: &User) {
        let running = self
            .jobs
            .values()
            .filter(|job| job.runs() && job.open() > 0);
        let active: BTreeSet<&User> = running.map(|job| &job.key.user).collect();
        if active.contains(user) {
            return;
        }
        let used = |user: &&User| self.queues.accounts.get(*user).map(|a| a.share.used);
        let Some(least) = active.iter().filter_map(used).min() else {
            return;
        };
        let Some(account) = self
            .queues
            .accounts
            .get_mut(user)
            .filter(|a| a.share.workers == 0)
        else {
            return;
        };
        // The user has no job in any list, so no list must be reordered.
        account.share.used = account.share.used.max(least);
    }

    /// Counts a job of a user as ended. The job has neither leases nor helpers.
    pub(super) fn close_account(&mut self, user: &User) {
        let Some(account) = self.queues.accounts.get_mut(user) else {
            return;
        };
        account.jobs -= 1;
        if account.jobs == 0 {
            debug_assert!(
                account.share.workers == 0,
                "a user without jobs has workers"
            );
            self.queues.accounts.remove(user);
        }
    }

    /// Counts a worker that begins to work on a job.
    pub(super) fn charge(&mut self, job: JobId) {
        self.change_share(job, |share| share.workers += 1);
    }

    /// Counts a worker as finished with a job on which it has worked since `since`, in milliseconds.
    pub(super) fn discharge(&mut self, job: JobId, since: u64) {
        let spent = self.time.clock - since.min(self.time.clock);
        self.change_share(job, |share| {
            debug_assert!(share.workers > 0, "a worker ends what it has not begun");
            share.workers = share.workers.saturating_sub(1);
            share.used = share.used.saturating_add(spent);
        });
    }

    fn change_share(&mut self, job: JobId, change: impl FnOnce(&mut Share)) {
        let Some(user) = self.jobs.get(&job).map(|job| User::clone(&job.key.user)) else {
            return;
        };
        let Some(account) = self.queues.accounts.get_mut(&user) else {
            return;
        };
        let from = account.share;
        change(&mut account.share);
        let to = account.share;
        for pool in self.queues.pools.by_profile.values_mut() {
            pool.jobs.reorder(&user, from, to);
            pool.crews.reorder(&user, from, to);
        }
    }
}
