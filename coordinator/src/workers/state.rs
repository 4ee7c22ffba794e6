//! The state of workers outside the scheduler: crews, proofs of leases and proofs of identities.

use sightline_store::StoreIdentity;

use crate::workers::crews::Crews;
use crate::workers::identity::IdentityProofs;
use crate::workers::lease_tags::LeaseTags;

/// The state of workers outside the scheduler.
pub(crate) struct WorkerState {
    /// Crews, and the outcomes of the phases of unfinished tiles.
    pub(crate) crews: Crews,
    /// The proofs of leases.
    pub(crate) lease_tags: LeaseTags,
    /// The proofs of the identities of workers.
    pub(crate) identities: IdentityProofs,
}

impl WorkerState {
    /// Creates the state. `identity` is the identity of the store, from which the proofs derive their keys.
    pub(crate) fn new(identity: &StoreIdentity, crews: Crews) -> Self {
        Self {
            crews,
            lease_tags: LeaseTags::new(identity),
            identities: IdentityProofs::new(identity),
        }
    }
}
