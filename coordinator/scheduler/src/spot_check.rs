//! A tile that another worker must compute again, and its answers so far. `spot_checks.rs` has the procedure.

use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_records::ids::{Digest, worker_name};

/// The signature of a worker: its name, with its identity where it has one.
pub(super) type Name = Arc<str>;

/// What somebody has computed for a tile.
#[derive(Clone, Debug)]
pub(super) struct Recomputation {
    pub(super) digest: Digest,
    /// Who has sent it.
    pub(super) author: Name,
    /// All who had a hand in it.
    pub(super) workers: BTreeSet<Name>,
}

impl Recomputation {
    /// Those who may have made it wrong, where others have made the right one.
    pub(super) fn guilty(&self, right: &BTreeSet<Name>) -> BTreeSet<Name> {
        let others: BTreeSet<Name> = self.workers.difference(right).cloned().collect();
        // Whoever has helped with the right one may have sent a wrong one alone.
        if others.is_empty() {
            BTreeSet::from([Name::clone(&self.author)])
        } else {
            others
        }
    }
}

/// A done tile that is to be checked.
#[derive(Clone, Debug)]
pub(super) struct SpotCheck {
    /// The first one is that of the tile.
    pub(super) answers: Vec<Recomputation>,
    pub(super) tries: u32,
    pub(super) not_before: u64,
    /// Since when nobody is there who could check it, although the job lacks nothing else.
    pub(super) without_checker_since: Option<u64>,
    /// Whether somebody may check it who has helped with it, because nobody else is there.
    pub(super) helpers_may: bool,
    /// Whether it was said that a third worker is needed.
    pub(super) told: bool,
    /// The tile's own answer was wrong: it waits to be computed again.
    pub(super) condemned: bool,
}

impl SpotCheck {
    pub(super) fn of(digest: Digest, author: Name, mut workers: BTreeSet<Name>) -> Self {
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

    /// Returns true if a worker with this signature must not check the tile. A worker without credentials has
    /// another identity after a restart, so signatures with the same name count as one.
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
