//! Reports of the coordinator: metrics, events, spans and its readiness.

pub(crate) mod events;
pub(crate) mod metrics;
pub(crate) mod readiness;
pub(crate) mod spans;
pub(crate) mod state;
