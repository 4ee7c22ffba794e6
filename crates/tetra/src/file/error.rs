//! Why a `.tets` file is refused or cannot be written.

use std::path::PathBuf;

/// Why a `.tets` file is refused or cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum TetsError {
    /// The file cannot be opened or mapped.
    #[error("cannot read {path}: {source}; check that it is there and may be read")]
    Open {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the .tets file: {0}")]
    Write(#[source] std::io::Error),
    /// The first bytes are others.
    #[error(
        "this is not a .tets file (it begins otherwise); name a file that `sightline tetra` wrote"
    )]
    NotTets,
    /// The file has another version of the format.
    #[error(
        "this .tets file has format version {found}, this program reads version {known}; build it again"
    )]
    Version {
        /// The version of the file.
        found: u32,
        /// The version of this crate.
        known: u32,
    },
    /// The file is shorter than it says.
    #[error("the .tets file is cut short: it has {actual} of {expected} bytes; copy it again")]
    CutShort {
        /// Bytes according to the header, or the least that a header needs.
        expected: u64,
        /// Bytes of the file.
        actual: u64,
    },
    /// Some bytes were altered.
    #[error(
        "the .tets file was altered: its {section} does not match its checksum; copy it again, or build \
             it again"
    )]
    Altered {
        /// The part of the file.
        section: &'static str,
    },
    /// The checksums match, but the contents contradict each other.
    #[error("the .tets file is malformed, in its {section}: {reason}; build it again")]
    Malformed {
        /// The part of the file.
        section: &'static str,
        /// The fault.
        reason: String,
    },
    /// The file was made from another scene.
    #[error(
        "the .tets file is of another scene, or was built with other flags about what blocks and shows \
             (digest {found}, wanted {wanted}); name the scene and give the flags that it was built with, or \
             build it again"
    )]
    OtherScene {
        /// The digest in the file, in hexadecimal digits.
        found: String,
        /// The scene's.
        wanted: String,
    },
}
