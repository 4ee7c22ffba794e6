//! A tile that another worker must compute again, and its answers so far. `spot_checks.rs` has the procedure.

use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_records::ids::{Digest, worker_name};

/// The signature of a worker: its name, and its identity if it has one.
pub(super) type Name = Arc<str>;

/// An answer: the output that a worker has computed for a tile.
#[derive(Clone, Debug)]
pub(super) struct Recomputation {
    pub(super) digest: Digest,
    /// The worker that sent the output.
    pub(super) author: Name,
    /// All workers that contributed to the output.
    pub(super) workers: BTreeSet<Name>,
}

impl Recomputation {
    /// Returns the workers that may have made this output wrong. `right` contains the workers of the right
    /// output.
    pub(super) fn guilty(&self, right: &BTreeSet<Name>) -> BTreeSet<Name> {
        let others: BTreeSet<Name> = self.workers.difference(right).cloned().collect();
        // If all contributors also contributed to the right output, only the sender can have erred.
        if others.is_empty() {
            BTreeSet::from([Name::clone(&self.author)])
        } else {
            others
        }
    }
}

/// A done tile that must be checked.
#[derive(Clone, Debug)]
pub(super) struct SpotCheck {
    /// The answers so far. The first one is the output of the tile.
    pub(super) answers: Vec<Recomputation>,
    pub(super) tries: u32,
    pub(super) not_before: u64,
    /// The time since which no possible checker exists although the job only lacks checks, in milliseconds.
    pub(super) without_checker_since: Option<u64>,
    /// True if a helper of the tile may check it, because no other worker exists.
    pub(super) helpers_may: bool,
    /// True if the log states that a third worker is needed.
    pub(super) told: bool,
    /// True if the tile's own output was wrong, so that the tile waits to be computed again.
    pub(super) condemned: bool,
}

impl SpotCheck {
    /// Creates the check of a done tile. `workers` are the contributors to its output.
    pub(super) fn new(digest: Digest, author: Name, mut workers: BTreeSet<Name>) -> Self {
        workers.insert(Name::clone(&author));
        Self {
            answers: vec![Recomputation {
                digest,
                author,
                workers,
            }],
            tries: 0,
            not_before: 0,
            without_checker_since: None,
            helpers_may: false,
            told: false,
            condemned: false,
        }
    }

    /// Returns true if a worker with this signature must not check the tile.
    ///
    /// A worker without credentials has another identity after a restart, so signatures with the same name
    /// count as one worker.
    pub(super) fn knows(&self, signature: &str) -> bool {
        let name = worker_name(signature);
        let is_same = |other: &Name| worker_name(other) == name;
        let has_hand =
            |answer: &Recomputation| !self.helpers_may && answer.workers.iter().any(is_same);
        self.answers
            .iter()
            .any(|answer| is_same(&answer.author) || has_hand(answer))
    }

    pub(super) fn is_disputed(&self) -> bool {
        self.answers.len() > 1
    }
}
