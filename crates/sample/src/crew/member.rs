//! What a phase offers to the members of a crew, and what a crew offers to the sampler.

use crate::error::TileError;

/// Finds that cannot be those of the phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the finds of another member are no finds of this phase: {0}")]
pub struct ForeignFinds(pub &'static str);

/// A phase as one member works on it.
pub trait Phase: Sync {
    /// The number of items.
    fn items(&self) -> usize;

    /// Prepares [`Phase::compute`]. To be called once, on no thread of rayon's pool, and not at all by a
    /// member that computes no item.
    fn prepare(&self);

    /// The expected work of each item, in one unit. After [`Phase::prepare`].
    fn costs(&self) -> Vec<u64>;

    /// Computes an item, on any thread. Computing an item again changes nothing. Gives up without an answer,
    /// if that saves much, once `is_needless` says so.
    ///
    /// # Errors
    /// [`TileError`] when the tile is cancelled or the backend fails.
    fn compute(
        &self,
        item: usize,
        is_needless: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), TileError>;

    /// Whether the answer of an item is here.
    fn has(&self, item: usize) -> bool;

    /// The finds of items computed here, for another member; they must be computed, and no other item may be
    /// in work. The finds are taken out: they come back with the outcome.
    fn take(&self, items: &[usize]) -> Vec<u8>;

    /// Adds the finds of another member. Answers that are here already stay. Returns the rays of the answers
    /// that were new.
    ///
    /// # Errors
    /// [`ForeignFinds`]; then none of the answers counts.
    fn add(&self, finds: &[u8]) -> Result<u64, ForeignFinds>;

    /// The finds of all items. All must have answers.
    fn outcome(&self) -> Vec<u8>;
}

/// The way to the other members.
pub trait Crew: Sync {
    /// Sees to it that all items of the next phase have their answers.
    ///
    /// # Errors
    /// [`TileError`] when the tile is cancelled or the backend fails.
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError>;

    /// Ends the work of the members: only the leader goes on.
    ///
    /// # Errors
    /// [`TileError::Cancelled`] for all others.
    fn end(&self) -> Result<(), TileError>;
}
