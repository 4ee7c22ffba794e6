//! Visibility of static triangle scenes, as a library: bakes, queries, checks, and a coordinator's client.
//!
//! | task | functions |
//! |---|---|
//! | bake here | [`read_scene`], [`JobOptions::resolve`], [`bake`], [`ambient`] |
//! | bake on a farm | [`Client::submit`], [`JobHandle::wait`], [`JobHandle::fetch`], [`JobHandle::act`] |
//! | bake without a coordinator | [`tiles::plan`], [`tiles::run_tile`], [`tiles::assemble`] |
//! | use a result | [`open`], and the methods of [`Pvs`] |
//! | check a result | [`measure()`], [`verify()`], [`explain()`] |
//!
//! Functions block; in an async runtime, call them on a blocking thread. An [`Observer`] receives their
//! progress and notes, and can cancel them. Every [`Error`]
//! has a kind, and the option at fault if there is one. The command `sightline` calls the functions of this
//! crate, and so does the Python package.
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

pub use sightline_model::{JobSpec, TracerChoice};
pub use sightline_proto::connecting::Credentials;
pub use sightline_pvs::Pvs;
pub use sightline_scene::Scene;

pub use crate::ambient::{AmbientResult, OrderedReceivers};
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
pub use crate::options::{Cells, CubeOptions, JobOptions, ViewpointOptions};
pub use crate::queries::LibraryQueries;
pub use crate::result::{NamedResult, check_scene, kind_counts, open, without_masks};
pub use crate::scene::{LoadOptions, SceneSource, read_scene, read_scene_of};
pub use crate::tracers::TracerOption;
pub use crate::traces::TraceOptions;
pub use crate::verify::{
    CertificateReport, HiddenReport, Rejection, Verdict, VerifyOptions, verify,
};
