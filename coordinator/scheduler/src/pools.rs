//! The lists that match tiles with workers. There is one pool for each numerics profile, and a list of jobs
//! without a profile.
//!
//! Each list contains only numbers, and changes together with the job or the worker that an entry refers to.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_model::TracerChoice;
use sightline_records::ids::{JobId, LeaseId, TileIndex, WorkerId};

use super::queue::{Queue, ServiceOrder};

/// The position of a job in lists that do not depend on users: higher priorities first, then older jobs.
pub(super) type QueuePosition = (Reverse<i32>, JobId);

/// The name of a numerics profile.
pub(super) type Profile = Arc<str>;

/// The list that contains a job with ready tiles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum List {
    /// The pool of the job's profile.
    Bound(Profile),
    /// The list of the jobs without a profile that have this tracer choice.
    Unbound(Choice),
}

/// The index of a job's tracer choice; the last index is for jobs without a choice.
pub(super) type Choice = usize;

/// The number of choices.
pub(super) const CHOICES: usize = 5;

/// Returns the index of a tracer choice.
pub(super) fn index(choice: Option<TracerChoice>) -> Choice {
    match choice {
        Some(TracerChoice::Cpu) => 0,
        Some(TracerChoice::Gpu) => 1,
        Some(TracerChoice::Auto) => 2,
        Some(TracerChoice::Embree) => 3,
        None => 4,
    }
}

/// The number of helpers that all crews of a profile share. With more crews, each crew gets fewer helpers.
const HELPERS: usize = 256;
/// Maximum number of helpers per crew: with many crews, and with few crews.
const MOST_HELPERS: [usize; 2] = [7, 31];

/// Returns the maximum number of helpers per crew for a number of crews.
///
/// Every outcome is sent to every helper. With more helpers the coordinator's network becomes the bottleneck,
/// and all crews take longer (docs/experiments/crews.md).
pub(super) fn most_helpers(crews: usize) -> usize {
    let [least, most] = MOST_HELPERS;
    (HELPERS / crews.max(1)).clamp(least, most)
}

/// The workers and jobs of one profile.
#[derive(Debug, Default)]
pub(super) struct Pool {
    /// The number of connected workers that support the profile.
    pub(super) able: u64,
    /// The number of these workers for which this is the only profile that `auto` considers.
    pub(super) alone: u64,
    /// The workers without a lease that do not drain, whether or not they request tiles.
    pub(super) idle: BTreeSet<WorkerId>,
    /// The workers that request tiles: first the workers without a lease, then the workers with one.
    pub(super) hungry: [BTreeSet<WorkerId>; 2],
    /// The jobs with ready tiles.
    pub(super) jobs: Queue<JobId>,
    /// The number of ready tiles of these jobs.
    pub(super) ready: usize,
    /// The leased tiles that have not begun because their worker computes another tile.
    pub(super) waiting: BTreeSet<(QueuePosition, TileIndex, LeaseId)>,
    /// The leases that have begun, by their time of begin.
    pub(super) begun: BTreeSet<(u64, LeaseId)>,
    /// The workers that can be sent to a crew.
    pub(super) helpers: BTreeSet<WorkerId>,
    /// The crews, ordered by their number of helpers for each user.
    pub(super) crews: Queue<(usize, LeaseId)>,
    /// The number of crews.
    pub(super) crew_count: usize,
}

impl Pool {
    /// Returns the next crew to get a helper, with its user's turn. Returns `None` if all crews have the
    /// maximum number of helpers.
    pub(super) fn crew_with_room(&self) -> Option<(&ServiceOrder, (usize, LeaseId))> {
        let most = most_helpers(self.crew_count);
        self.crews
            .first_that(|(helpers, _)| *helpers < most)
            .map(|(turn, crew)| (turn, *crew))
    }

    fn is_empty(&self) -> bool {
        let empty = self.jobs.is_empty() && self.waiting.is_empty() && self.begun.is_empty();
        self.able == 0 && empty && self.crews.is_empty()
    }
}

/// The pools of all profiles, and the lists for jobs without a profile.
#[derive(Debug, Default)]
pub(super) struct Pools {
    pub(super) by_profile: BTreeMap<Profile, Pool>,
    /// The jobs without a profile that have ready tiles, by tracer choice.
    pub(super) unbound: [BTreeSet<QueuePosition>; CHOICES],
    /// The workers that request tiles, by the tracer choices that they can serve.
    pub(super) hungry: [BTreeSet<WorkerId>; CHOICES],
    /// The profiles whose pools have changed since the scheduler last granted tiles of them.
    pub(super) dirty: BTreeSet<Profile>,
}

impl Pools {
    /// Returns the pool of a profile for a change, and marks it as changed.
    pub(super) fn at(&mut self, profile: &Profile) -> &mut Pool {
        self.dirty.insert(Arc::clone(profile));
        self.by_profile.entry(Arc::clone(profile)).or_default()
    }

    /// Removes the pool of a profile if it is empty.
    pub(super) fn tidy(&mut self, profile: &Profile) {
        if self.by_profile.get(profile).is_some_and(Pool::is_empty) {
            self.by_profile.remove(profile);
            self.dirty.remove(profile);
        }
    }
}
