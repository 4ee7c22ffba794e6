//! The scheduler's data about a crew.

use std::collections::BTreeMap;

use sightline_records::ids::{Lease, WorkerId};

use super::pools::Profile;
use super::queue::QueueKey;

/// A leased tile whose leader can use helpers.
#[derive(Debug)]
pub(super) struct Crew {
    pub(super) lease: Lease,
    pub(super) profile: Profile,
    /// The user and the priority of the crew's job.
    pub(super) key: QueueKey,
    /// The workers that were sent to help and have not returned, with the time at which they were sent, in
    /// milliseconds.
    pub(super) helpers: BTreeMap<WorkerId, u64>,
}
