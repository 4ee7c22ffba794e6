//! Point queries: the triangles that are visible from a point, and the visible fraction of a box.

mod areas;
mod beam;
mod beam_division;
mod beam_end;
mod boxes;
mod edge_tests;
mod eye;
mod front;
mod guess;
pub mod hierarchy;
mod looker;
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
mod view_limits;
mod zeros;

pub use hierarchy::{Boxes, BvhNode, Hierarchy};
pub use looker::{LookError, Looker};
pub use scratch::Scratch;
pub(crate) use search::SearchBudget;
pub use view::{Engine, Mode, Target, View, VisibleTriangles};
