//! Who has sent which chunks, until they are a scene: what others have sent opens nothing, and what was
//! stored before is not removed with the chunks.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use crate::ids::Digest;

/// Most chunks of an owner that are kept in mind: those of two of the largest scenes. Who sends more without
/// putting a scene has to send the earlier ones again.
const MOST: usize = 131_072;

/// The chunks of each owner, and whether each was new to the store. Nobody is an owner, too.
#[derive(Default)]
pub(crate) struct Uploads(Mutex<BTreeMap<String, Chunks>>);

/// The chunks of an owner.
#[derive(Default)]
struct Chunks {
    of: BTreeMap<Digest, Sent>,
    bytes: u64,
}

/// A chunk that was sent.
#[derive(Clone, Copy, Debug, Default)]
struct Sent {
    is_new: bool,
    bytes: u32,
}

impl Uploads {
    /// An owner has sent a chunk.
    pub(crate) fn note(&self, owner: &str, chunk: Digest, bytes: u32, is_new: bool) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = all.entry(owner.to_owned()).or_default();
        if own.of.len() >= MOST && !own.of.contains_key(&chunk) {
            *own = Chunks::default();
        }
        let sent = own.of.entry(chunk).or_default();
        sent.is_new |= is_new;
        // By its digest it has the same length as before.
        own.bytes += u64::from(bytes - std::mem::replace(&mut sent.bytes, bytes));
    }

    /// Bytes of the chunks of an owner.
    pub(crate) fn bytes(&self, owner: &str) -> u64 {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.get(owner).map_or(0, |own| own.bytes)
    }

    /// Whether an owner has sent a chunk. Where nothing has an owner everybody has.
    pub(crate) fn has(&self, owner: &str, chunk: &Digest) -> bool {
        let all = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        owner.is_empty() || all().get(owner).is_some_and(|own| own.of.contains_key(chunk))
    }

    /// Forgets the chunks of a scene that is stored; gives those that were new to the store.
    pub(crate) fn forget(&self, owner: &str, chunks: &[Digest]) -> Vec<Digest> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(own) = all.get_mut(owner) else { return Vec::new() };
        let mut new = Vec::new();
        for chunk in chunks {
            let Some(sent) = own.of.remove(chunk) else { continue };
            own.bytes -= u64::from(sent.bytes);
            if sent.is_new {
                new.push(*chunk);
            }
        }
        if own.of.is_empty() {
            all.remove(owner);
        }
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_are_their_senders_and_only_new_ones_are_removed() {
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

    #[test]
    fn an_owner_who_never_finishes_is_not_kept_in_mind_for_ever() {
        let uploads = Uploads::default();
        for n in 0..=MOST {
            let mut digest = [0; 32];
            digest[..8].copy_from_slice(&(n as u64).to_le_bytes());
            uploads.note("ada", digest, 1, true);
        }
        assert_eq!(uploads.0.lock().unwrap()["ada"].of.len(), 1);
        assert_eq!(uploads.bytes("ada"), 1);
    }
}
