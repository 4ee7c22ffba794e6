//! The job and the outputs of its tiles.
//!
//! The coordinator, the workers and the clients agree on a job through this crate. [`job`] has the checked
//! specification of a job with its key and its plan. [`output`] has the outputs of tiles with their bytes,
//! and the statistics of cells as named columns. [`ambient`] has the receivers and the answers of a job of
//! ambient occlusion. The crate does not sample, and depends on no tracer and no network.
//!
//! ```
//! use glam::Vec3;
//! use sightline_model::numbers::TileCells;
//! use sightline_model::{
//!     Effort, GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling, SceneFacts,
//! };
//! use sightline_numbers::Aabb;
//!
//! let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
//! let cells = GridCells::new(view_box, [8, 8, 8])?.with_tile_cells(TileCells::new(64)?)?;
//! let sampling = Sampling::new(Sampler::lines(KnownCells::Grid(cells)));
//! let job = PlannedJob::new(JobSpec::new([7; 32], Method::exact(sampling, Effort::Full)))?;
//! assert_eq!(job.plan().tiles.len(), 8);
//! // The specification travels as a message, which is checked when it is read.
//! let message = job.spec().to_message();
//! assert_eq!(&JobSpec::from_message(&message, &SceneFacts::default())?, job.spec());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod ambient;
pub mod job;
pub mod output;

pub use ambient::{openness, receivers};
pub use job::cells::{
    Adaptive, BoxCells, Cells, CubeCells, CubeGrid, GridCells, KnownCells, MOST_CUBE_DEPTH,
    MOST_LINE_DEPTH, Viewpoints,
};
pub use job::message::{USUAL_DEPTH, USUAL_GRID};
pub use job::names::{
    CellToCell, Effort, ErrorMeasure, Granularity, MethodName, NO_PROFILE, NamedValue, SamplerName,
    SupersetChoice, TracerChoice, Up,
};
pub use job::numbers;
pub use job::sampler::{CubeParams, LineAim, Sampler, Sampling, Stop};
pub use job::{
    ALGORITHM_VERSION, Ambient, JobSpec, Method, OutOfRange, PlannedJob, SceneFacts, SpecError,
    Task, UnknownValue, Visibility,
};
pub use output::{
    CellSet, CellSets, Decision, Hits, Node, Pack, TileOutput, VisibilitySample, bound, codec,
    pairs, statistics,
};
pub use pairs::{MOST_PAIR_CELLS, PairTable, TilePairs};
pub use sightline_viewcells::{MOST_BLOCK_CELLS, USUAL_BLOCK_CELLS};
pub use statistics::{CellStats, DecisionStats, LineKind};
