//! Several members, on one machine or many, that sample a block together.
//!
//! Sampling runs in phases. Within a phase the items (a cell's lines, a stripe of seeds) read the state of
//! the last barrier and write to the next by or and by integer sums, and their random numbers hang on seed,
//! cell and round. So it does not matter who computes an item. All members run the same program on the same
//! tile. In each phase one of them, the leader, divides the items; each member computes some; at the end all
//! have the finds of all, go through the same barrier and decide the same.
//!
//! What a phase found is its *outcome*: bytes that depend on the job alone. A member that comes late is given
//! the outcomes so far and computes none of their items, and a block whose leader is gone goes on from
//! the last outcome that somebody has kept. An item's answer counts whole or not at all.

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

/// One member that works alone.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Crew for Alone {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        phase.prepare();
        let items = (0..phase.items()).into_par_iter().with_max_len(2);
        items.try_for_each(|item| phase.compute(item, &|| false))
    }

    fn end(&self) -> Result<(), TileError> {
        Ok(())
    }
}
