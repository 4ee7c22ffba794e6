//! The input and output of commands: notes, progress, stdout, signals, and the end of the process.

pub mod exhaustion;
pub mod exit;
pub mod interrupt;
pub mod json_lines;
pub mod memory;
pub mod printable;
pub mod progress;
pub mod stderr;
pub mod stdout;
