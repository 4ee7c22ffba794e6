//! Results: assembled at the end of a job, partial before it, and queries about them.

pub(crate) mod assembly;
pub(crate) mod finalize;
pub(crate) mod partial;
pub(crate) mod queries;
pub(crate) mod state;
