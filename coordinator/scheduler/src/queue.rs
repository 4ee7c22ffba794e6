//! Queues of entries in the order of service.
//!
//! The order is: higher priorities first, then the user whose jobs have the smallest share of the workers
//! (`shares`), then the order of the entries.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The name of a user; empty for all users who give no name.
pub(super) type User = Arc<str>;

/// The share of the workers that the jobs of a user have. Smaller shares are served first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Share {
    /// The current number of leases and helpers.
    pub(super) workers: u32,
    /// The time that workers have spent on ended leases and as former helpers, in milliseconds.
    pub(super) used: u64,
}

/// A user with open jobs.
#[derive(Debug, Default)]
pub(super) struct Account {
    pub(super) share: Share,
    /// The number of open jobs.
    pub(super) jobs: u32,
}

/// The key by which [`Queue`] orders: the user and the priority.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct QueueKey {
    pub(super) user: User,
    pub(super) priority: Reverse<i32>,
}

/// The turn of a user at one priority. Turns are sorted: higher priorities first, then smaller shares.
pub(super) type ServiceOrder = (Reverse<i32>, Share, User);

/// A queue of entries, in the order in which they are served.
#[derive(Debug)]
pub(super) struct Queue<T> {
    by_key: BTreeMap<QueueKey, BTreeSet<T>>,
    turns: BTreeSet<ServiceOrder>,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self {
            by_key: BTreeMap::new(),
            turns: BTreeSet::new(),
        }
    }
}

impl<T: Ord> Queue<T> {
    /// Adds an entry for a user whose share is `share`.
    pub(super) fn insert(&mut self, key: &QueueKey, share: Share, thing: T) {
        self.by_key.entry(key.clone()).or_default().insert(thing);
        self.turns
            .insert((key.priority, share, User::clone(&key.user)));
    }

    /// Removes an entry.
    pub(super) fn remove(&mut self, key: &QueueKey, share: Share, thing: &T) {
        let Some(things) = self.by_key.get_mut(key) else {
            return;
        };
        things.remove(thing);
        if things.is_empty() {
            self.by_key.remove(key);
            self.turns
                .remove(&(key.priority, share, User::clone(&key.user)));
        }
    }

    /// Returns the first entry, with the turn of its user.
    pub(super) fn first(&self) -> Option<(&ServiceOrder, &T)> {
        self.first_that(|_| true)
    }

    /// Returns the first entry that satisfies `wanted` among the first entries of the users, in the users'
    /// order.
    pub(super) fn first_that(&self, wanted: impl Fn(&T) -> bool) -> Option<(&ServiceOrder, &T)> {
        self.turns.iter().find_map(|turn| {
            let key = QueueKey {
                user: User::clone(&turn.2),
                priority: turn.0,
            };
            let first = self.by_key.get(&key)?.first()?;
            wanted(first).then_some((turn, first))
        })
    }

    /// Returns the last entry that satisfies `wanted` among the last entries of the users, from the last
    /// user.
    pub(super) fn richest(&self, wanted: impl Fn(&T) -> bool) -> Option<(&ServiceOrder, &T)> {
        self.turns.iter().rev().find_map(|turn| {
            let key = QueueKey {
                user: User::clone(&turn.2),
                priority: turn.0,
            };
            let last = self.by_key.get(&key)?.last()?;
            wanted(last).then_some((turn, last))
        })
    }

    /// Returns true if the queue contains an entry.
    #[cfg(test)]
    pub(super) fn has(&self, key: &QueueKey, thing: &T) -> bool {
        self.by_key
            .get(key)
            .is_some_and(|things| things.contains(thing))
    }

    /// Returns all entries, by user and priority.
    #[cfg(test)]
    pub(super) fn all(&self) -> impl Iterator<Item = (&QueueKey, &T)> {
        self.by_key
            .iter()
            .flat_map(|(key, things)| things.iter().map(move |thing| (key, thing)))
    }

    /// Returns true if the queue has no entries.
    pub(super) fn is_empty(&self) -> bool {
        self.by_key.is_empty()
    }

    /// Moves the turns of a user whose share has changed.
    pub(super) fn reorder(&mut self, user: &User, from: Share, to: Share) {
        let at = |priority| QueueKey {
            user: User::clone(user),
            priority: Reverse(priority),
        };
        for key in self
            .by_key
            .range(at(i32::MAX)..=at(i32::MIN))
            .map(|(key, _)| key)
        {
            self.turns.remove(&(key.priority, from, User::clone(user)));
            self.turns.insert((key.priority, to, User::clone(user)));
        }
    }

    /// Returns true if every user with entries has one turn at each priority, by the given shares.
    #[cfg(test)]
    pub(super) fn is_in_order(&self, share: impl Fn(&User) -> Share) -> bool {
        let turn = |key: &QueueKey| (key.priority, share(&key.user), User::clone(&key.user));
        self.by_key.keys().map(turn).collect::<BTreeSet<_>>() == self.turns
            && self.by_key.values().all(|things| !things.is_empty())
    }
}
