//! Looking from a point.

mod areas;
mod beam;
mod beside;
mod boxes;
mod ending;
mod eye;
mod front;
mod guess;
pub mod hierarchy;
mod looker;
mod meeting;
pub(crate) mod neighbours;
mod outline;
mod patch;
mod pieces;
mod planes;
mod rings;
mod rounded;
mod scratch;
mod search;
mod sieve;
mod space;
mod stack;
mod view;
mod within;
mod zeros;

pub use hierarchy::{Boxes, Hierarchy, Node};
pub use looker::{LookError, Looker};
pub use scratch::Scratch;
pub(crate) use search::Budget;
pub use view::{Engine, Mode, Seen, Target, View};
