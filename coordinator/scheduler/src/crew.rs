//! A crew as the scheduler sees it.

use std::collections::BTreeMap;

use sightline_records::ids::{Lease, WorkerId};

use super::pools::Profile;
use super::queue::QueueKey;

/// A leased tile whose leader can use helpers.
#[derive(Debug)]
pub(super) struct Crew {
    pub(super) lease: Lease,
    pub(super) profile: Profile,
    /// The user and priority of its job.
    pub(super) whom: QueueKey,
    /// Workers that were sent and have not come back, and when they were sent.
    pub(super) helpers: BTreeMap<WorkerId, u64>,
}
