//! Looking from a point.

mod areas;
mod beam;
mod ending;
mod eye;
pub mod hierarchy;
mod looker;
mod meeting;
mod planes;
mod rounded;
mod scratch;
mod search;
mod space;
mod stack;
mod view;
mod within;

pub use hierarchy::{Boxes, Hierarchy, Node};
pub use looker::{LookError, Looker};
pub use scratch::Scratch;
pub use view::{Engine, Mode, Seen, Target, View};
