//! A crew as the scheduler sees it.

use std::collections::BTreeSet;

use super::pools::Profile;
use crate::ids::{Lease, WorkerId};

/// A leased tile whose leader can use helpers.
#[derive(Debug)]
pub(super) struct Crew {
    pub(super) lease: Lease,
    pub(super) profile: Profile,
    /// Workers that were sent and have not come back.
    pub(super) helpers: BTreeSet<WorkerId>,
}
