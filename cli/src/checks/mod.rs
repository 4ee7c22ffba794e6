//! Commands that check results.

pub mod bench;
pub mod measure;
pub mod verify;
