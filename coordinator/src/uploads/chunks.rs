//! The uploaded chunks of each owner, until they form a scene.
//!
//! An owner can use only chunks that the owner has uploaded. Removing an owner's chunks does not remove blobs
//! that existed before.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use sightline_records::ids::Digest;

/// Maximum number of an owner's chunks that are not joined to a scene. Two of the largest scenes have as many
/// chunks. Further chunks of a named owner are rejected. At the limit, the chunks without an owner are
/// removed, and have to be uploaded again.
pub(crate) const MAX_CHUNKS: usize = 131_072;

/// The chunks of each owner, each with a flag that is true if the chunk was new to the store. The empty owner
/// counts as an owner.
#[derive(Default)]
pub(crate) struct Uploads(Mutex<BTreeMap<String, Chunks>>);

/// The chunks of an owner.
#[derive(Default)]
struct Chunks {
    by_digest: BTreeMap<Digest, Sent>,
    bytes: u64,
}

/// An uploaded chunk.
#[derive(Clone, Copy, Debug)]
struct Sent {
    is_new: bool,
    bytes: u32,
    at: Instant,
}

impl Uploads {
    /// Returns true if an owner may upload another chunk.
    pub(crate) fn has_room(&self, owner: &str) -> bool {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        owner.is_empty()
            || all
                .get(owner)
                .is_none_or(|own| own.by_digest.len() < MAX_CHUNKS)
    }

    /// Records that an owner has uploaded a chunk.
    pub(crate) fn note(&self, owner: &str, chunk: Digest, bytes: u32, is_new: bool) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = all.entry(owner.to_owned()).or_default();
        // Without an owner no quota applies, and every caller may join every chunk.
        if owner.is_empty()
            && own.by_digest.len() >= MAX_CHUNKS
            && !own.by_digest.contains_key(&chunk)
        {
            *own = Chunks::default();
        }
        let at = Instant::now();
        let sent = own.by_digest.entry(chunk).or_insert(Sent {
            is_new: false,
            bytes: 0,
            at,
        });
        (sent.is_new, sent.at) = (sent.is_new | is_new, at);
        // A chunk with the same digest has the same length as before.
        own.bytes += u64::from(bytes - std::mem::replace(&mut sent.bytes, bytes));
    }

    /// Removes the chunks that were uploaded longer than `grace` ago and whose blob no longer exists. A chunk
    /// counts for its owner as long as its blob is on the disk.
    pub(crate) fn forget_removed(&self, grace: Duration, is_stored: impl Fn(&Digest) -> bool) {
        // Inspect the files without the lock.
        let old: Vec<(String, Digest)> = {
            let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let old_chunks_of = |(owner, own): (&String, &Chunks)| {
                let old = own
                    .by_digest
                    .iter()
                    .filter(|(_, sent)| sent.at.elapsed() >= grace);
                old.map(|(chunk, _)| (owner.clone(), *chunk))
                    .collect::<Vec<_>>()
            };
            all.iter().flat_map(old_chunks_of).collect()
        };
        for (owner, chunk) in old.into_iter().filter(|(_, chunk)| !is_stored(chunk)) {
            self.forget(&owner, &[chunk]);
        }
    }

    /// Returns the size of an owner's chunks in bytes.
    pub(crate) fn bytes(&self, owner: &str) -> u64 {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.get(owner).map_or(0, |own| own.bytes)
    }

    /// Returns true if an owner has uploaded a chunk. The empty owner (no authentication) has every chunk.
    pub(crate) fn has(&self, owner: &str, chunk: &Digest) -> bool {
        let all = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        owner.is_empty()
            || all()
                .get(owner)
                .is_some_and(|own| own.by_digest.contains_key(chunk))
    }

    /// Removes the chunks of a stored scene. Returns the removed chunks that were new to the store.
    pub(crate) fn forget(&self, owner: &str, chunks: &[Digest]) -> Vec<Digest> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(own) = all.get_mut(owner) else {
            return Vec::new();
        };
        let mut new = Vec::new();
        for chunk in chunks {
            let Some(sent) = own.by_digest.remove(chunk) else {
                continue;
            };
            own.bytes -= u64::from(sent.bytes);
            if sent.is_new {
                new.push(*chunk);
            }
        }
        if own.by_digest.is_empty() {
            all.remove(owner);
        }
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_belong_to_sender_and_only_new_ones_are_removed() {
        let uploads = Uploads::default();
        let (a, b) = ([1; 32], [2; 32]);
        uploads.note("ada", a, 10, true);
        uploads.note("ada", a, 10, false);
        uploads.note("ada", b, 7, false);
        assert_eq!((uploads.bytes("ada"), uploads.bytes("bob")), (17, 0));
        assert!(uploads.has("ada", &a) && !uploads.has("bob", &a) && uploads.has("", &a));
        assert_eq!(uploads.forget("ada", &[a, b, [3; 32]]), [a]);
        assert!(!uploads.has("ada", &a) && !uploads.has("ada", &b));
        assert!(uploads.0.lock().unwrap().is_empty());
    }

    fn digest(n: usize) -> Digest {
        let mut digest = [0; 32];
        digest[..8].copy_from_slice(&(n as u64).to_le_bytes());
        digest
    }

    #[test]
    fn owner_keeps_bytes_of_any_number_of_chunks() {
        let uploads = Uploads::default();
        for owner in ["ada", ""] {
            for n in 0..MAX_CHUNKS {
                uploads.note(owner, digest(n), 1, true);
            }
        }
        assert!(!uploads.has_room("ada") && uploads.has_room("bob") && uploads.has_room(""));
        // A chunk that another call was sending at the limit counts, too.
        uploads.note("ada", digest(MAX_CHUNKS), 1, true);
        assert_eq!(uploads.bytes("ada"), MAX_CHUNKS as u64 + 1);
        // Chunks without an owner do not fill the memory.
        uploads.note("", digest(MAX_CHUNKS), 1, true);
        assert_eq!(uploads.0.lock().unwrap()[""].by_digest.len(), 1);
    }

    #[test]
    fn chunk_counts_until_its_blob_is_removed() {
        let uploads = Uploads::default();
        for n in 0..3 {
            uploads.note("ada", digest(n), 10, true);
        }
        uploads.forget_removed(Duration::from_secs(3600), |_| false);
        assert_eq!(uploads.bytes("ada"), 30);
        uploads.forget_removed(Duration::ZERO, |chunk| *chunk == digest(1));
        assert_eq!(uploads.bytes("ada"), 10);
    }
}
