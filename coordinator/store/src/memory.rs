//! The store in memory, for tests and for measurements of the cost of durability. Dropping it loses its
//! state.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use super::engine::Engine;
use super::error::StoreError;
use super::rules::{self, Decision};
use super::table::{Bytes, View};

/// A store without a disk, with the same rules and answers as the store on a disk.
#[derive(Debug, Default)]
pub struct MemoryStore {
    table: Mutex<BTreeMap<Bytes, Bytes>>,
}

impl MemoryStore {
    /// Creates an empty store.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a store with these entries.
    pub(super) fn with(entries: BTreeMap<Bytes, Bytes>) -> Self {
        Self {
            table: Mutex::new(entries),
        }
    }
}

impl Engine for MemoryStore {
    fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError> {
        // All changes are computed before the first is made, so a panic cannot leave the table half changed.
        ask(View(
            &*self.table.lock().unwrap_or_else(PoisonError::into_inner),
        ))
    }

    fn command<A: Send + 'static>(
        &self,
        decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
    ) -> Result<A, StoreError> {
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let Decision { event, answer } = decide(View(&*table))?;
        if let Some(event) = event {
            for (key, value) in rules::changes(&event, &*table)? {
                match value {
                    Some(value) => table.insert(key, value),
                    None => table.remove(&key),
                };
            }
        }
        Ok(answer)
    }
}
