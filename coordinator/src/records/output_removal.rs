//! The removal of outputs of tiles and of results.

use std::sync::{PoisonError, RwLockWriteGuard};

use sightline_records::ids::Digest;
use sightline_store::StoreError;

use crate::locks::{Rank, Ranked, ranked};
use crate::state::Coordinator;

/// The removal of outputs, under the exclusive lock of outputs: no output is committed in the meantime. Code
/// that removes blobs of outputs or results holds one.
pub(crate) struct OutputRemoval<'c> {
    c: &'c Coordinator,
    _exclusive: Ranked<RwLockWriteGuard<'c, ()>>,
}

impl<'c> OutputRemoval<'c> {
    /// Waits for the lock.
    pub(crate) fn begin(c: &'c Coordinator) -> Self {
        let outputs = &c.store.outputs;
        Self {
            c,
            _exclusive: ranked(Rank::Outputs, || {
                outputs.write().unwrap_or_else(PoisonError::into_inner)
            }),
        }
    }

    /// Removes blobs that no record needs. A fault is logged, and retention removes the blob later.
    ///
    /// # Errors
    /// A coordinator that leads no longer: it does not know the records of its successor.
    pub(crate) fn remove(
        &self,
        digests: impl IntoIterator<Item = Digest>,
    ) -> Result<(), StoreError> {
        self.c.store.may_change()?;
        for digest in digests {
            if let Err(e) = self.c.blobs.remove(&digest) {
                tracing::warn!("{e}");
            }
        }
        Ok(())
    }
}
