//! The program that runs a benchmark.

use std::path::PathBuf;

/// The parts of the calling program that a benchmark needs.
pub struct Host<'a> {
    /// The path of the `sightline` program, which the benchmark starts for every point.
    pub program: PathBuf,
    /// A callback that receives a line of progress.
    pub say: &'a dyn Fn(&str),
    /// A callback that receives a function to call when the user stops the program (Ctrl-C, SIGTERM).
    pub on_stop: &'a dyn Fn(Box<dyn FnOnce() + Send>),
}
