//! Commands about the program.

pub mod completions;
pub mod man;
