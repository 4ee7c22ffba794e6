//! The interfaces between a phase, the members of a crew, and the sampler.

use crate::error::TileError;

/// The error of results that do not belong to the phase, with the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the results of another member do not belong to this phase: {0}")]
pub struct ForeignFinds(pub &'static str);

/// A phase from the view of one member.
pub trait Phase: Sync {
    /// Returns the number of items of the phase.
    fn items(&self) -> usize;

    /// Prepares [`Phase::compute`].
    ///
    /// A member that computes items calls this function once, on a thread outside rayon's pool. A member that
    /// computes no item does not call it.
    fn prepare(&self);

    /// Returns the expected work of each item, in a unit that all items of the phase share. Requires
    /// [`Phase::prepare`].
    fn costs(&self) -> Vec<u64>;

    /// Computes the item with this index, on any thread.
    ///
    /// Computing an item again does not change the state. Once `is_needless` returns true, the function may
    /// return without an answer if this saves much time.
    ///
    /// # Errors
    /// [`TileError`] if the tile is cancelled or the backend fails.
    fn compute(
        &self,
        item: usize,
        is_needless: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), TileError>;

    /// Returns true if the item has an answer on this member.
    fn has(&self, item: usize) -> bool;

    /// Removes and returns the encoded results of items that this member computed, for another member.
    /// `items` are indices of items.
    ///
    /// Call this function only if the items are computed and no other item is in progress. This member
    /// receives the removed results again with the outcome of the phase.
    fn take(&self, items: &[usize]) -> Vec<u8>;

    /// Adds the encoded results of another member. Existing answers do not change. Returns the number of rays
    /// of the new answers.
    ///
    /// # Errors
    /// [`ForeignFinds`] if the results do not belong to the phase; then no answer is added.
    fn add(&self, finds: &[u8]) -> Result<u64, ForeignFinds>;

    /// Returns the encoded results of all items, which must all have answers.
    fn outcome(&self) -> Vec<u8>;
}

/// The connection of a member to the other members.
pub trait Crew: Sync {
    /// Ensures that all items of the next phase have answers. This member or other members compute the
    /// answers.
    ///
    /// # Errors
    /// [`TileError`] if the tile is cancelled or the backend fails.
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError>;

    /// Ends the work of the helpers. Only the leader continues.
    ///
    /// # Errors
    /// [`TileError::Cancelled`] for every member except the leader.
    fn end(&self) -> Result<(), TileError>;
}
