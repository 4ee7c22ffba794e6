//! Samplers: the choice of sight lines and visibility cubes until a tile is done.
//!
//! [`tile::run`] turns a tile of the plan, and the packs of the tiles that it needs, into samples or sets. It
//! uses sight lines ([`lines`]) or visibility cubes (`cubes`) after Nirenstein and Blake, "Hardware
//! Accelerated Visibility Preprocessing using Adaptive Sampling" (2004). Both trace through a
//! [`Tracer`](sightline_trace::Tracer). This crate does not depend on leases, stores or the network.
//!
//! # Modules
//!
//! - `tile`, `context`: the entry point, and its inputs ([`JobContext`]).
//! - `lines`: blocks of cells that share sight lines. `rounds` casts uniform lines, flood lines (`flood`) and
//!   candidates (`candidates`) until every cell meets its tolerance. `bound` computes the bound of
//!   `--max-error` from held-out lines, `completion` adds likely items to the sets, and `adaptive` joins
//!   small cells to a tree. `pairs` and `cell_joins` find the pairs of cells that see each other. `guided` is
//!   the baseline of the benchmarks.
//! - `cubes`: visibility cubes on adaptively split rectangles, with the error measures Err, Err′ and Err″.
//! - `crew`: the members that share the phases of a block.
//! - `auto`: the timing of tracers on a scene, for `--backend auto`.
//!
//! # Invariants
//!
//! - A sight line depends only on the state of the last barrier, or on the triangles that its own cell has
//!   found. New triangles are or-ed into another copy of the table. Threads and their order do not affect a
//!   result.
//! - The outcome of a phase is a function of the job. An item's answer counts completely or not at all, and
//!   each decision between phases uses the answers of all members. A lost outcome costs time and does not
//!   change bytes (`docs/decisions/0009-crews.md`).
//! - The pairs of cells are or-ed into tables over the whole division.
//! - With the method `aggressive`, a triangle in a set was seen from a sample, meets the cell, or is
//!   undecided. A credited segment was free up to the precision of the tracer; no exact check follows.
//!
//! # Limits
//!
//! - Tiles of visibility cubes and of jobs with a time budget have no crew. Cubes have many tiles, and
//!   members of a crew would not reach a time budget at the same place.
//! - Tiles of cubes share samples only on their borders (`docs/decisions/0004-tiles-and-samples.md`). Sight
//!   lines are shared only within a block (`docs/decisions/0005-sight-lines.md`).
//! - Trees from sight lines have at most 12 levels; deeper trees need cubes.
//! - `--max-error` needs a grid or boxes along walls: a joined cell of an adaptive tree has no held-out
//!   lines.
//! - With superset simplification, a triangle can be seen because the parent cell missed its occluder. The
//!   option is off on the CPU.

pub mod auto;
mod context;
pub mod crew;
mod cubes;
mod error;
pub mod lines;
pub mod tile;

pub use context::{JobContext, LineSampler, TileSampler, Unwatched, ViewRegion, Watcher};
pub use error::TileError;
pub use sightline_numbers::ids::PhaseIndex;
pub use tile::TileCounters;
