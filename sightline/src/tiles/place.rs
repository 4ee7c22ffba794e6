//! The location of a planned bake: a folder, or a prefix in a bucket. Its files appear only when they are
//! complete.

use std::path::{Path, PathBuf};

use sightline_store::{BlobPlace, ObjectFolder, PlaceError};

use crate::error::Error;

/// The location of the files of a planned bake.
pub enum PlanPlace {
    /// A folder.
    Folder(PathBuf),
    /// A prefix in a bucket.
    Bucket(Box<ObjectFolder>),
}

impl PlanPlace {
    /// Opens the location of a planned bake: `s3://…`, as for the coordinator's `--blobs`, or a folder.
    ///
    /// # Errors
    /// [`Error`] if a bucket cannot be reached.
    pub fn open(text: &str) -> Result<Self, Error> {
        if !text.contains("://") {
            return Ok(Self::Folder(text.into()));
        }
        let place = text
            .parse()
            .map_err(|e: PlaceError| Error::usage(format!("{text}: {e}")))?;
        match place {
            BlobPlace::Bucket(place) => {
                let folder = ObjectFolder::open(&place);
                folder
                    .map(Box::new)
                    .map(Self::Bucket)
                    .map_err(|e| Error::input(e.to_string()))
            }
            BlobPlace::Directory(path) => Ok(Self::Folder(path)),
        }
    }

    /// Returns the name of a file, for messages.
    pub fn name(&self, file: &str) -> String {
        match self {
            Self::Folder(path) => path.join(file).display().to_string(),
            Self::Bucket(folder) => folder.name(file),
        }
    }

    /// Reads a file, or returns `None` if the file is absent.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the file cannot be read.
    pub fn read(&self, file: &str) -> Result<Option<Vec<u8>>, Error> {
        match self {
            Self::Folder(path) => match std::fs::read(path.join(file)) {
                Ok(bytes) => Ok(Some(bytes)),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
                Err(e) => Err(Error::input(format!(
                    "{} cannot be read: {e}",
                    self.name(file)
                ))),
            },
            Self::Bucket(folder) => folder.read(file).map_err(|e| Error::input(e.to_string())),
        }
    }

    /// Returns true if a file exists.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the location cannot be read.
    pub fn has(&self, file: &str) -> Result<bool, Error> {
        match self {
            Self::Folder(path) => match path.join(file).try_exists() {
                Ok(exists) => Ok(exists),
                Err(e) => Err(Error::input(format!(
                    "{} cannot be read: {e}",
                    self.name(file)
                ))),
            },
            Self::Bucket(folder) => folder.has(file).map_err(|e| Error::input(e.to_string())),
        }
    }

    /// Writes a file, or replaces the whole content of an existing file.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Internal`] if the file cannot be written.
    pub fn write(&self, file: &str, bytes: Vec<u8>) -> Result<(), Error> {
        match self {
            Self::Folder(path) => {
                let path = path.join(file);
                let parent = path.parent().unwrap_or(Path::new("."));
                std::fs::create_dir_all(parent).map_err(|e| Error::writing(parent, &e))?;
                sightline_files::write(&path, bytes).map_err(|e| Error::writing(&path, &e))
            }
            Self::Bucket(folder) => folder
                .write(file, bytes)
                .map_err(|e| Error::internal(e.to_string())),
        }
    }
}
