//! The dispatch of events.
//!
//! [`Dispatcher`](dispatcher::Dispatcher) passes events and the time to the scheduler under a short lock,
//! sends commands to workers, and wakes watchers. Blocking effects are returned to the caller as follow-ups.

pub(crate) mod dispatcher;
pub(crate) mod follow_ups;
mod notes;
pub(crate) mod outbox;
pub(crate) mod run;
mod watchers;

pub(crate) use crate::dispatch::follow_ups::FollowUps;
