//! The ownership of blobs: a coordinator removes only blobs that belong to its own store.
//!
//! A blob without a record that references it looks unreferenced. With the records of another store, or with
//! a new store in place of a lost one, every blob looks unreferenced. So a blob store contains the name of
//! the store that it belongs to ([`StoreIdentity`](sightline_store::StoreIdentity)), and the removal checks
//! this name first.

use std::sync::Arc;

use sightline_store::{Blobs, StoreId};

use crate::blobs::references::KeepingError;
use crate::coordinator::Coordinator;
use crate::telemetry::events::{EventKind, LogEvent};

/// The relation of a blob store to a store of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ownership {
    /// The blobs belong to the store.
    Own,
    /// The blobs belong to another store.
    Foreign(StoreId),
    /// The blob store contains no name of a store: it is empty, or the records may be new or wrong.
    Unnamed,
}

impl Ownership {
    /// Returns the reason why blobs must not be removed, with the remedy, or `None` if they may be removed.
    pub fn refusal(self) -> Option<String> {
        let reason = match self {
            Self::Own => return None,
            Self::Foreign(owner) => format!("the blobs belong to another store, {owner}"),
            Self::Unnamed => {
                "blobs exist but do not name their store, so the records may belong to another \
                 store, be new, or come from an earlier version"
                    .to_owned()
            }
        };
        Some(format!(
            "{reason}: unreferenced blobs are not removed; check --data-dir, --store and --blobs, or run \
             `sightline store verify --claim-blobs` with them if the blobs belong to this store"
        ))
    }
}

/// Returns the relation of the blobs to the store `own`. An empty blob store receives the name `own`.
///
/// # Errors
/// [`KeepingError`] if the blobs cannot be read, or the name cannot be written.
pub fn check(own: StoreId, blobs: &dyn Blobs) -> Result<Ownership, KeepingError> {
    let relation = inspect(own, blobs)?;
    if relation == Ownership::Unnamed && is_empty(blobs)? {
        blobs.claim(own)?;
        return Ok(Ownership::Own);
    }
    Ok(relation)
}

/// Returns the relation of the blobs to the store `own`, without changes.
///
/// # Errors
/// [`KeepingError`] if the blobs cannot be read.
pub fn inspect(own: StoreId, blobs: &dyn Blobs) -> Result<Ownership, KeepingError> {
    Ok(match blobs.owner()? {
        Some(owner) if owner == own => Ownership::Own,
        Some(owner) => Ownership::Foreign(owner),
        None => Ownership::Unnamed,
    })
}

fn is_empty(blobs: &dyn Blobs) -> Result<bool, KeepingError> {
    let mut is_empty = true;
    blobs.visit(&mut |_| {
        is_empty = false;
        false
    })?;
    Ok(is_empty)
}

/// Returns true if the coordinator may remove unreferenced blobs. Otherwise logs the reason and records an
/// event.
pub(crate) fn may_remove(c: &Arc<Coordinator>) -> bool {
    let own = c.records.identity().map_err(KeepingError::from);
    let relation = own.and_then(|own| check(own.id(), &*c.blobs));
    match relation.map(Ownership::refusal) {
        Ok(None) => true,
        Ok(Some(refusal)) => {
            tracing::warn!("{refusal}");
            c.record_event(LogEvent::new(EventKind::Coordinator, refusal));
            false
        }
        Err(e) => {
            tracing::warn!("the owner of the blobs is unknown, so no blob is removed: {e}");
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_store::{FileBlobs, MemoryBlobs, MemoryStore, Store as _};

    fn id(store: &MemoryStore) -> StoreId {
        store.identity().unwrap().id()
    }

    #[test]
    fn blobs_belong_to_first_store_until_claimed() {
        let folder = tempfile::tempdir().unwrap();
        let stores: [Box<dyn Blobs>; 2] = [
            Box::new(MemoryBlobs::new()),
            Box::new(FileBlobs::open(folder.path()).unwrap()),
        ];
        for blobs in stores {
            let (first, second) = (MemoryStore::new(), MemoryStore::new());
            assert_eq!(check(id(&first), &*blobs).unwrap(), Ownership::Own);
            blobs.put(b"walls").unwrap();
            assert_eq!(check(id(&first), &*blobs).unwrap(), Ownership::Own);
            let owner = id(&first);
            assert_eq!(
                check(id(&second), &*blobs).unwrap(),
                Ownership::Foreign(owner)
            );
            blobs.claim(id(&second)).unwrap();
            assert_eq!(check(id(&second), &*blobs).unwrap(), Ownership::Own);
        }
    }

    #[test]
    fn new_store_does_not_own_existing_blobs() {
        let blobs = MemoryBlobs::new();
        blobs.put(b"walls").unwrap();
        assert_eq!(
            check(id(&MemoryStore::new()), &blobs).unwrap(),
            Ownership::Unnamed
        );
        assert!(
            Ownership::Unnamed
                .refusal()
                .unwrap()
                .contains("--claim-blobs")
        );
    }

    #[test]
    fn unreadable_owner_is_error() {
        let folder = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(folder.path()).unwrap();
        std::fs::write(folder.path().join("store-identity"), "walls").unwrap();
        let error = check(id(&MemoryStore::new()), &blobs)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("store-identity") && error.contains("--claim-blobs"),
            "{error}"
        );
    }
}
