//! Commands about the jobs of a coordinator.

pub mod act;
pub mod fetch;
pub mod list;
pub mod logs;
pub mod print;
pub mod priority;
pub mod show;
pub mod submit;
pub mod tiles;
pub mod timeline;
pub mod watch;
