//! Uploads of clients and workers: chunks, scenes, receivers, and spooled outputs.

pub(crate) mod chunks;
pub(crate) mod complete;
pub(crate) mod receivers;
pub(crate) mod scene_files;
pub(crate) mod scenes;
pub(crate) mod spool;
pub(crate) mod state;
