//! What a job is and what a tile yields.
//!
//! The coordinator, the workers and the clients agree on a job through this crate. It holds parameters and
//! methods ([`choice`], [`params`]), the checked specification of a job with its key and its plan ([`spec`]),
//! the outputs of tiles with their bytes ([`output`], [`codec`]), the receivers and the answers of a job of
//! ambient occlusion ([`ambient`], [`receivers`], [`openness`]), and the statistics of cells as named columns
//! ([`statistics`], [`bound`]). It samples nothing, decides nothing, and knows no tracer and no network
//! connection.
//!
//! ```
//! use glam::Vec3;
//! use sightline_model::{JobSpec, Method, SamplingParams};
//! use sightline_numbers::Aabb;
//! use sightline_viewcells::Division;
//!
//! let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
//! let spec = JobSpec::new([7; 32], Division::Grid([8, 8, 8]), view_box);
//! let spec = JobSpec { method: Method::Exact, block_cells: 64, ..spec };
//! let (_, plan) = spec.plan()?;
//! assert_eq!(plan.tiles.len(), 8);
//! // The specification travels as a message, which is checked when it is read.
//! assert_eq!(JobSpec::from_proto(&spec.to_proto(), None)?, spec);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod ambient;
mod ambient_spec;
pub mod bound;
pub mod choice;
pub mod codec;
pub mod openness;
pub mod output;
pub mod pairs;
pub mod params;
pub mod receivers;
pub mod spec;
pub mod statistics;
mod wire;

pub use ambient::Ambient;
pub use choice::{
    BackendChoice, CellToCell, Choice, ErrorMeasure, Granularity, Method, NO_PROFILE, Sampler,
    SupersetChoice, UnknownChoice, Up,
};
pub use output::{CellSet, CellSets, Decision, Hits, Node, Pack, TileOutput, VisibilitySample};
pub use pairs::{MOST_PAIR_CELLS, PairTable, TilePairs};
pub use params::{ParamsError, SamplingParams};
pub use sightline_viewcells::{MOST_BLOCK_CELLS, USUAL_BLOCK_CELLS};
pub use spec::{ALGORITHM_VERSION, JobSpec, MOST_LINE_DEPTH, SpecError, default_block_cells};
pub use statistics::{CellStats, DecisionStats, LineKind};
pub use wire::{SceneFacts, USUAL_GRID};
