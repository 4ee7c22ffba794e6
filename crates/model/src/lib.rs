//! The job, the outputs of its tiles, and their encodings.
//!
//! The coordinator, the workers and the clients agree on a job through this crate. The crate does not sample,
//! and depends on no tracer and no network. It uses the messages of `proto` without the gRPC services,
//! because only this crate converts messages into checked values.
//!
//! # Modules
//!
//! - [`job`]: the specification. [`JobSpec`] names a scene and a [`Task`]: [`Visibility`] by a [`Method`], or
//!   [`Ambient`] occlusion. [`PlannedJob`] adds the key and the plan. The numbers of a job are types with
//!   ranges and defaults (`job/numbers.rs`), and `job/limits.rs` lists the combinations that are not built.
//! - [`output`]: the outputs of tiles ([`TileOutput`]), their bytes (`output/codec`), the statistics of cells
//!   as named columns, the pairs of cells, and the bound on missed sight lines.
//! - [`ambient`]: the receivers and the answers of a job of ambient occlusion.
//!
//! # Invariants
//!
//! - A value of a job is checked when it is made. A lattice or a plan of a job cannot fail later.
//! - The key of a job is a digest of `ALGORITHM_VERSION` and the canonical bytes of the job's message. Equal
//!   keys mean equal results for one numerics profile.
//! - A change that affects the bytes of results needs a new [`ALGORITHM_VERSION`].
//! - Decoders check every length and index of a tile's output, and return errors.
//!
//! # Example
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
    CellCost, CellToCell, Completion, Crediting, Effort, ErrorMeasure, Granularity, MethodName,
    NO_PROFILE, NamedValue, SamplerName, SupersetChoice, TracerChoice, Up,
};
pub use job::numbers;
pub use job::sampler::{CubeParams, LineAim, Sampler, Sampling, Stop};
pub use job::{
    ALGORITHM_VERSION, Ambient, CellBudget, CellsByCost, JobSpec, MOST_FINE_BYTES, Method,
    OutOfRange, PlannedJob, SceneFacts, SpecError, Task, UnknownValue, Visibility,
};
pub use output::{
    CellSet, CellSets, Decision, Hits, Pack, SubtreeNode, TileOutput, VisibilitySample, bound,
    codec, pairs, statistics,
};
pub use pairs::{MOST_PAIR_CELLS, PairTable, TilePairs};
pub use sightline_viewcells::{MOST_BLOCK_CELLS, USUAL_BLOCK_CELLS};
pub use statistics::{CellStats, DecisionStats, LineKind};
