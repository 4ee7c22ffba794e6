//! A phase of a block: its items, their answers, and the tables to which they write.
//!
//! [`run`] passes the phase to the crew ([`crate::crew`]) and returns the answers in the order of the items.

use std::sync::OnceLock;

use sightline_trace::lines::bits::SeenBits;
use sightline_trace::lines::pairs::Pairs;

use super::finds::{self, Finds, ItemResult};
use crate::context::TileError;
use crate::crew::{Crew, ForeignFinds, Phase};

/// The tables to which the items of a phase write.
#[derive(Clone, Copy)]
pub(super) struct Tables<'a> {
    pub(super) bits: Option<&'a SeenBits>,
    pub(super) pairs: Option<&'a Pairs>,
}

/// The definition of the items of a phase.
pub(super) struct Items<'a, A> {
    pub(super) count: usize,
    /// Creates the data that `compute` needs.
    pub(super) prepare: &'a (dyn Fn() + Sync),
    /// Returns the expected work of an item.
    pub(super) cost: &'a (dyn Fn(usize) -> u64 + Sync),
    pub(super) compute: &'a (dyn Fn(usize) -> Result<A, TileError> + Sync),
    /// Returns true if another member's answer can belong to this phase.
    pub(super) fits: &'a (dyn Fn(&A) -> bool + Sync),
}

/// Runs a phase with the crew, and returns the answers in the order of the items.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
pub(super) fn run<A: ItemResult>(
    crew: &dyn Crew,
    tables: Tables<'_>,
    items: Items<'_, A>,
) -> Result<Vec<A>, TileError> {
    let mut answers = Vec::new();
    answers.resize_with(items.count, OnceLock::new);
    let shared = Shared {
        tables,
        items,
        answers,
    };
    crew.run(&shared)?;
    if let Some(pairs) = tables.pairs {
        pairs.keep();
    }
    // If an answer is missing, the crew ended the phase too early, and the tile itself has no fault.
    shared
        .answers
        .into_iter()
        .map(|a| a.into_inner().ok_or(TileError::Cancelled))
        .collect()
}

struct Shared<'a, A> {
    tables: Tables<'a>,
    items: Items<'a, A>,
    answers: Vec<OnceLock<A>>,
}

impl<A: ItemResult> Shared<'_, A> {
    fn finds(&self, items: impl Iterator<Item = usize>) -> Vec<u8> {
        let answered = items.filter_map(|i| Some((i, self.answers[i].get()?)));
        finds::encode(
            self.answers.len(),
            answered,
            self.tables.bits,
            self.tables.pairs,
        )
    }
}

impl<A: ItemResult> Phase for Shared<'_, A> {
    fn items(&self) -> usize {
        self.items.count
    }

    fn prepare(&self) {
        (self.items.prepare)();
    }

    fn costs(&self) -> Vec<u64> {
        (0..self.items.count)
            .map(|item| (self.items.cost)(item))
            .collect()
    }

    fn compute(&self, item: usize, _: &(dyn Fn() -> bool + Sync)) -> Result<(), TileError> {
        let answer = (self.items.compute)(item)?;
        // Another member's answer, which is equal, may have arrived already.
        let _ = self.answers[item].set(answer);
        Ok(())
    }

    fn has(&self, item: usize) -> bool {
        self.answers
            .get(item)
            .is_some_and(|answer| answer.get().is_some())
    }

    fn take(&self, items: &[usize]) -> Vec<u8> {
        let mut items = items.to_vec();
        items.sort_unstable();
        items.dedup();
        let finds = self.finds(items.into_iter());
        if let Some(bits) = self.tables.bits {
            bits.forget();
        }
        if let Some(pairs) = self.tables.pairs {
            pairs.keep();
        }
        finds
    }

    fn add(&self, found: &[u8]) -> Result<u64, ForeignFinds> {
        let (bits, pairs) = (self.tables.bits, self.tables.pairs);
        let Finds {
            answers,
            seen,
            joined,
        } = finds::decode(found, self.answers.len(), bits, pairs)?;
        if !answers.iter().all(|(_, answer)| (self.items.fits)(answer)) {
            return Err(ForeignFinds(
                "an answer has counts for another number of cells",
            ));
        }
        // The bits are added before the answers: a thread that reads the answer must also have the bits.
        if let Some(bits) = bits {
            seen.into_iter().for_each(|(at, word)| bits.add(at, word));
        }
        if let Some(pairs) = pairs {
            joined
                .into_iter()
                .for_each(|(at, word)| pairs.add(at, word));
        }
        let mut rays = 0;
        for (item, answer) in answers {
            let own: &A = &answer;
            let cast = own.rays();
            if self.answers[item].set(answer).is_ok() {
                rays += cast;
            }
        }
        Ok(rays)
    }

    fn outcome(&self) -> Vec<u8> {
        self.finds(0..self.answers.len())
    }
}
