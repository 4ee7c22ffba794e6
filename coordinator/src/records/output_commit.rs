//! The commit of a tile's output.

use std::sync::{PoisonError, RwLockReadGuard};

use sightline_records::ids::Lease;
use sightline_records::{CommitOutcome, TileResult};
use sightline_scheduler::{Admission, NoTile};
use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::locks::{Rank, Ranked, check_store_call, ranked};

/// The commit of a tile's output, under the shared lock of outputs. While it exists, no output is removed and
/// no tile is reopened. Only this type commits outputs.
pub(crate) struct OutputCommit<'c> {
    c: &'c Coordinator,
    lease: Lease,
    _shared: Ranked<RwLockReadGuard<'c, ()>>,
}

impl<'c> OutputCommit<'c> {
    /// Waits for the lock and admits the lease under it, since a removal may have revoked the lease in the
    /// meantime.
    pub(crate) fn begin(c: &'c Coordinator, lease: Lease) -> Result<(Self, Admission), NoTile> {
        let outputs = &c.records.outputs;
        let commit = Self {
            c,
            lease,
            _shared: ranked(Rank::Outputs, || {
                outputs.read().unwrap_or_else(PoisonError::into_inner)
            }),
        };
        let admission = c.dispatcher.read(|scheduler| scheduler.admit(&lease))?;
        Ok((commit, admission))
    }

    /// Records the output of the lease's tile, whose blob is stored.
    pub(crate) fn record(&self, result: TileResult) -> Result<CommitOutcome, StoreError> {
        check_store_call();
        let Lease { job, tile, .. } = self.lease;
        self.c.records.store.commit_tile(job, tile, result)
    }
}
