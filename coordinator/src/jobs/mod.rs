//! Jobs: their submission, states, retention and removal.

pub(crate) mod control;
pub(crate) mod delete;
pub(crate) mod estimate;
pub(crate) mod invalidate;
pub(crate) mod retention;
pub(crate) mod retention_clock;
pub(crate) mod retention_stamp;
pub(crate) mod stored_spec;
pub(crate) mod submit;
pub(crate) mod suspend;
pub(crate) mod suspensions;
pub(crate) mod tiles;
