//! View cells: visibility from a box, for one polygon, for all triangles, and for groups of cells.

mod apart;
mod ask;
mod cell_group;
mod decide;
mod exact_scene;
mod from_cell;
mod hierarchy_search;
mod listed;
mod progress;
mod rays;
mod sources;
mod statistics;
mod task;
mod work;

pub use apart::box_from_cell;
pub use cell_group::{CellGroup, GroupDecided, decide_group};
pub use decide::decide;
pub use exact_scene::ExactScene;
pub use from_cell::{Found, from_cell};
pub use listed::decide_listed;
pub use sources::{ExactViewRegion, Sources};
pub use statistics::QueryStatistics;
pub use task::{Decided, Task};
