//! Errors of scenes. Each names the file, the element at fault, the reason and a remedy.

use std::path::{Path, PathBuf};

/// Why a scene could not be loaded or accepted.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file cannot be opened or read.
    #[error("{}: cannot be read: {source}; check the path and its permissions", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The contents of the file cannot be used.
    #[error("{file}: {element}: {reason}; {remedy}")]
    Bad {
        /// The file name as the user gave it, or a description such as "uploaded scene".
        file: String,
        /// The element at fault, counted from 0, for example `face 17` or `accessor 3`.
        element: String,
        /// The fault.
        reason: String,
        /// The remedy.
        remedy: String,
    },
}

impl SceneError {
    /// A [`SceneError::Bad`] for `file`.
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

    /// A [`SceneError::Io`] for `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }
}
