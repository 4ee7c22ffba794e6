//! Commands in the queue of a store's writer thread, which carries out those in flight together: each decides
//! on the state with all commands before it, and all are answered when what they changed is durable.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::error::StoreError;
use super::rules::{Decision, Event};
use super::table::View;

/// A command to be queued, and where its answer will arrive.
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
    /// Decides on the state including all commands before it; the answer is kept for later.
    fn decide(&mut self, view: View<'_>) -> Option<Event>;
    /// The event cannot be carried out.
    fn refuse(&mut self, error: StoreError);
    /// Answers, once everything decided before is durable or has failed to be.
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
    fn decide(&mut self, view: View<'_>) -> Option<Event> {
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
        // A caller whose thread panicked needs no answer.
        let _ = self.reply.send(outcome.clone().and(self.decided));
    }
}
