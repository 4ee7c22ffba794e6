//! Errors of scenes. Each names the file, the element at fault, the reason and a remedy.

use std::path::{Path, PathBuf};

/// The reason why a scene could not be loaded or accepted.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file that cannot be opened or read.
    #[error("{}: cannot be read: {source}; check the path and its permissions", path.display())]
    Io {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file whose contents cannot be used.
    #[error("{file}: {element}: {reason}; {remedy}")]
    Bad {
        /// The file name as the user specified it, or a description such as "uploaded scene".
        file: String,
        /// The faulty element, for example `face 17` or `line 3`. Indices start at 0, line numbers at 1.
        element: String,
        /// The fault of the element.
        reason: String,
        /// The remedy for the fault.
        remedy: String,
    },
}

impl SceneError {
    /// Creates a [`SceneError::Bad`] for `file`.
    pub fn bad(
        file: impl Into<String>,
        element: impl Into<String>,
        reason: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Bad {
            file: file.into(),
            element: element.into(),
            reason: reason.into(),
            remedy: remedy.into(),
        }
    }

    /// Creates a [`SceneError::Io`] for `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }
}
