//! Limits of the bytes of unfinished uploads: for all uploads, for all users together, and for each user.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::LimitExceeded;

/// Maximum size of all unfinished uploads together, in bytes.
const MAX_UNFINISHED: u64 = 64 << 30;
/// The share of all users together is the total divided by this number. The rest is for outputs of tiles.
const PART_OF_USERS: u64 = 2;
/// The share of one user is the total divided by this number.
const PART_OF_USER: u64 = 8;

/// The sender of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sender<'a> {
    /// A worker.
    Worker,
    /// A user. The name is empty if the coordinator does not distinguish users.
    User(&'a str),
}

/// The bytes of unfinished uploads, with their limit.
#[derive(Clone, Debug)]
pub(crate) struct Budget {
    most: u64,
    held: Arc<Mutex<HeldBytes>>,
}

/// The reserved bytes in total, of all users, and of each user.
#[derive(Debug, Default)]
struct HeldBytes {
    all: u64,
    users: u64,
    by_sender: BTreeMap<String, u64>,
}

/// The reservation of the bytes that an upload announced, until the upload ends.
#[derive(Debug)]
pub(crate) struct Reserved {
    /// The user; `None` for a worker.
    user: Option<String>,
    bytes: u64,
    held: Arc<Mutex<HeldBytes>>,
}

impl Default for Budget {
    fn default() -> Self {
        Self::new(MAX_UNFINISHED)
    }
}

impl Budget {
    /// Creates a budget with a limit of `most` bytes.
    pub(crate) fn new(most: u64) -> Self {
        Self {
            most,
            held: Arc::default(),
        }
    }

    /// Reserves the bytes that an upload announces.
    ///
    /// # Errors
    /// [`LimitExceeded::Unfinished`] if all uploads together, the uploads of all users, or the uploads of the
    /// user would exceed their limit.
    pub(crate) fn reserve(
        &self,
        sender: Sender<'_>,
        bytes: u64,
    ) -> Result<Reserved, LimitExceeded> {
        let mut held = lock(&self.held);
        let below = |most: u64, before: u64, who: &'static str| {
            let wanted = before.saturating_add(bytes);
            if wanted > most {
                Err(LimitExceeded::Unfinished { who, most, wanted })
            } else {
                Ok(wanted)
            }
        };
        let user = match sender {
            Sender::Worker => None,
            Sender::User(name) => {
                let own = held.by_sender.get(name).copied().unwrap_or(0);
                // If the coordinator does not distinguish users, all of them share the empty name, and only
                // the limit of all users applies.
                if !name.is_empty() {
                    below(self.most / PART_OF_USER, own, "a user")?;
                }
                Some(name.to_owned())
            }
        };
        let users = match &user {
            Some(_) => below(self.most / PART_OF_USERS, held.users, "all users")?,
            None => held.users,
        };
        held.all = below(self.most, held.all, "all users and workers")?;
        held.users = users;
        if let Some(name) = &user {
            *held.by_sender.entry(name.clone()).or_default() += bytes;
        }
        Ok(Reserved {
            user,
            bytes,
            held: Arc::clone(&self.held),
        })
    }

    /// Returns the bytes of all unfinished uploads together.
    #[cfg(test)]
    pub(crate) fn all(&self) -> u64 {
        lock(&self.held).all
    }

    /// Returns the bytes of an owner's unfinished uploads.
    pub(crate) fn bytes_of(&self, owner: &str) -> u64 {
        lock(&self.held).by_sender.get(owner).copied().unwrap_or(0)
    }
}

impl Drop for Reserved {
    fn drop(&mut self) {
        let mut held = lock(&self.held);
        held.all -= self.bytes;
        let Some(user) = &self.user else { return };
        held.users -= self.bytes;
        if let Some(own) = held.by_sender.get_mut(user) {
            *own -= self.bytes;
            if *own == 0 {
                held.by_sender.remove(user);
            }
        }
    }
}

fn lock(held: &Mutex<HeldBytes>) -> MutexGuard<'_, HeldBytes> {
    // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budget_bounds_uploads_of_user_of_users_and_of_all() {
        use Sender::{User, Worker};
        let budget = Budget::new(800);
        let refused = |sender, bytes| match budget.reserve(sender, bytes) {
            Err(LimitExceeded::Unfinished { who, most, wanted }) => (who, most, wanted),
            other => panic!("{other:?}"),
        };
        let ada = budget.reserve(User("ada"), 60).unwrap();
        assert_eq!(refused(User("ada"), 41), ("a user", 100, 101));
        assert_eq!(refused(User("ada"), u64::MAX), ("a user", 100, u64::MAX));
        let others: Vec<_> = ["b", "c", "d"]
            .map(|name| budget.reserve(User(name), 100).unwrap())
            .into();
        assert_eq!(refused(User("eve"), 41), ("all users", 400, 401));
        assert_eq!(refused(User(""), 41), ("all users", 400, 401));
        // Users cannot reserve the part that is for workers.
        let workers = budget.reserve(Worker, 440).unwrap();
        assert_eq!(refused(Worker, 1), ("all users and workers", 800, 801));
        assert_eq!(
            (
                budget.bytes_of("ada"),
                budget.bytes_of("b"),
                budget.bytes_of("eve")
            ),
            (60, 100, 0)
        );
        drop((ada, workers, others));
        {
            let held = lock(&budget.held);
            assert!(held.all == 0 && held.users == 0 && held.by_sender.is_empty());
        }
        // Without names, all users share one limit.
        assert!(budget.reserve(User(""), 400).is_ok());
    }
}
