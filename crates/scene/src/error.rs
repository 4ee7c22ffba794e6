//! What can be wrong with a scene, said so that the reader can mend it: file, element, reason, remedy.

use std::path::{Path, PathBuf};

/// Why a scene could not be loaded or accepted.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file could not be opened or read at all.
    #[error("{}: cannot be read: {source}; check the path and its permissions", path.display())]
    Io {
        /// The file asked for.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file was read, and what is in it cannot be used.
    #[error("{file}: {element}: {reason}; {remedy}")]
    Bad {
        /// File name as the user gave it, or a description such as "uploaded scene".
        file: String,
        /// The element at fault, counted from 0, for example `face 17` or `accessor 3`.
        element: String,
        /// What is wrong with it.
        reason: String,
        /// What the user can do.
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
        Self::Bad { file: file.into(), element: element.into(), reason: reason.into(), remedy: remedy.into() }
    }

    /// A [`SceneError::Io`] for `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }
}
