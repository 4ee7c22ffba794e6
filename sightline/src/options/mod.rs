//! The options of a bake, which define a job. The command, Python and other programs use the same fields.

#[cfg(feature = "clap")]
pub mod arguments;
pub mod byte_size;
mod cell_budget;
mod cell_maker;
mod cells;
mod job_options;
mod names;
mod resolve;
pub mod text;
mod unused;
mod viewpoints;

pub use self::byte_size::ByteSize;
pub use self::cell_budget::CellBudgetOptions;
pub use self::cells::{Cells, parse_cells};
pub use self::job_options::{CubeOptions, JobOptions};
pub use self::viewpoints::ViewpointOptions;
