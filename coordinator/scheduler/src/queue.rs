//! Things to do in the order in which users have their turns: higher priorities first, then the user whose
//! jobs have the smallest share of the workers (`shares`), then the order of the things.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The name of a user; empty for everybody who gives none.
pub(super) type User = Arc<str>;

/// What the jobs of a user have: the smaller one comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Share {
    /// Leases and helpers.
    pub(super) workers: u32,
    /// Milliseconds of workers on leases and as helpers that have ended.
    pub(super) used: u64,
}

/// A user with open jobs.
#[derive(Debug, Default)]
pub(super) struct Account {
    pub(super) share: Share,
    /// Open jobs.
    pub(super) jobs: u32,
}

/// For whom something is done: what [`Queue`] orders by.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct QueueKey {
    pub(super) user: User,
    pub(super) priority: Reverse<i32>,
}

/// The place of a user at one priority among all: higher priorities first, then smaller shares.
pub(super) type ServiceOrder = (Reverse<i32>, Share, User);

/// Things to do, in the order in which they are served.
#[derive(Debug)]
pub(super) struct Queue<T> {
    of: BTreeMap<QueueKey, BTreeSet<T>>,
    turns: BTreeSet<ServiceOrder>,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self {
            of: BTreeMap::new(),
            turns: BTreeSet::new(),
        }
    }
}

impl<T: Ord> Queue<T> {
    /// Adds something for a user whose share is `share`.
    pub(super) fn insert(&mut self, whom: &QueueKey, share: Share, thing: T) {
        self.of.entry(whom.clone()).or_default().insert(thing);
        self.turns
            .insert((whom.priority, share, User::clone(&whom.user)));
    }

    /// Removes something.
    pub(super) fn remove(&mut self, whom: &QueueKey, share: Share, thing: &T) {
        let Some(things) = self.of.get_mut(whom) else {
            return;
        };
        things.remove(thing);
        if things.is_empty() {
            self.of.remove(whom);
            self.turns
                .remove(&(whom.priority, share, User::clone(&whom.user)));
        }
    }

    /// The first thing, with the turn of its user.
    pub(super) fn first(&self) -> Option<(&ServiceOrder, &T)> {
        self.first_that(|_| true)
    }

    /// The first thing of the first user whose first thing is as wanted.
    pub(super) fn first_that(&self, wanted: impl Fn(&T) -> bool) -> Option<(&ServiceOrder, &T)> {
        self.turns.iter().find_map(|turn| {
            let whom = QueueKey {
                user: User::clone(&turn.2),
                priority: turn.0,
            };
            let first = self.of.get(&whom)?.first()?;
            wanted(first).then_some((turn, first))
        })
    }

    /// The last thing of the last user whose last thing is as wanted.
    pub(super) fn richest(&self, wanted: impl Fn(&T) -> bool) -> Option<(&ServiceOrder, &T)> {
        self.turns.iter().rev().find_map(|turn| {
            let whom = QueueKey {
                user: User::clone(&turn.2),
                priority: turn.0,
            };
            let last = self.of.get(&whom)?.last()?;
            wanted(last).then_some((turn, last))
        })
    }

    /// Whether a thing is there.
    #[cfg(test)]
    pub(super) fn has(&self, whom: &QueueKey, thing: &T) -> bool {
        self.of
            .get(whom)
            .is_some_and(|things| things.contains(thing))
    }

    /// All things, by user and priority.
    #[cfg(test)]
    pub(super) fn all(&self) -> impl Iterator<Item = (&QueueKey, &T)> {
        self.of
            .iter()
            .flat_map(|(whom, things)| things.iter().map(move |thing| (whom, thing)))
    }

    /// Whether there is nothing.
    pub(super) fn is_empty(&self) -> bool {
        self.of.is_empty()
    }

    /// The share of a user has changed.
    pub(super) fn reorder(&mut self, user: &User, from: Share, to: Share) {
        let at = |priority| QueueKey {
            user: User::clone(user),
            priority: Reverse(priority),
        };
        for whom in self
            .of
            .range(at(i32::MAX)..=at(i32::MIN))
            .map(|(whom, _)| whom)
        {
            self.turns.remove(&(whom.priority, from, User::clone(user)));
            self.turns.insert((whom.priority, to, User::clone(user)));
        }
    }

    /// Whether every user with something to do has one turn at each priority, by the share that is given.
    #[cfg(test)]
    pub(super) fn is_in_order(&self, share: impl Fn(&User) -> Share) -> bool {
        let turn = |whom: &QueueKey| (whom.priority, share(&whom.user), User::clone(&whom.user));
        self.of.keys().map(turn).collect::<BTreeSet<_>>() == self.turns
            && self.of.values().all(|things| !things.is_empty())
    }
}
