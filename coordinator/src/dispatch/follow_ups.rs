//! The follow-ups of an event: work that blocks and that its receiver must run.

use sightline_records::ids::JobId;
use sightline_scheduler::StoreCommand;

/// A task that blocks and must run after an event.
#[derive(Debug)]
pub(crate) enum FollowUp {
    /// A change of the store.
    Run(StoreCommand),
    /// The result of a complete job.
    Assemble(JobId),
}

/// The follow-ups of events. Debug builds fail where some are dropped: the scheduler waits for their
/// outcomes.
#[derive(Debug, Default)]
#[must_use = "the scheduler waits for the outcomes of follow-ups; run them"]
pub(crate) struct FollowUps(Vec<FollowUp>);

impl FollowUps {
    /// Adds one.
    pub(super) fn push(&mut self, follow_up: FollowUp) {
        self.0.push(follow_up);
    }

    /// Adds the follow-ups of another event.
    pub(crate) fn extend(&mut self, more: Self) {
        self.0.extend(more.into_list());
    }

    /// Returns true if there is nothing to run.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of follow-ups.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Takes the follow-ups out, so that the caller runs or drops them.
    pub(super) fn into_list(mut self) -> Vec<FollowUp> {
        std::mem::take(&mut self.0)
    }

    /// Drops the follow-ups of a coordinator that ends. Its successor reads the state of the store.
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

/// Follow-ups that wait for a thread. A runtime that ends drops them.
pub(crate) struct Waiting(FollowUps);

impl Waiting {
    /// Hands the follow-ups over.
    pub(crate) fn new(follow_ups: FollowUps) -> Self {
        Self(follow_ups)
    }

    /// Takes the follow-ups back, on the thread that runs them.
    pub(crate) fn take(mut self) -> FollowUps {
        std::mem::take(&mut self.0)
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        std::mem::take(&mut self.0).discard();
    }
}
