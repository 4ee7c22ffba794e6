//! Commands in the queue of a store's writer thread, which executes concurrent commands as one group.
//!
//! Each command decides on the state after all earlier commands. The writer thread answers all commands of a
//! group once the changes of the group are durable.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::error::StoreError;
use super::rules::{Decision, StateChange};
use super::table::View;

/// Creates a queued command and the receiver of its answer.
pub(super) fn pending<A: Send + 'static>(
    decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
) -> (Box<dyn Pending>, Receiver<Result<A, StoreError>>) {
    let (reply, answer) = sync_channel(1);
    (
        Box::new(Command {
            decide: Some(decide),
            decided: Err(StoreError::Closed),
            reply,
        }),
        answer,
    )
}

/// A command in the queue of the writer thread.
pub(super) trait Pending: Send {
    /// Decides on the state after all earlier commands, and stores the answer for [`Pending::answer`].
    fn decide(&mut self, view: View<'_>) -> Option<StateChange>;
    /// Replaces the stored answer by an error, because the event cannot be executed.
    fn refuse(&mut self, error: StoreError);
    /// Sends the answer, once the changes of all earlier commands are durable or have failed.
    fn answer(self: Box<Self>, outcome: &Result<(), StoreError>);
}

struct Command<F, A> {
    decide: Option<F>,
    decided: Result<A, StoreError>,
    reply: SyncSender<Result<A, StoreError>>,
}

impl<A: Send, F: FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send> Pending
    for Command<F, A>
{
    fn decide(&mut self, view: View<'_>) -> Option<StateChange> {
        let decision = self.decide.take()?(view);
        let (decided, event) = match decision {
            Ok(Decision { event, answer }) => (Ok(answer), event),
            Err(error) => (Err(error), None),
        };
        self.decided = decided;
        event
    }

    fn refuse(&mut self, error: StoreError) {
        self.decided = Err(error);
    }

    fn answer(self: Box<Self>, outcome: &Result<(), StoreError>) {
        // If the caller's thread panicked, the receiver is gone and needs no answer.
        let _ = self.reply.send(outcome.clone().and(self.decided));
    }
}
