//! The removal of outputs of tiles and of results.

use std::sync::{PoisonError, RwLockWriteGuard};

use sightline_records::ids::Digest;
use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::locks::{Rank, Ranked, ranked};

/// The removal of outputs, under the exclusive lock of outputs. While it exists, no output is committed. Code
/// that removes blobs of outputs or results holds one.
pub(crate) struct OutputRemoval<'c> {
    c: &'c Coordinator,
    _exclusive: Ranked<RwLockWriteGuard<'c, ()>>,
}

impl<'c> OutputRemoval<'c> {
    /// Waits for the lock.
    pub(crate) fn begin(c: &'c Coordinator) -> Self {
        let outputs = &c.records.outputs;
        Self {
            c,
            _exclusive: ranked(Rank::Outputs, || {
                outputs.write().unwrap_or_else(PoisonError::into_inner)
            }),
        }
    }

    /// Removes blobs that no record references. A failure is logged, and retention removes the blob later.
    ///
    /// # Errors
    /// [`StoreError`] if this coordinator no longer leads, because it does not know the records of its
    /// successor.
    pub(crate) fn remove(
        &self,
        digests: impl IntoIterator<Item = Digest>,
    ) -> Result<(), StoreError> {
        self.c.records.may_change()?;
        for digest in digests {
            if let Err(e) = self.c.blobs.remove(&digest) {
                tracing::warn!("{e}");
            }
        }
        Ok(())
    }
}
