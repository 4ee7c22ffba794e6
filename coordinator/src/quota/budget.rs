//! Bounds of the bytes of unfinished uploads: of all together, of all users, and of each user.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::LimitExceeded;

/// Maximum size of all unfinished uploads together, in bytes.
const MAX_UNFINISHED: u64 = 64 << 30;
/// The part that all users together may have, of this number. The rest is for outputs of tiles.
const PART_OF_USERS: u64 = 2;
/// The part that one user may have, of this number.
const PART_OF_USER: u64 = 8;

/// The sender of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sender<'a> {
    /// A worker.
    Worker,
    /// A user, with an empty name where users are not distinguished.
    User(&'a str),
}

/// Bytes of unfinished uploads.
#[derive(Clone, Debug)]
pub(crate) struct Budget {
    most: u64,
    held: Arc<Mutex<HeldBytes>>,
}

/// Reserved bytes.
#[derive(Debug, Default)]
struct HeldBytes {
    all: u64,
    users: u64,
    of: BTreeMap<String, u64>,
}

/// The bytes that an upload has announced, until it ends.
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
    /// Creates a budget of `most` bytes.
    pub(crate) fn new(most: u64) -> Self {
        Self {
            most,
            held: Arc::default(),
        }
    }

    /// Reserves the bytes that an upload announces.
    ///
    /// # Errors
    /// [`LimitExceeded::Unfinished`] when all uploads together, the uploads of all users, or the uploads of
    /// the user would have too many.
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
                let own = held.of.get(name).copied().unwrap_or(0);
                // Where users are not distinguished, all are one.
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
            *held.of.entry(name.clone()).or_default() += bytes;
        }
        Ok(Reserved {
            user,
            bytes,
            held: Arc::clone(&self.held),
        })
    }

    /// Returns the bytes of all unfinished uploads.
    #[cfg(test)]
    pub(crate) fn all(&self) -> u64 {
        lock(&self.held).all
    }

    /// Returns the bytes of an owner's unfinished uploads.
    pub(crate) fn of(&self, owner: &str) -> u64 {
        lock(&self.held).of.get(owner).copied().unwrap_or(0)
    }
}

impl Drop for Reserved {
    fn drop(&mut self) {
        let mut held = lock(&self.held);
        held.all -= self.bytes;
        let Some(user) = &self.user else { return };
        held.users -= self.bytes;
        if let Some(own) = held.of.get_mut(user) {
            *own -= self.bytes;
            if *own == 0 {
                held.of.remove(user);
            }
        }
    }
}

fn lock(held: &Mutex<HeldBytes>) -> MutexGuard<'_, HeldBytes> {
    // Each change is whole before anything can panic.
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
        // Users leave a part to workers.
        let workers = budget.reserve(Worker, 440).unwrap();
        assert_eq!(refused(Worker, 1), ("all users and workers", 800, 801));
        assert_eq!(
            (budget.of("ada"), budget.of("b"), budget.of("eve")),
            (60, 100, 0)
        );
        drop((ada, workers, others));
        {
            let held = lock(&budget.held);
            assert!(held.all == 0 && held.users == 0 && held.of.is_empty());
        }
        // Without names all users are one.
        assert!(budget.reserve(User(""), 400).is_ok());
    }
}
