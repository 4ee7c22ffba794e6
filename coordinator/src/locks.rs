//! The order of the locks of a coordinator. A thread acquires locks in ascending rank; debug builds check it.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The rank of a lock. A thread that holds a lock acquires only locks of higher rank.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Rank {
    /// The lock of a user's usage, for the time in which the coordinator adds to the usage.
    Quota,
    /// The lock of the jobs that wait for a missing scene or missing receivers.
    Suspension,
    /// The lock of the records of jobs.
    Jobs,
    /// The lock of the outputs of tiles.
    Outputs,
    /// The lock of the scheduler. A thread that holds it must not call the store.
    Scheduler,
    /// The lock of the watchers of jobs.
    Watchers,
}

#[cfg(debug_assertions)]
thread_local! {
    /// The ranks of the locks that this thread holds.
    static HELD: std::cell::RefCell<Vec<Rank>> = const { std::cell::RefCell::new(Vec::new()) };
}

/// A marker that this thread holds a lock of a rank, for the checks of debug builds.
#[derive(Debug)]
pub(crate) struct LockMark {
    #[cfg(debug_assertions)]
    rank: Rank,
}

impl LockMark {
    /// Registers a lock that this thread is about to acquire.
    ///
    /// # Panics
    /// In debug builds, if this thread holds a lock of the same or a higher rank.
    pub(crate) fn mark(rank: Rank) -> Self {
        #[cfg(debug_assertions)]
        {
            HELD.with_borrow_mut(|held| {
                let highest = held.iter().max();
                debug_assert!(
                    highest.is_none_or(|highest| *highest < rank),
                    "the lock {rank:?} is taken under {held:?}"
                );
                held.push(rank);
            });
            Self { rank }
        }
        #[cfg(not(debug_assertions))]
        {
            let _ = rank;
            Self {}
        }
    }
}

#[cfg(debug_assertions)]
impl Drop for LockMark {
    fn drop(&mut self) {
        HELD.with_borrow_mut(|held| {
            if let Some(at) = held.iter().rposition(|rank| *rank == self.rank) {
                held.remove(at);
            }
        });
    }
}

/// Checks, in debug builds, that this thread does not hold the lock of the scheduler.
pub(crate) fn check_store_call() {
    #[cfg(debug_assertions)]
    HELD.with_borrow(|held| {
        debug_assert!(
            !held.contains(&Rank::Scheduler),
            "the store is called under the lock of the scheduler"
        );
    });
}

/// A guard of a lock with its rank marker.
#[derive(Debug)]
pub(crate) struct Ranked<G> {
    guard: G,
    _mark: LockMark,
}

impl<G: Deref> Deref for Ranked<G> {
    type Target = G::Target;

    fn deref(&self) -> &G::Target {
        &self.guard
    }
}

impl<G: DerefMut> DerefMut for Ranked<G> {
    fn deref_mut(&mut self) -> &mut G::Target {
        &mut self.guard
    }
}

/// Acquires a lock of a rank, also if a panic has poisoned the lock. The state behind a lock of the
/// coordinator is derived from the store or is consistent after each statement, so a poisoned lock is safe to
/// use.
pub(crate) fn lock<T>(rank: Rank, mutex: &Mutex<T>) -> Ranked<MutexGuard<'_, T>> {
    ranked(rank, || {
        mutex.lock().unwrap_or_else(PoisonError::into_inner)
    })
}

/// Acquires a lock of a rank with the function `take`.
pub(crate) fn ranked<G>(rank: Rank, take: impl FnOnce() -> G) -> Ranked<G> {
    let mark = LockMark::mark(rank);
    Ranked {
        guard: take(),
        _mark: mark,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn locks_are_taken_in_order() {
        let (jobs, scheduler) = (Mutex::new(1), Mutex::new(2));
        let first = lock(Rank::Jobs, &jobs);
        let mut second = lock(Rank::Scheduler, &scheduler);
        *second += *first;
        drop(first);
        drop(second);
        assert_eq!(*lock(Rank::Scheduler, &scheduler), 3);
        drop(lock(Rank::Jobs, &jobs));
    }

    #[test]
    #[cfg(debug_assertions)]
    #[should_panic(expected = "the lock Jobs is taken under [Scheduler]")]
    fn wrong_order_panics() {
        let (jobs, scheduler) = (Mutex::new(()), Mutex::new(()));
        let _scheduler = lock(Rank::Scheduler, &scheduler);
        let _jobs = lock(Rank::Jobs, &jobs);
    }

    #[test]
    #[cfg(debug_assertions)]
    #[should_panic(expected = "the store is called under the lock of the scheduler")]
    fn store_call_under_scheduler_panics() {
        let scheduler = Mutex::new(());
        let _scheduler = lock(Rank::Scheduler, &scheduler);
        check_store_call();
    }
}
