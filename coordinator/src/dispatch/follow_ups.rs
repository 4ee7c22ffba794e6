//! The follow-ups of an event: blocking work that the receiver of the event must run.

use sightline_records::ids::JobId;
use sightline_scheduler::StoreCommand;

/// A blocking task that must run after an event.
#[derive(Debug)]
pub(crate) enum FollowUp {
    /// A command to the store.
    Run(StoreCommand),
    /// The assembly of a complete job's result.
    Assemble(JobId),
}

/// The follow-ups of events. The scheduler waits for their outcomes, so debug builds fail if follow-ups are
/// dropped.
#[derive(Debug, Default)]
#[must_use = "the scheduler waits for the outcomes of follow-ups; run them"]
pub(crate) struct FollowUps(Vec<FollowUp>);

impl FollowUps {
    /// Adds a follow-up.
    pub(super) fn push(&mut self, follow_up: FollowUp) {
        self.0.push(follow_up);
    }

    /// Adds the follow-ups of another event.
    pub(crate) fn extend(&mut self, more: Self) {
        self.0.extend(more.into_list());
    }

    /// Returns true if no follow-up exists.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of follow-ups.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns the follow-ups as a list, which the caller runs or drops.
    pub(super) fn into_list(mut self) -> Vec<FollowUp> {
        std::mem::take(&mut self.0)
    }

    /// Drops the follow-ups of a coordinator that ends. Its successor reads the state from the store.
    pub(crate) fn discard(self) {
        drop(self.into_list());
    }
}

impl Drop for FollowUps {
    fn drop(&mut self) {
        debug_assert!(
            self.0.is_empty() || std::thread::panicking(),
            "follow-ups were dropped: {:?}",
            self.0
        );
    }
}

/// Follow-ups that wait for a thread. A runtime that ends may drop them.
pub(crate) struct Waiting(FollowUps);

impl Waiting {
    /// Wraps follow-ups that another thread will run.
    pub(crate) fn new(follow_ups: FollowUps) -> Self {
        Self(follow_ups)
    }

    /// Returns the follow-ups, to the thread that runs them.
    pub(crate) fn take(mut self) -> FollowUps {
        std::mem::take(&mut self.0)
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        std::mem::take(&mut self.0).discard();
    }
}
