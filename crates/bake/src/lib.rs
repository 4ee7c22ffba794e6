//! One tile from start to end: sampling, exact queries, ambient occlusion, and the bytes that come out.
//!
//! [`run`] is the only place where choices that change bytes meet. Their values are in [`choices`], next to
//! the version of the algorithm. This crate has no state between two tiles; a worker owns scenes, tracers,
//! packs and receivers.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_bake::{Alone, BakeScene, Control, Inputs, Watcher, run};
//! use sightline_model::{GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling};
//! use sightline_trace::{CubeSpec, embree::CpuBackend};
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
//! let backend = CpuBackend::new(Arc::clone(&scene), CubeSpec::of(&sampler))?;
//! let method = Method::aggressive(Sampling::new(sampler));
//! let job = PlannedJob::new(JobSpec::new(scene.digest().0, method))?;
//! let scene = BakeScene::new(scene)?;
//! let inputs = Inputs::new(&scene).with_tracer(&backend);
//! let control = Control { watcher: &Unwatched, deadline: None, crew: &Alone };
//! let done = run(&job, 0, inputs, control)?;
//! println!("{} bytes from {} rays", done.bytes.len(), done.samples);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ambient;
mod cell_phase;
pub mod choices;
mod decide;
mod decide_pairs;
mod deciding;
mod groups;
mod inputs;
mod outcome;
mod portals;
mod sampled;
pub mod scene;
mod scope;
mod within;

use sightline_model::{Method, PlannedJob, Task};
pub use sightline_sample::Watcher;
pub use sightline_sample::crew::{Alone, Crew};

pub use crate::inputs::{Inputs, PackBytes};
pub use crate::outcome::{BakeError, Control, PackDigest, TileDone};
pub use crate::scene::BakeScene;

/// Computes tile `number` of the job's plan.
///
/// The bytes are a pure function of the specification, the scene and the tracer's numerics profile, unless
/// the job has a time budget.
///
/// # Errors
/// [`BakeError`]; a cancelled tile is one.
///
/// # Panics
/// On a thread of rayon's pool, which could wait for itself.
pub fn run(
    job: &PlannedJob,
    number: u32,
    inputs: Inputs<'_>,
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let missing =
        |what: &str| BakeError::Tile(format!("the tile needs {what}, which it was not given"));
    match &job.spec().task {
        Task::Ambient(ambient) => {
            let receivers = inputs.receivers.ok_or_else(|| missing("receivers"))?;
            ambient::run(ambient, number, inputs.scene, receivers, control.watcher)
        }
        Task::Visibility(task) => match &task.method {
            Method::Portals { .. } => portals::run(job, task, number, inputs.scene, control),
            Method::Aggressive { sampling, .. } | Method::Exact { sampling, .. } => {
                let tracer = inputs.tracer.ok_or_else(|| missing("a tracer"))?;
                sampled::run(job, (task, sampling), number, (inputs, tracer), control)
            }
        },
    }
}
