//! The Sightline library: bakes, queries and checks of visibility in static triangle scenes, and a client of
//! coordinators.
//!
//! | task | functions |
//! |---|---|
//! | bake here | [`read_scene`], [`JobOptions::resolve`], [`bake`], [`ambient()`] |
//! | bake on a farm | [`Client::submit`], [`JobHandle::wait`], [`JobHandle::fetch`], [`JobHandle::act`] |
//! | bake without a coordinator | [`tiles::plan`], [`tiles::run_tile`], [`tiles::assemble`] |
//! | use a result | [`open`], the methods of [`Pvs`], and [`cell_divisions`] |
//! | check a result | [`measure()`], [`verify()`], [`explain()`] |
//!
//! The command `sightline` and the Python package call the functions of this crate.
//!
//! # Modules
//!
//! - `scene`, `options`, `viewpoints`: scenes, the options of a job, and the marks of viewpoints.
//! - `local`: jobs in this process: a coordinator on loopback, and workers.
//! - `client`: submissions, jobs and downloads of a coordinator.
//! - `tiles`: bakes without a coordinator.
//! - `result`, `measure`, `verify`, `explain`, `queries`: results, their checks, and the answers that a
//!   coordinator requests.
//! - `cell_budget`: view cells for a budget, in the grid of a result.
//! - `ambient`: jobs of ambient occlusion.
//! - `tracers`, `traces`, `process`, `output`, `progress`, `observer`, `error`, `words`: resources and
//!   messages.
//!
//! # Invariants
//!
//! - Functions block; in an async runtime, call them on a blocking thread. An [`Observer`] receives their
//!   progress and notes, and can cancel them.
//! - Every [`Error`] has a kind, and the name of the option at fault if an option caused the error.
//! - One module (`options/unused.rs`) decides about an option that the job does not use: an error or a note.
//! - The crate depends on no crate for terminals. Its feature `clap` makes the options of a job arguments of
//!   a command line, so that each option is documented once.
//!
//! # Example
//!
//! ```no_run
//! use sightline::{Cells, JobOptions, LoadOptions, Local, SceneSource, Silent};
//!
//! let source = SceneSource::File("level.glb".into());
//! let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
//! let options = JobOptions { cells: Some(Cells::Grid([16, 4, 16])), ..Default::default() };
//! let job = options.resolve(&scene, &Silent)?;
//! let baked = sightline::bake(&scene, &job, &Local::default(), &Silent)?;
//!
//! let mut triangles = Vec::new();
//! if let Some(cell) = baked.pvs.find_cell([1.5, 2.0, -3.0]) {
//!     baked.pvs.visible(cell, &mut triangles)?;
//! }
//! # Ok::<(), sightline::Error>(())
//! ```

mod ambient;
mod cell_budget;
mod client;
mod error;
mod explain;
mod local;
mod measure;
mod observer;
pub mod options;
pub mod output;
pub mod process;
mod progress;
mod queries;
mod result;
mod scene;
pub mod tiles;
pub mod tracers;
mod traces;
mod verify;
pub mod viewpoints;
pub mod words;

pub use sightline_assemble::CellDivision;
pub use sightline_model::{CellBudget, CellCost, CellsByCost, JobSpec, TracerChoice, numbers};
pub use sightline_proto::connection::Credentials;
pub use sightline_pvs::Pvs;
pub use sightline_scene::{Scene, TriangleId};
pub use sightline_viewcells::CellIndex;

pub use crate::ambient::{AmbientResult, OrderedReceivers};
pub use crate::cell_budget::{CellDivisions, CellOfBudget, cell_divisions, unite_cells};
pub use crate::client::{
    Client, CredentialFiles, Endpoint, Estimate, Invalidation, Job, JobAction, JobFilter,
    JobHandle, JobList, Submission, WorkerList,
};
pub use crate::error::{Error, ErrorKind};
pub use crate::explain::{
    Each, explain, explain_as_message, explain_by_certificates, explain_by_query,
};
pub use crate::local::{Baked, Local, TracerSearch, ambient, bake, bake_after};
pub use crate::measure::{FrameReport, MeasureOptions, MeasureReport, measure, measure_in};
pub use crate::observer::{JobProgress, Note, Observer, Progress, Silent, TimeLeft};
pub use crate::options::{
    ByteSize, CellBudgetOptions, Cells, CubeOptions, JobOptions, ViewpointOptions,
};
pub use crate::queries::LibraryQueries;
pub use crate::result::{NamedResult, check_scene, kind_counts, open, without_masks};
pub use crate::scene::{LoadOptions, SceneSource, read_scene, read_scene_of};
pub use crate::tracers::TracerOption;
pub use crate::traces::TraceOptions;
pub use crate::verify::{
    CertificateReport, HiddenReport, Rejection, Verdict, VerifyOptions, verify,
};
