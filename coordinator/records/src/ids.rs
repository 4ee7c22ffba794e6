//! Types of the numbers and digests that identify jobs, tiles, workers and leases.
//!
//! Each serialises as its bare number, so records and the journal do not depend on these types.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A BLAKE3 digest (32 bytes): the name of a blob, a scene or a job's key.
pub type Digest = [u8; 32];

/// The digest as 64 hexadecimal digits.
pub fn hex(digest: &Digest) -> String {
    blake3::Hash::from_bytes(*digest).to_hex().to_string()
}

/// A job, counted from 1 in the order of submission and never reused.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct JobId(pub u64);

/// A tile of a job: its index in the job's plan, from 0.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct TileIndex(pub u32);

impl TileIndex {
    /// The index into a plan's or a job's list of tiles.
    pub fn at(self) -> usize {
        self.0 as usize
    }
}

/// A worker's connection. A worker that reconnects gets another number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorkerId(pub u64);

/// A start of the coordinator on its store, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Epoch(pub u64);

/// A grant of a tile. No two grants of one store have the same identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeaseId {
    /// The epoch in which the tile was granted.
    pub epoch: Epoch,
    /// The number of the grant within the epoch, from 1.
    pub number: u64,
}

/// A lease and the tile it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lease {
    /// The job.
    pub job: JobId,
    /// The tile of the job.
    pub tile: TileIndex,
    /// The grant.
    pub id: LeaseId,
}

/// A worker's identity, in addition to its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkerIdentity(pub u64);

/// The separator between the name and the identity of a worker.
const SEPARATOR: char = '#';

/// Returns the signature of a worker, its name with its identity: `NAME#0123456789abcdef`.
pub fn signature(name: &str, WorkerIdentity(number): WorkerIdentity) -> String {
    format!("{name}{SEPARATOR}{number:016x}")
}

/// Returns the name within a signature. A text without an identity is a name.
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

impl fmt::Display for TileIndex {
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
