//! The lists from which tiles and workers are matched: one pool for each numerics profile, and the jobs that
//! have no profile yet.
//!
//! Each list holds numbers alone and is changed together with the job or worker that it is about.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use sightline_model::TracerChoice;
use sightline_records::ids::{JobId, LeaseId, TileIndex, WorkerId};

use super::queue::{Queue, ServiceOrder};

/// The place of a job in lists that know no users: higher priorities first, then older jobs.
pub(super) type QueuePosition = (Reverse<i32>, JobId);

/// The name of a numerics profile.
pub(super) type Profile = Arc<str>;

/// The list that a job with ready tiles is in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum List {
    /// The pool of its profile.
    Bound(Profile),
    /// Those without a profile, by what they ask for.
    Unbound(Choice),
}

/// The index of the choice of a tracer, or of none.
pub(super) type Choice = usize;

/// Number of choices.
pub(super) const CHOICES: usize = 4;

/// The index of a choice.
pub(super) fn index(choice: Option<TracerChoice>) -> Choice {
    match choice {
        Some(TracerChoice::Cpu) => 0,
        Some(TracerChoice::Gpu) => 1,
        Some(TracerChoice::Auto) => 2,
        None => 3,
    }
}

/// Helpers of all crews together, about, from which on each crew gets fewer.
const HELPERS: usize = 256;
/// Most helpers of a crew, when there are many crews and when there are few.
const MOST_HELPERS: [usize; 2] = [7, 31];

/// Most helpers of each of a number of crews. Every outcome goes to every helper: with more of them the
/// coordinator's network sets the pace, and all crews take longer (docs/experiments/crews.md).
pub(super) fn most_helpers(crews: usize) -> usize {
    let [least, most] = MOST_HELPERS;
    (HELPERS / crews.max(1)).clamp(least, most)
}

/// The workers and jobs of one profile.
#[derive(Debug, Default)]
pub(super) struct Pool {
    /// Connected workers.
    pub(super) able: u64,
    /// Those of them for which it is the only profile that `auto` considers.
    pub(super) alone: u64,
    /// Workers without a lease that do not drain, whether or not they want tiles.
    pub(super) idle: BTreeSet<WorkerId>,
    /// Workers that want tiles: those without a lease, and those with one.
    pub(super) hungry: [BTreeSet<WorkerId>; 2],
    /// Jobs with ready tiles.
    pub(super) jobs: Queue<JobId>,
    /// Ready tiles of these jobs.
    pub(super) ready: usize,
    /// Leased tiles that have not begun because their worker is busy with another one.
    pub(super) waiting: BTreeSet<(QueuePosition, TileIndex, LeaseId)>,
    /// Leases that have begun, by the time when they did.
    pub(super) begun: BTreeSet<(u64, LeaseId)>,
    /// Workers that can be sent to a crew.
    pub(super) helpers: BTreeSet<WorkerId>,
    /// Crews, by the number of their helpers for each user.
    pub(super) crews: Queue<(usize, LeaseId)>,
    /// Number of these.
    pub(super) crew_count: usize,
}

impl Pool {
    /// The crew that is the next to get a helper, with the turn of its user, unless all have their most.
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

/// All lists.
#[derive(Debug, Default)]
pub(super) struct Pools {
    pub(super) of: BTreeMap<Profile, Pool>,
    /// Jobs without a profile that have ready tiles, by choice.
    pub(super) unbound: [BTreeSet<QueuePosition>; CHOICES],
    /// Workers that want tiles, by the choices that they can serve.
    pub(super) hungry: [BTreeSet<WorkerId>; CHOICES],
    /// The pools that changed since they were last looked at.
    pub(super) dirty: BTreeSet<Profile>,
}

impl Pools {
    /// The pool of a profile, to be changed.
    pub(super) fn at(&mut self, profile: &Profile) -> &mut Pool {
        self.dirty.insert(Arc::clone(profile));
        self.of.entry(Arc::clone(profile)).or_default()
    }

    /// Removes the pool of a profile that nobody uses.
    pub(super) fn tidy(&mut self, profile: &Profile) {
        if self.of.get(profile).is_some_and(Pool::is_empty) {
            self.of.remove(profile);
            self.dirty.remove(profile);
        }
    }
}
