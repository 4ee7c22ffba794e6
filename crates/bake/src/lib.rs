//! One tile from start to end: sampling, exact queries, ambient occlusion, and the bytes of the output.
//!
//! [`run`] computes a tile of a [`PlannedJob`]. A worker calls this function for each lease. This crate has
//! no state between two tiles; a worker owns scenes, tracers, packs and receivers.
//!
//! # Modules
//!
//! - `choices`: every choice that changes bytes, next to the version of the algorithm.
//! - `inputs`, `outcome`, `scene`: [`Inputs`], [`Control`] and [`TileDone`], and the prepared [`BakeScene`].
//! - `sampled`: a tile that samples. With exact methods, `cell_decider` then decides every triangle that
//!   sampling did not show; `deciding`, `groups` and `cell_phase` have its parameters, its cell groups and
//!   its crew items.
//! - `decide_pairs`: exact decisions about pairs of cells that sampling has not joined.
//! - `portals`, `job_region`: tiles of the method `portals`, and the region of viewpoints.
//! - `ambient`: the openness of a tile's receivers.
//! - `scope`: the cells of a tile.
//!
//! # Invariants
//!
//! - [`run`] combines all choices that change bytes. A change of a choice needs a new `ALGORITHM_VERSION`.
//! - The output is a function of the job, the tile and the numerics profile, unless the job has a time
//!   budget.
//! - Facts about a scene are computed outside of rayon's pool; [`BakeScene`] panics on a thread of the pool.
//!
//! # Limits
//!
//! - Pairs of cells that share a face, or of an adaptive tree, have no exact queries: such pairs are visible
//!   or undecided. A pair that sampling has seen has no witness.
//! - The method `portals` has no adaptive trees, contributions or pairs of cells, which are sampled.
//! - Boxes along walls have no certificates, pairs or shared lines: the boxes are open, and each is a tile.
//! - Regions of viewpoints have no certificates and no cubes. Exact jobs use portals only in a region.
//!
//! # Example
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_bake::{BakeScene, Control, Inputs, SoleMember, Watcher, run};
//! use sightline_model::{GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling};
//! use sightline_trace::{CubeSpec, cpu::CpuBackend};
//! use sightline_viewcells::TileIndex;
//!
//! struct Unwatched;
//! impl Watcher for Unwatched {
//!     fn rendered(&self, _samples: u64) {}
//!     fn cell_done(&self) {}
//!     fn cancelled(&self) -> bool {
//!         false
//!     }
//! }
//!
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let cells = GridCells::new(scene.bounds(), [8, 8, 8])?;
//! let sampler = Sampler::lines(KnownCells::Grid(cells));
//! let backend = CpuBackend::new(Arc::clone(&scene), CubeSpec::from_sampler(&sampler))?;
//! let method = Method::aggressive(Sampling::new(sampler));
//! let job = PlannedJob::new(JobSpec::new(scene.digest().0, method))?;
//! let scene = BakeScene::new(scene)?;
//! let inputs = Inputs::new(&scene).with_tracer(&backend);
//! let control = Control { watcher: &Unwatched, deadline: None, crew: &SoleMember };
//! let done = run(&job, TileIndex(0), inputs, control)?;
//! println!("{} bytes from {} rays", done.bytes.len(), done.samples);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ambient;
mod cell_decider;
mod cell_phase;
pub mod choices;
mod decide_pairs;
mod deciding;
mod groups;
mod inputs;
mod job_region;
mod outcome;
mod portals;
mod sampled;
pub mod scene;
mod scope;

use sightline_model::{Method, PlannedJob, Task};
pub use sightline_sample::Watcher;
pub use sightline_sample::crew::{Crew, SoleMember};
use sightline_viewcells::TileIndex;

pub use crate::inputs::{Inputs, PackBytes};
pub use crate::outcome::{BakeError, Control, PackDigest, TileDone};
pub use crate::scene::BakeScene;

/// Computes tile `number` of the job's plan.
///
/// The bytes are a pure function of the specification, the scene and the tracer's numerics profile, unless
/// the job has a time budget.
///
/// # Errors
/// [`BakeError::Cancelled`] if the watcher cancels the tile; another [`BakeError`] if the tile cannot be
/// computed or the tracer fails.
///
/// # Panics
/// Panics on a thread of rayon's pool, because the thread could wait for itself.
pub fn run(
    job: &PlannedJob,
    number: TileIndex,
    inputs: Inputs<'_>,
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let missing =
        |what: &str| BakeError::Tile(format!("the tile needs {what}, but the caller passed none"));
    match &job.spec().task {
        Task::Ambient(ambient) => {
            let receivers = inputs.receivers.ok_or_else(|| missing("receivers"))?;
            ambient::run(ambient, number, inputs.scene, receivers, control.watcher)
        }
        Task::Visibility(task) => match &task.method {
            Method::Portals { .. } => portals::run(job, task, number, inputs.scene, control),
            Method::Aggressive { sampling, .. } | Method::Exact { sampling, .. } => {
                let tracer = inputs.tracer.ok_or_else(|| missing("a tracer"))?;
                sampled::run(job, task, sampling, number, inputs, tracer, control)
            }
        },
    }
}
