//! View cells: visibility from a box, for one polygon, for all triangles, and for groups of cells.

mod box_queries;
mod cell_decisions;
mod cell_group;
mod cell_queries;
mod exact_scene;
mod from_cell;
mod hierarchy_search;
mod listed_triangles;
mod progress;
mod rays;
mod sources;
mod statistics;
mod task;
mod work;

pub use box_queries::box_from_cell;
pub use cell_decisions::decide;
pub use cell_group::{CellGroup, GroupDecisions, decide_group};
pub use exact_scene::ExactScene;
pub use from_cell::{FromCellAnswer, from_cell};
pub use listed_triangles::decide_listed;
pub use sources::{ExactViewRegion, Sources};
pub use statistics::QueryStatistics;
pub use task::{CellDecisions, CellTask};
