//! Crews: groups of members, on one machine or many, that share the sampling of a block.
//!
//! Sampling has phases. In a phase, the items (a cell's lines, a stripe of seeds) read the state of the last
//! barrier and write to the next state by bitwise or and by integer sums. Their random numbers depend on
//! seed, cell and round. A result therefore does not depend on the member that computes an item. All members
//! run the same program on the same tile. In each phase the leader divides the items, and each member
//! computes some of them. At the end all members have all results, pass the same barrier and make the same
//! decisions.
//!
//! The results of a phase are its *outcome*: bytes that depend only on the job. A member that joins late
//! receives the outcomes of the finished phases and does not compute the items of these phases. If the leader
//! is lost, the block continues from the last stored outcome. An item's answer counts as a whole or not at
//! all.

mod helper;
mod leader;
mod member;
mod queue;

use rayon::prelude::*;

pub use self::helper::{FromHelper, Helper, ToHelper};
pub use self::leader::{FromLeader, Leader, ToLeader};
pub use self::member::{Crew, ForeignFinds, Phase};
pub use self::queue::{IN_HAND, Member, Queue};
use crate::error::TileError;

/// A crew of one member.
#[derive(Clone, Copy, Debug, Default)]
pub struct SoleMember;

impl Crew for SoleMember {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        phase.prepare();
        let items = (0..phase.items()).into_par_iter().with_max_len(2);
        items.try_for_each(|item| phase.compute(item, &|| false))
    }

    fn end(&self) -> Result<(), TileError> {
        Ok(())
    }
}
