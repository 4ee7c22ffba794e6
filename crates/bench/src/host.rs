//! The program that runs a benchmark.

use std::path::PathBuf;

/// What a benchmark needs of the program that runs it.
pub struct Host<'a> {
    /// The `sightline` program, which is started for every point.
    pub program: PathBuf,
    /// Receives a line of progress.
    pub say: &'a dyn Fn(&str),
    /// Receives a function to be called when the user stops the program (Ctrl-C, SIGTERM).
    pub on_stop: &'a dyn Fn(Box<dyn FnOnce() + Send>),
}
