//! The outbox: the channel to a worker.

use sightline_scheduler::WorkerCommand;

/// A channel to one worker.
pub(crate) trait Outbox: Send {
    /// Sends a command without waiting. Returns true if the channel accepted the command. A worker that does
    /// not read its stream loses commands and, after some time, its leases.
    fn offer(&self, command: WorkerCommand) -> bool;
}
