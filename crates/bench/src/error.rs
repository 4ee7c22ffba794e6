//! The error of a benchmark.

use std::path::Path;

/// The reason why a benchmark ended early. The variants are the failures that the exit code of a child
/// process distinguishes.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The options of the benchmark, or of a child process, are wrong.
    #[error("{0}")]
    Usage(String),
    /// A scene cannot be read.
    #[error("{0}")]
    Input(String),
    /// A coordinator cannot be reached, or rejected the call.
    #[error("{0}")]
    Coordinator(String),
    /// A bake failed.
    #[error("{0}")]
    Job(String),
    /// The user stopped the benchmark.
    #[error("{0}")]
    Interrupted(String),
    /// A fault of the machine or of the program.
    #[error("{0}")]
    Internal(String),
}

impl BenchError {
    pub(crate) fn internal(e: impl std::fmt::Display) -> Self {
        Self::Internal(e.to_string())
    }

    pub(crate) fn writing(path: &Path, e: &std::io::Error) -> Self {
        Self::Internal(format!(
            "{} cannot be written: {e}; check the folder and the space left",
            path.display()
        ))
    }
}
