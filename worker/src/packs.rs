//! A cache of compressed packs from the coordinator.
//!
//! The crate `lru` limits the number of values; this cache limits the sum of their bytes.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Maximum total size of the cached packs, compressed, in bytes. The cache pays off because neighbouring
/// tiles need mostly the same packs.
const ROOM: usize = 256 << 20;

/// Packs by digest. The oldest packs are dropped first.
#[derive(Default)]
pub struct PackCache {
    packs: Mutex<VecDeque<([u8; 32], bytes::Bytes)>>,
}

impl PackCache {
    /// Returns the pack if it is in the cache.
    pub fn get(&self, digest: &[u8; 32]) -> Option<bytes::Bytes> {
        let packs = self.packs.lock().unwrap_or_else(PoisonError::into_inner);
        packs
            .iter()
            .find(|(d, _)| d == digest)
            .map(|(_, b)| b.clone())
    }

    /// Adds a pack, unless it is larger than the cache.
    pub fn put(&self, digest: [u8; 32], pack: bytes::Bytes) {
        let mut packs = self.packs.lock().unwrap_or_else(PoisonError::into_inner);
        if pack.len() > ROOM || packs.iter().any(|(d, _)| *d == digest) {
            return;
        }
        packs.push_back((digest, pack));
        while packs.iter().map(|(_, b)| b.len()).sum::<usize>() > ROOM {
            packs.pop_front();
        }
    }
}
