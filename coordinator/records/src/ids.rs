//! Types of the numbers and digests that identify jobs, tiles, workers and leases.
//!
//! A [`JobId`] serialises as its bare number, so the format of records and of the journal does not depend on
//! the type. The other types are not serialised.

use std::fmt;

use serde::{Deserialize, Serialize};

pub use sightline_numbers::ids::TileIndex;

/// A BLAKE3 digest (32 bytes): the name of a blob or a scene, or the key of a job.
pub type Digest = [u8; 32];

/// Returns the digest as 64 hexadecimal digits.
pub fn hex(digest: &Digest) -> String {
    blake3::Hash::from_bytes(*digest).to_hex().to_string()
}

/// The number of a job, counted from 1 in the order of submission and never reused.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct JobId(pub u64);

/// The number of a worker's connection. A worker that reconnects gets another number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorkerId(pub u64);

/// The number of a coordinator's start on its store, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Epoch(pub u64);

/// The identity of a grant of a tile. No two grants of one store have the same identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeaseId {
    /// The epoch in which the tile was granted.
    pub epoch: Epoch,
    /// The number of the grant, counted from 1 in each epoch.
    pub number: u64,
}

/// A lease of a tile: the job, the tile and the identity of the grant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lease {
    /// The job of the tile.
    pub job: JobId,
    /// The index of the tile in the job.
    pub tile: TileIndex,
    /// The identity of the grant.
    pub id: LeaseId,
}

/// A worker's 64-bit identity, which distinguishes workers of the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkerIdentity(pub u64);

/// The separator between the name and the identity in a worker's signature.
const SEPARATOR: char = '#';

/// Returns the signature of a worker: its name and its identity, as `NAME#0123456789abcdef`.
pub fn signature(name: &str, WorkerIdentity(number): WorkerIdentity) -> String {
    format!("{name}{SEPARATOR}{number:016x}")
}

/// Returns the worker's name from a signature. A text without an identity is returned unchanged.
pub fn worker_name(signature: &str) -> &str {
    match signature.rsplit_once(SEPARATOR) {
        Some((name, id)) if id.len() == 16 && id.bytes().all(|b| b.is_ascii_hexdigit()) => name,
        _ => signature,
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl From<u64> for JobId {
    fn from(number: u64) -> Self {
        Self(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signature_contains_name() {
        let signed = signature("a#b", WorkerIdentity(0x1f));
        assert_eq!(signed, "a#b#000000000000001f");
        assert_eq!(worker_name(&signed), "a#b");
        assert_eq!(worker_name("ada"), "ada");
        assert_eq!(worker_name("a#b"), "a#b");
    }
}
