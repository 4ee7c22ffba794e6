//! Errors of reading and writing `.tets` files.

use std::path::PathBuf;

/// The reason why a `.tets` file is rejected or cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum TetsError {
    /// The file cannot be opened, read or mapped.
    #[error("cannot read {path}: {source}; check that the file exists and is readable")]
    Open {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error(
        "cannot write the .tets file: {0}; check the free space and the permissions of the folder"
    )]
    Write(#[source] std::io::Error),
    /// The file does not start with the magic number.
    #[error(
        "the file is not a .tets file (its first bytes differ); name a file that `sightline tetra` wrote"
    )]
    NotTets,
    /// The file has another version of the format.
    #[error(
        "the .tets file has format version {found}, but this program reads version {known}; build the \
         file again"
    )]
    Version {
        /// The version of the file.
        found: u32,
        /// The version that this crate reads.
        known: u32,
    },
    /// The file is shorter than its header states.
    #[error(
        "the .tets file is cut short: only {actual} of {expected} bytes exist; copy the file again"
    )]
    CutShort {
        /// The length of the file that the header states, or the length of a header if the header is
        /// incomplete, in bytes.
        expected: u64,
        /// The length of the file, in bytes.
        actual: u64,
    },
    /// The bytes of a section or of the header do not match their checksum.
    #[error(
        "the .tets file was altered: the checksum of its {section} is wrong; copy the file again, or \
         build it again"
    )]
    Altered {
        /// The name of the faulty section, or `header`.
        section: &'static str,
    },
    /// The checksums match, but an entry is out of range or two lists contradict each other.
    #[error("the .tets file is malformed, in its {section}: {reason}; build the file again")]
    Malformed {
        /// The name of the faulty section, or `header`.
        section: &'static str,
        /// The description of the fault.
        reason: String,
    },
    /// The file was built from another scene.
    #[error(
        "the .tets file was built from another scene, or with other flags for kinds of surfaces \
         (digest {found}, expected {wanted}); use the scene and flags of the file, or build it again"
    )]
    OtherScene {
        /// The digest in the file, in hexadecimal digits.
        found: String,
        /// The digest of the scene, in hexadecimal digits.
        wanted: String,
    },
}
